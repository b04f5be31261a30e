"""The classical sweep: trapezoids of one current at held values of the other."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field

from orchestrator.stages import Scaling, five_values, given, tidy
from protocols import EnergisedStage, Positive, SegmentStage, StageContext, StagePoint, StageState, Trapezoid


class ClassicalStage(EnergisedStage):
    """The paper's trapezoids: q swept at held d, d swept at held q, and both together."""

    name = "classical"
    title = "classical sweep"
    measuring = StageState("sweeping_classical", "sweep_classical")
    records_as = SegmentStage.CLASSICAL

    axes: tuple[Literal["q", "d", "dq"], ...] = ("q", "d", "dq")
    amplitude_a: Positive | None = None
    """None: the rated current and a quarter more, within the limits."""
    held_a: tuple[float, ...] | None = None
    """None: five values over the amplitude."""
    period_s: Positive = 2.0
    periods: Annotated[int, Field(ge=1)] = 2
    settle_s: Positive | None = None

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        amplitude = self.amplitude_a if self.amplitude_a is not None else scaling.amplitude_a("amplitude_a")
        held = self.held_a
        if held is None:
            # Corners of the swept square stay within the limit.
            room = (scaling.reach_a - amplitude) * (scaling.reach_a + amplitude)
            held = five_values(min(amplitude, tidy(math.sqrt(room)))) if room > 0 else (0.0,)
        update = {
            "amplitude_a": amplitude,
            "held_a": held,
            "settle_s": scaling.settle_s(self.settle_s, self.control),
            "control": scaling.control(self.control),
        }
        return self.model_copy(update=update)

    def points(self) -> Iterator[StagePoint]:
        for axis in self.axes:
            for held in (0.0,) if axis == "dq" else given(self.held_a):
                yield StagePoint(
                    Trapezoid(
                        swept_axis=axis,
                        held_a=held,
                        amplitude_a=given(self.amplitude_a),
                        period_s=self.period_s,
                        periods=self.periods,
                        settle_s=given(self.settle_s),
                        control=given(self.control),
                    )
                )

    @property
    def current_field(self) -> str:
        return "amplitude_a"
