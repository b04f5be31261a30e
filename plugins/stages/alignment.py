"""Turn the free rotor onto a current vector."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, Self

from orchestrator.stages import Scaling, given
from protocols import (
    EnergisedStage,
    Hold,
    Positive,
    Segment,
    SegmentStage,
    StageContext,
    StagePoint,
    StageRun,
    StageState,
)


class AlignmentStage(EnergisedStage):
    """Turn the free rotor onto a current vector; its angle is the believed one from then on."""

    name = "alignment"
    title = "alignment"
    measuring = StageState("aligning", "align")
    records_as = SegmentStage.ALIGNMENT

    current_a: Positive | None = None
    """None: the rated current."""
    angle_rad: float = 0.0
    settle_s: Positive = 1.0
    duration_s: Positive = 0.5
    brake: Literal["engage"] | None = None
    """Whether the drive's brake, where it has one, engages while the current still holds the rotor.

    The current goes to a zero that the sensors measured: their offset is left, and turns a rotor that is free.
    """

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        current = self.current_a
        if current is None:
            current = scaling.within_limit_a(scaling.rated_current_a("current_a"))
        return self.model_copy(update={"current_a": current, "control": scaling.control(self.control)})

    def points(self) -> Iterator[StagePoint]:
        yield StagePoint(
            Hold(
                current_d_a=given(self.current_a),
                current_q_a=0.0,
                settle_s=self.settle_s,
                duration_s=self.duration_s,
                control=given(self.control),
            )
        )

    def after_point(self, run: StageRun, segment: Segment) -> None:
        if self.brake is not None:
            run.set_brake(True)

    @property
    def believed_angle_rad(self) -> float:
        return self.angle_rad

    @property
    def current_field(self) -> str:
        return "current_a"
