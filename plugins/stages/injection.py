"""Signal injection: the incremental inductances at many operating points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, Self

from orchestrator.stages import MOST_POINTS, Scaling, five_values, given, grid, paths, steps, tidy, within
from plugins.stages.resistance import anchor_point
from protocols import (
    EnergisedStage,
    Injection,
    NonNegative,
    Point,
    Positive,
    SegmentStage,
    StageContext,
    StagePoint,
    StageState,
)

_STEPS = {"paths": 30, "grid": 2, "corners": 1}
"""From zero current to the range's end, where `step_a` is left out."""


class InjectionStage(EnergisedStage):
    """Signal injection at many operating points.

    `pattern` "paths" steps along the paths of the classical stage, "grid" covers a square grid
    row by row in alternating direction, "corners" one of three by three; `points_a`, where given, goes instead.
    """

    name = "injection"
    title = "signal injection"
    measuring = StageState("sweeping_injection", "sweep_injection")
    records_as = SegmentStage.INJECTION

    pattern: Literal["paths", "grid", "corners"] = "grid"
    points_a: tuple[Point, ...] | None = None
    axes: tuple[Literal["q", "d", "dq"], ...] = ("q", "d", "dq")
    range_a: Positive | None = None
    """Largest current on an axis. None: the classical stage's default amplitude."""
    held_a: tuple[float, ...] | None = None
    step_a: Positive | None = None
    amplitudes_v: tuple[Positive, ...] | None = None
    """One sweep for each. None: `amplitude_ratios` of what swings the flux by a fifth of L_d I_rated."""
    amplitude_ratios: tuple[Positive, ...] = (1.0,)
    """One sweep for each, where `amplitudes_v` is left out."""
    frequency_hz: Positive | None = None
    frequency_ratio: Positive = 1.0
    """Of the frequency that is taken where `frequency_hz` is left out."""
    rotation_hz: Positive | None = None
    waveform: Literal["square", "sine"] = "square"
    settle_s: Positive | None = None
    discard_s: NonNegative = 0.0
    duration_s: Positive | None = None
    anchor: bool = False

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        frequency = self.frequency_hz or self.frequency_ratio * scaling.injection_hz(None)
        rotation, duration = scaling.turns(self.rotation_hz, self.duration_s, frequency)
        amplitudes = self.amplitudes_v
        if amplitudes is None:
            amplitude = scaling.injection_v("amplitudes_v", frequency, self.waveform)
            amplitudes = tuple(tidy(ratio * amplitude) for ratio in self.amplitude_ratios)
        points = self.points_a
        if points is None:
            points = self._pattern(scaling, scaling.ripple_a(max(amplitudes), frequency, self.waveform))
        update = {
            "points_a": points,
            "amplitudes_v": amplitudes,
            "frequency_hz": frequency,
            "rotation_hz": rotation,
            "duration_s": duration,
            "settle_s": scaling.settle_s(self.settle_s, self.control),
            "control": scaling.control(self.control),
        }
        return self.model_copy(update=update)

    def points(self) -> Iterator[StagePoint]:
        points = given(self.points_a)
        for sweep, amplitude in enumerate(given(self.amplitudes_v)):
            # Every second sweep goes backwards: it starts where the one before has ended.
            for target in points if sweep % 2 == 0 else reversed(points):
                yield StagePoint(self._injection(target, amplitude), {"anchor": True} if self.anchor else {})

    @property
    def current_field(self) -> str:
        return "points_a" if self.points_a is not None else "range_a"

    @property
    def voltage_field(self) -> str:
        return "amplitudes_v"

    def _injection(self, target: Point, amplitude_v: float) -> Injection:
        return Injection(
            target_d_a=target[0],
            target_q_a=target[1],
            settle_s=given(self.settle_s),
            discard_s=self.discard_s,
            duration_s=given(self.duration_s),
            amplitude_v=amplitude_v,
            frequency_hz=given(self.frequency_hz),
            rotation_hz=given(self.rotation_hz),
            waveform=self.waveform,
            control=given(self.control),
        )

    def _pattern(self, scaling: Scaling, ripple_a: float) -> tuple[Point, ...]:
        reach = self.range_a if self.range_a is not None else scaling.amplitude_a("range_a")
        if self.anchor:
            return (anchor_point(reach),)
        on_paths = self.pattern == "paths"
        step = self.step_a if self.step_a is not None else reach / _STEPS[self.pattern]
        lines = 2 * len(self.held_a or range(5)) + 1 if on_paths else 2 * reach / step + 1
        if (2 * reach / step + 1) * lines > MOST_POINTS:
            raise scaling.error("step_a", f"{step:g} A gives more than {MOST_POINTS} points")
        along = steps(reach, step)
        if on_paths:
            points = paths(self.axes, self.held_a or five_values(reach), along)
        else:
            points = grid(self.held_a or along, along)
        if self.range_a is not None or self.held_a is not None:
            return tuple(points)
        return self._clipped(scaling, points, ripple_a)

    def _clipped(self, scaling: Scaling, points: Sequence[Point], ripple_a: float) -> tuple[Point, ...]:
        inside = within(points, scaling.beside_ripple_a("amplitudes_v", ripple_a))
        if len(inside) < len(points):
            left_out = len(points) - len(inside)
            scaling.note(f"({self.name}): {left_out} of {len(points)} points left out, beyond limits.current_a")
        return tuple(inside)
