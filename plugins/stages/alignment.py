"""Turn the free rotor onto a current vector."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar, Literal, Self

import numpy as np

from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.types import Array
from orchestrator.stages import Scaling, given
from protocols import (
    EnergisedStage,
    Excitation,
    Hold,
    Note,
    Positive,
    RecordingReader,
    Segment,
    SegmentStage,
    StageContext,
    StagePoint,
    StageRun,
    StageState,
)


class AlignmentStage(EnergisedStage):
    """Turn the free rotor onto a current vector; its angle is the believed one from then on.

    What the sensors read with the gates off, where that was measured before, is added to what they are to read: it is
    no current, and would turn the rotor by its share of the current.
    """

    name = "alignment"
    title = "alignment"
    measuring = StageState("aligning", "align")
    records_as = SegmentStage.ALIGNMENT

    current_a: Positive | None = None
    """None: the rated current, or the one that holds the rotor most stiffly where that is less."""
    angle_rad: float = 0.0
    settle_s: Positive = 1.0
    duration_s: Positive = 0.5
    brake: Literal["engage"] | None = None
    """Whether the drive's brake, where it has one, engages while the current still holds the rotor.

    The current goes to a zero that the sensors measured: their offset is left, and turns a rotor that is free.
    """

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        current, stiffest = self.current_a, scaling.stiffest_hold_a
        if current is None:
            current = scaling.within_limit_a(min(scaling.rated_current_a("current_a"), stiffest))
        if current >= 2.0 * stiffest:
            scaling.note(
                f"alignment: from {2.0 * stiffest:.3g} A on L_q - L_d outweighs the magnet, and a free rotor does not "
                f"rest with its d axis on the current; {stiffest:.3g} A hold it best (current_a is {current:.3g} A)"
            )
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

    largest_offset: ClassVar[float] = 0.1
    """Part of the current beyond which a reading without current is no offset, but a fault, and nothing is added."""

    def as_run(self, run: StageRun, planned: Sequence[Excitation]) -> Iterator[Excitation]:
        for excitation in planned:
            yield self._beside_offset(run, excitation)

    def _beside_offset(self, run: StageRun, excitation: Excitation) -> Excitation:
        reading = _without_current(run.recording())
        if reading is None or not isinstance(excitation, Hold):
            return excitation
        offset_d, offset_q = to_dq(reading, excitation.rotor_angle_rad)[0]
        d, q = excitation.current_d_a + float(offset_d), excitation.current_q_a + float(offset_q)
        too_large = math.hypot(offset_d, offset_q) > self.largest_offset * given(self.current_a)
        if too_large or math.hypot(d, q) > run.procedure.limits.current_a:
            return excitation
        return excitation.model_copy(update={"current_d_a": d, "current_q_a": q})

    least_offset: ClassVar[float] = 0.001
    """Offset over current from which on a note warns of a free rotor: 1 % has turned one by 5.6 degrees."""

    def after_point(self, run: StageRun, segment: Segment) -> None:
        if self.brake is not None:
            run.set_brake(True)
            if run.capabilities.has_brake:
                return
        reading = _without_current(run.recording())
        size = 0.0 if reading is None else float(np.linalg.norm(reading))
        if size > self.least_offset * given(self.current_a):
            text = f"the sensors read {size:.2g} A without current: as the current goes to the zero that they measure, "
            text += (
                "that much is left, and turns a rotor which is free; the brake should engage while the current flows"
            )
            run.publish(Note(level="warning", text=text))

    @property
    def believed_angle_rad(self) -> float:
        return self.angle_rad

    @property
    def current_field(self) -> str:
        return "current_a"


def _without_current(recording: RecordingReader) -> Array | None:
    """Mean vector (1, 2) of the latest reading with the gates off [A]; None where there is none."""
    segments = recording.segments(SegmentStage.GATES_OFF)
    return recording.load(segments[-1]).i_ab.mean(axis=0, dtype=np.float64)[None] if segments else None
