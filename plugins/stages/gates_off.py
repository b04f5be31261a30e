"""A reading of the sensors alone."""

from __future__ import annotations

from collections.abc import Iterator

from protocols import GatesOff, Positive, SegmentStage, Stage, StagePoint, StageState


class GatesOffStage(Stage):
    """Read the sensors with the bridge off: tells an offset of the sensors from one of the voltage."""

    name = "gates_off"
    title = "sensors, gates off"
    measuring = StageState("reading_gates_off", "read_gates_off")
    records_as = SegmentStage.GATES_OFF

    duration_s: Positive = 1.0

    def points(self) -> Iterator[StagePoint]:
        yield StagePoint(GatesOff(duration_s=self.duration_s))
