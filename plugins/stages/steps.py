"""Voltage steps between current limits: the quickest way to a map at standstill, and nothing rests."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field

from orchestrator.stages import Scaling, given, tidy
from protocols import EnergisedStage, Positive, SegmentStage, StageContext, StagePoint, StageState, VoltageSteps

_AXES: tuple[Literal["d", "q"], Literal["d", "q"]] = ("d", "q")


class StepsStage(EnergisedStage):
    """+-U on d, on q and on both at once, turned round where the current meets a limit.

    On both at once each axis turns by itself, q so much later than d that they pass all of the plane between their
    limits. Two voltages tell apart what a lag, a drop and the iron do.
    """

    name = "steps"
    title = "voltage steps"
    measuring = StageState("stepping", "step")
    records_as = SegmentStage.STEPS

    axes: tuple[Literal["d", "q", "dq"], ...] = ("d", "q", "dq")
    turn_a: Positive | None = None
    """Current at which an axis alone is turned; both at once at 0.7 of it. None: the rated one and a quarter more."""
    voltages_v: tuple[Positive, Positive] | None = None
    """Of d alone and of q alone; at once 0.7 of the one and 0.44 of the other. None: what gives `rows_per_swing`."""
    voltage_ratios: tuple[Positive, ...] | None = None
    """One pass for each. None: all of it, and half of it or as much as still goes well beyond R_s i."""
    rows_per_swing: Annotated[int, Field(ge=8, le=10_000)] = 40
    """From one turn to the next, where `voltages_v` is left out."""
    swings: Annotated[int, Field(ge=6, le=100_000)] = 60
    """Of both at once at the highest voltage, where `duration_s` is left out."""
    settle_s: Positive | None = None
    duration_s: Positive | None = None
    """At the highest voltage; so much longer where it is lower."""

    later: ClassVar[float] = 0.5 * (1.0 + math.sqrt(5.0))
    """By which factor q's swings are longer than d's on both at once: they never fall into step."""
    over_ohmic: ClassVar[float] = 1.6
    """Least voltage, of R_s i where it is turned."""

    def filled(self, context: StageContext) -> Self:
        scaling = Scaling(context)
        fs, rows = context.sampling_frequency_hz, self.rows_per_swing
        turn = self.turn_a
        if turn is None:
            # Turned a row late, and a delay; and a current that saturates the motor rises twice as fast as believed.
            overshoot = 2.0 * 4.0 / rows
            turn = tidy(min(scaling.amplitude_a("turn_a"), scaling.reach_a / (1.0 + overshoot)))
        voltages = self.voltages_v
        if voltages is None:
            least = self.over_ohmic * self.later / min(self.voltage_ratios or (0.5,))
            d, q = (scaling.step_v("voltages_v", axis, turn, rows / fs, least) for axis in _AXES)
            voltages = (d, q)
        swing_s = max(
            scaling.swing_s(axis, turn, volts) or rows / fs for axis, volts in zip(_AXES, voltages, strict=True)
        )
        ohmic_v = self.over_ohmic * turn * (context.procedure.motor.stator_resistance_ohm or 0.0)
        lower = max(0.5, ohmic_v / voltages[0], self.later * ohmic_v / voltages[1])
        update = {
            "turn_a": turn,
            "voltage_ratios": self.voltage_ratios or ((1.0, tidy(lower)) if lower < 0.9 else (1.0,)),
            "voltages_v": voltages,
            "duration_s": self.duration_s or tidy(self.later * self.swings * swing_s),
            "settle_s": scaling.settle_s(self.settle_s, self.control),
            "control": scaling.control(self.control),
        }
        return self.model_copy(update=update)

    def points(self) -> Iterator[StagePoint]:
        for ratio in given(self.voltage_ratios):
            for axis in self.axes:
                yield StagePoint(self._steps(axis, ratio))

    @property
    def current_field(self) -> str:
        return "turn_a"

    @property
    def voltage_field(self) -> str:
        return "voltages_v"

    def _steps(self, axis: Literal["d", "q", "dq"], ratio: float) -> VoltageSteps:
        both = math.sqrt(0.5) if axis == "dq" else 1.0
        (volts_d, volts_q), turn = given(self.voltages_v), given(self.turn_a)
        shares = {"d": (1.0, 0.0), "q": (0.0, 1.0), "dq": (both, both / self.later)}[axis]
        return VoltageSteps(
            voltage_d_v=ratio * shares[0] * volts_d,
            voltage_q_v=ratio * shares[1] * volts_q,
            turn_d_a=both * turn if shares[0] else 0.0,
            turn_q_a=both * turn if shares[1] else 0.0,
            settle_s=given(self.settle_s),
            duration_s=given(self.duration_s) / ratio,
            control=given(self.control),
        )
