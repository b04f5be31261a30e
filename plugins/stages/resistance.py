"""Hold direct currents: the stator resistance, and the inverter's own voltages beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Self

from orchestrator.stages import Scaling, given, on_axis, tidy
from protocols import EnergisedStage, Hold, Point, Positive, SegmentStage, StageContext, StagePoint, StageState


class ResistanceStage(EnergisedStage):
    """Hold direct currents at one or more PWM frequencies."""

    name = "resistance"
    title = "stator resistance"
    measuring = StageState("estimating_resistance", "estimate_resistance")
    records_as = SegmentStage.RESISTANCE

    points_a: tuple[Point, ...] | None = None
    """None: steps on both axes, denser near zero, where the inverter's own voltages show."""
    pwm_frequencies_hz: tuple[Positive, ...] | None = None
    """None: the drive's own."""
    settle_s: Positive | None = None
    duration_s: Positive | None = None
    anchor: bool = False
    """Mark as a repetition of one and the same point."""

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        points = self.points_a
        if points is None:
            amplitude = scaling.amplitude_a("points_a")
            points = (anchor_point(amplitude),) if self.anchor else _steps(amplitude)
        update = {
            "points_a": points,
            "duration_s": scaling.hold_s(self.duration_s),
            "settle_s": scaling.settle_s(self.settle_s, self.control),
            "control": scaling.control(self.control),
        }
        return self.model_copy(update=update)

    def points(self) -> Iterator[StagePoint]:
        settings: dict[str, Any] = {"anchor": True} if self.anchor else {}
        frequencies: Sequence[float | None] = self.pwm_frequencies_hz or (None,)
        for frequency in frequencies:
            for d, q in given(self.points_a):
                hold = Hold(
                    current_d_a=d,
                    current_q_a=q,
                    settle_s=given(self.settle_s),
                    duration_s=given(self.duration_s),
                    pwm_frequency_hz=frequency,
                    control=given(self.control),
                )
                yield StagePoint(hold, settings)

    @property
    def current_field(self) -> str:
        return "points_a"


def anchor_point(amplitude_a: float) -> Point:
    """The point that is repeated to see what drifts."""
    return (tidy(2 / 3 * amplitude_a), 0.0)


def _steps(amplitude_a: float) -> tuple[Point, ...]:
    on_d = [share * amplitude_a for share in (1 / 30, 1 / 12, 1 / 6, 1 / 3, 2 / 3, 1.0)]
    on_q = [share * amplitude_a for share in (1 / 12, 1 / 3, 1.0)]
    return (*on_axis("d", on_d), *on_axis("q", on_q))
