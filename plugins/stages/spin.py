"""The rotor turns: the back-EMF with the gates off, then the flux at currents held in the frame that turns with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Self

from pydantic import Field

from orchestrator.stages import Scaling, given, grid, steps, tidy, within
from protocols import (
    EnergisedStage,
    Excitation,
    NotMeasuredError,
    Point,
    Positive,
    RunAborted,
    SegmentStage,
    Spin,
    StageContext,
    StagePoint,
    StageRun,
    StageState,
)


class SpinStage(EnergisedStage):
    """Another machine, or the drive itself, turns the rotor at steady speeds; its brake is released.

    With the gates off first, at every speed: the back-EMF is the magnet's flux, and says whether phases, pole pairs and
    angle are those that are believed. Where they are not, the run ends before a current is held in a wrong frame.
    """

    name = "spin"
    title = "turning rotor"
    measuring = StageState("spinning", "spin")
    records_as = SegmentStage.SPIN

    speeds_rpm: tuple[float, ...] | None = None
    """Mechanical; negative: backwards. None: one that leaves room below limits.voltage_v, and half of it backwards."""
    gates_off: bool = True
    driven: bool = True
    points_a: tuple[Point, ...] | None = None
    """At each speed. None: a grid of five by five over `range_a`, within the limit; at every second speed, between."""
    range_a: Positive | None = None
    """Largest current on an axis. None: the rated one and a quarter more."""
    turns: Annotated[int, Field(ge=2, le=100_000)] = 8
    """Electrical, that are captured at each point."""
    settle_s: Positive | None = None
    pole_pairs: Annotated[int, Field(ge=1)] | None = None
    """None: the nameplate's."""
    reach_a: Positive | None = None
    """Longest current of the grid. None: what limits.current_a leaves, or its corners where `range_a` is given."""

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        pairs = self.pole_pairs or context.procedure.motor.pole_pairs
        reach = self.range_a
        if reach is None and self.points_a is None and self.driven:
            reach = scaling.amplitude_a("range_a")
        speeds = self.speeds_rpm
        if speeds is None:
            reach_a = max(
                (math.hypot(*point) for point in self.points_a or ()), default=math.sqrt(2.0) * (reach or 0.0)
            )
            longest = min(reach_a, scaling.reach_a)
            rpm = tidy(scaling.spin_rad_s("speeds_rpm", longest) / pairs * 30.0 / math.pi)
            speeds = (rpm, -0.5 * rpm)
        update = {
            "speeds_rpm": speeds,
            "range_a": reach,
            "pole_pairs": pairs,
            "reach_a": self.reach_a or (scaling.reach_a if self.range_a is None else math.sqrt(2.0) * self.range_a),
            "settle_s": scaling.settle_s(self.settle_s, self.control),
            "control": scaling.control(self.control),
        }
        return self.model_copy(update=update)

    def points(self) -> Iterator[StagePoint]:
        speeds = given(self.speeds_rpm)
        if self.gates_off:
            for rpm in speeds:
                yield StagePoint(self._spin(rpm, None))
        if self.driven:
            for k, rpm in enumerate(speeds):
                for point in self.points_a or self._grid(between=k % 2 == 1):
                    yield StagePoint(self._spin(rpm, point))

    def as_run(self, run: StageRun, planned: Sequence[Excitation]) -> Iterator[Excitation]:
        """As planned; raises `RunAborted` before a current would be held in a frame that is not the rotor's."""
        doubted = True
        for excitation in planned:
            if doubted and isinstance(excitation, Spin) and excitation.bridge == "on":
                _require_own_frame(run)
                doubted = False
            yield excitation

    @property
    def current_field(self) -> str:
        return "points_a" if self.points_a is not None else "range_a"

    @property
    def voltage_field(self) -> str:
        return "speeds_rpm"

    def _grid(self, between: bool) -> Sequence[Point]:
        along = steps(given(self.range_a), given(self.range_a) / 2.0)
        if between:
            along = [0.5 * (a + b) for a, b in pairwise(along)]
        return within(grid(along, along), given(self.reach_a))

    def _spin(self, rpm: float, current: Point | None) -> Spin:
        speed = rpm * math.pi / 30.0 * given(self.pole_pairs)
        d, q = current if current is not None else (0.0, 0.0)
        return Spin(
            speed_rad_s=speed,
            bridge="off" if current is None else "on",
            current_d_a=d,
            current_q_a=q,
            settle_s=given(self.settle_s),
            duration_s=self.turns * 2.0 * math.pi / abs(speed),
            control=given(self.control),
        )


def _require_own_frame(run: StageRun) -> None:
    """Hold the back-EMF of all that was turned with the gates off against the angle that the drive reads."""
    # numba stays out of an import that only wants the names
    from orchestrator.analysis import require_emf_follows_angle

    recording = run.recording()
    try:
        for segment in recording.segments(SegmentStage.SPIN):
            if segment.settings.get("bridge") == "off":
                require_emf_follows_angle(segment, recording.load(segment))
    except NotMeasuredError as error:
        raise RunAborted(f"no current is held while the rotor turns: {error}") from error
