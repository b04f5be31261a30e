"""Signal injection: the incremental inductances at many operating points."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import cycle, islice
from typing import Annotated, Literal, Self

from pydantic import Field

from orchestrator.stages import (
    MAX_POINTS,
    Scaling,
    five_values,
    flux_swing_wb,
    given,
    grid,
    paths,
    steps,
    tidy,
    within,
)
from plugins.stages.resistance import anchor_point
from protocols import (
    EnergisedStage,
    Excitation,
    Injection,
    NonNegative,
    Note,
    NotMeasuredError,
    Point,
    Positive,
    Segment,
    SegmentStage,
    StageContext,
    StagePoint,
    StageRun,
    StageState,
)

LOOKING = StageState("looking_between_points", "look_between_points")

_STEPS = {"paths": 30, "grid": 2, "corners": 1}
"""From zero current to the range's end, where `step_a` is left out."""


class InjectionStage(EnergisedStage):
    """Signal injection at many operating points.

    `pattern` "paths" steps along the paths of the classical stage, "grid" covers a square grid
    row by row in alternating direction, "corners" one of three by three; `points_a`, where given, goes instead.

    Iron may bend within a fraction of a step. With `most_between` the stage looks, the drive disarmed, where an
    inductance differs much between two neighbouring points, and injects midway, until it does so nowhere.
    """

    name = "injection"
    title = "signal injection"
    measuring = StageState("sweeping_injection", "sweep_injection")
    records_as = SegmentStage.INJECTION
    working = (LOOKING,)

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
    most_between: Annotated[int, Field(ge=0, le=MAX_POINTS)] = 0
    """How many points may be added midway between others, of the weakest injection."""
    steepest: Annotated[float, Field(gt=1.0)] = 1.6
    """Ratio of L_dd, or of L_qq, at two points that follow each other, from which there is one between them."""
    narrowest: Positive = 0.25
    """Flux of a step that is left as it is, over the injection's own swing to one side."""

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
        # Where these will be is not known yet: at worst where the current is largest.
        outermost = sorted(points, key=lambda target: -math.hypot(*target))[:4]
        for target in islice(cycle(outermost), self.most_between):
            yield StagePoint(self._injection(target, min(given(self.amplitudes_v))), spare=True)

    def as_run(self, run: StageRun, planned: Sequence[Excitation]) -> Iterator[Excitation]:
        left = iter(planned)
        yield from islice(left, max(0, len(planned) - self.most_between))
        known = first = len(given(self.points_a)) * len(given(self.amplitudes_v))
        # A resumed run chooses by what was known when it was first chosen, and goes on after what is done of that.
        while between := self._between(run, run.segments[:known], self.most_between - (known - first)):
            for target, injection in zip(between[len(run.segments) - known :], left, strict=False):
                yield injection.model_copy(update={"target_d_a": target[0], "target_q_a": target[1]})
            known += len(between)

    def _between(self, run: StageRun, known: Sequence[Segment], most: int) -> list[Point]:
        """Where to inject next, row by row; nothing where the points lie close enough together."""
        steep = self._steep(run, known) if most > 0 else []
        if not steep:
            return []
        ratio, (d, q) = steep[0]
        worst = f"about ({d:+.3g}, {q:+.3g}) A an inductance changes {ratio:.2g} times from a point to the next"
        run.publish(Note(level="info", text=f"{worst}; steps to be halved: {len(steep)}"))
        return sorted(middle for _, middle in steep[:most])

    def _steep(self, run: StageRun, known: Sequence[Segment]) -> list[tuple[float, Point]]:
        """Steps within which the iron bends, the worst first; computed with the drive disarmed."""
        run.enter(LOOKING)  # before anything that takes its time, as an import does
        import numpy as np

        from orchestrator.analysis import injected_points, steep_steps

        weakest_v = min(_setting(segment, "amplitude_v") for segment in known)
        sweep = [segment for segment in known if _setting(segment, "amplitude_v") == weakest_v]
        recording, delay = run.recording(), run.capabilities.voltage_delay_samples
        targets = np.array([[_setting(segment, f"target_{axis}_a") for axis in "dq"] for segment in sweep])
        try:
            points, _ = injected_points(recording, sweep, voltage_delay_samples=delay)
            # Set-points lie on lines exactly, the reached currents nearly.
            nearest = np.argmin(np.linalg.norm(points.current[:, None] - targets, axis=2), axis=1)
            steep = steep_steps(
                targets[nearest],
                points.matrix,
                steepest=self.steepest,
                narrowest_wb=self.narrowest * flux_swing_wb(weakest_v, given(self.frequency_hz), self.waveform),
                where=recording.manifest.name,
            )
        except NotMeasuredError:  # whoever estimates will say so
            return []
        run.check()
        tried = {(float(d), float(q)) for d, q in targets}
        return [step for step in steep if step[1] not in tried]

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
        if (2 * reach / step + 1) * lines > MAX_POINTS:
            raise scaling.error("step_a", f"{step:g} A gives more than {MAX_POINTS} points")
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


def _setting(segment: Segment, name: str) -> float:
    return float(segment.settings[name])
