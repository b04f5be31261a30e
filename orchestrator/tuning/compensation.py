"""What a drive takes out of its readings and commands, from the effects of a model; knows no effect by name.

`tuning.probes` tells what each effect does to a drive. The effects of the winding's resistance and of the iron belong
to the motor, those of a brake to the bench, and a drive measures its own bus: they are not in the tables. Nor is an
effect that drifts with time, one that acts in some of the legs only, or one that follows earlier currents above all.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm, scaled_library
from orchestrator.diagnosis.reporting.motor_model import term_of
from orchestrator.formatting.quantities import quantity
from orchestrator.formatting.sentences import listed
from orchestrator.numerics.types import Array
from orchestrator.tuning.probes import TRACE_RATIO, Course, Probes, Response, without_rounding
from protocols import Effect, EffectLayer, Manifest, ModelEffect, MotorModel, is_compensable

MAX_OUTSIDE_RATIO = 0.1
"""Part of what an effect changes (rms) that the tables may lack without a remark."""
MAX_LEG_DIFFERENCE_RATIO = 0.5
"""Difference of the legs' losses from their mean (rms, over the losses) up to which one table serves all three."""
MIN_LEG_SHARE = 0.1
"""Part of the largest leg's loss (rms) from which a leg takes part."""

MAX_SLOW_HISTORY_RATIO, MAX_FAST_HISTORY_RATIO = 0.5, 1.0
"""Part of what an effect changes (rms) that may depend on earlier currents or voltages, on a slow and on a fast course;
beyond, no table stands for the effect: at 1 a correction is as wrong as none."""

REASONS = {
    EffectLayer.BUS: "the drive measures its bus voltage",
    EffectLayer.RESISTANCE: "it is the motor's, and follows the temperature of the winding",
    EffectLayer.FRAME: "it is the bench's: a drive in use has no locked rotor",
    EffectLayer.IRON: "it is the motor's iron",
}
OF_WINDING = "it is the motor's winding"
OF_RIPPLE = "it acts on ripple only"
NO_TRACE = "it changes neither constant readings, nor a constant voltage, nor an angle or a delay"
NOT_COMPENSABLE = "a drive cannot take it out"
DRIFTS = "it changes with time, which no table can follow"
READS_VOLTAGE = "its readings follow the phase voltage, which the code's correction of readings does not have"
HISTORY = (
    "it depends on earlier currents or voltages, too, and a table on the present ones alone: {part} of what it changes "
    "is {lacking} where they pass from one limit to the other in {time}"
)
UNLIKE_LEGS = "{where}; the code has one table for all legs"
PARTLY = "it is compensated in part: {part} of what it changes depends on more than the tables know"
OF_MEAN_LEG = (
    "it is compensated in part: leg {leg}'s loss is {percent:.0f} % {which} than the legs' mean, which the table has"
)


@dataclass(frozen=True)
class LeftOut:
    """An effect of the model that the drive does not compensate, or not all of it."""

    name: str
    reason: str


@dataclass(frozen=True)
class Compensation:
    """What a drive adds to its commands and takes out of its readings.

    First the readings are corrected; `lost_v` is of the corrected phase currents. Each leg's command gets
    ``lost_v + v_dc * lost_per_bus_v`` at its current, and the command vector gets `bias_ab_v`.

    Attributes
    ----------
    current_a : array, shape (k,)
        Evenly spaced phase currents, from -I to I [A].
    lost_v : array, shape (k,)
        Voltage lost in a leg at any bus voltage, at the drive's PWM frequency; odd [V].
    lost_per_bus_v : array, shape (k,)
        Voltage lost in a leg over the bus voltage [1].
    lost_std_v : array, shape (k,)
        Standard deviation of the loss at the nominal bus voltage, from the intervals of the effects' parameters [V].
        Each parameter is varied alone, so near the knee, where parameters replace each other, it is too large.
    bias_ab_v : array, shape (2,)
        Voltage lost at every current [V].
    bias_std_v : float
        Standard deviation of its length [V].
    current_gain : array, shape (2, 2)
        i_ab true = gain @ i_ab read + offset.
    current_offset_a : array, shape (2,)
    angle_rad : float
        True electrical angle of the d axis = believed + angle_rad.
    voltage_delay_s, current_delay_s : float
        Delay of the voltage beyond what the drive declares, and of the current readings.
    delay_std_s : float
    sources : tuple of str
        Effects that are in it, as the model names them.
    left_out : tuple of LeftOut
    """

    current_a: Array
    lost_v: Array
    lost_per_bus_v: Array
    lost_std_v: Array
    bias_ab_v: Array
    bias_std_v: float
    current_gain: Array
    current_offset_a: Array
    angle_rad: float
    voltage_delay_s: float
    current_delay_s: float
    delay_std_s: float
    sources: tuple[str, ...]
    left_out: tuple[LeftOut, ...]

    @property
    def delay_s(self) -> float:
        """Both delays, which the loop of a current control has in it."""
        return self.voltage_delay_s + self.current_delay_s

    def lost_parts_v(self, bus_v: float) -> tuple[float, float]:
        """What a leg loses at the largest current [V]: in proportion to the bus, and at any bus voltage."""
        return bus_v * float(self.lost_per_bus_v[-1]), float(self.lost_v[-1])

    @property
    def corrects_readings(self) -> bool:
        """Whether sensors, the angle or a constant voltage are corrected."""
        return bool(
            np.any(self.current_gain != np.eye(2)) or np.any(self.current_offset_a) or np.any(self.bias_ab_v)
            or self.angle_rad or self.delay_s
        )  # fmt: skip

    @classmethod
    def of(
        cls,
        model: MotorModel,
        effects: Sequence[Effect],
        manifest: Manifest,
        current_a: float,
        *,
        pwm_frequency_hz: float | None = None,
        clarke_of_three: bool | None = None,
    ) -> Self:
        """The compensation of a model's effects.

        Parameters
        ----------
        effects : sequence of Effect
            The installed effects.
        manifest : Manifest
            The recording's, for its drive.
        current_a : float
            Largest phase current of the table [A peak].
        pwm_frequency_hz : float, optional
            Of the drive that is tuned [Hz]; by default the recording's.
        clarke_of_three : bool or None
            Whether the drive computes its current vector from three sensors; None counts as two.

        Raises
        ------
        PluginError
            If an effect of the model is not installed, has other parameters, or fails.
        """
        library = {c.name: c for c in scaled_library(effects, manifest)}
        drive = manifest.drive
        probes = Probes(model, drive, current_a, pwm_frequency_hz=pwm_frequency_hz, clarke_of_three=clarke_of_three)
        found = probes.none
        sources, left_out = [], []
        terms = [(kept, term_of(kept, library)) for kept in model.effects]
        for kept, term in sorted(terms, key=lambda one: one[1].candidate.effect.layer):
            reason, response = _assess(probes, term, kept)
            if response is not None:
                found = found.followed_by(response)
                sources.append(kept.name)
            if reason is not None:
                left_out.append(LeftOut(kept.name, reason))
        low, full = (probes.low_bus_v, probes.bus_v)
        per_bus = (found.lost_v - found.lost_low_bus_v) / (full - low)
        return cls(
            current_a=probes.current_a,
            lost_v=without_rounding(found.lost_v - full * per_bus, TRACE_RATIO * full),
            lost_per_bus_v=per_bus,
            lost_std_v=np.sqrt(found.lost_variance),
            bias_ab_v=found.bias_v,
            bias_std_v=math.sqrt(found.bias_variance),
            current_gain=found.gain,
            current_offset_a=found.offset_a,
            angle_rad=found.angle_rad,
            voltage_delay_s=found.voltage_delay_s,
            current_delay_s=found.current_delay_s,
            delay_std_s=math.sqrt(found.delay_variance),
            sources=tuple(sources),
            left_out=tuple(left_out),
        )


def _assess(probes: Probes, term: EffectTerm, kept: ModelEffect) -> tuple[str | None, Response | None]:
    """Why an effect is left out, wholly or in part, and its response where it is compensated."""
    effect = term.candidate.effect
    if effect.layer is EffectLayer.BUS or not is_compensable(effect):
        return _reason(probes, term), None
    if probes.drifts(term):
        return DRIFTS, None
    if probes.reads_voltage(term):
        return READS_VOLTAGE, None
    if effect.layer is EffectLayer.INVERTER and (where := _unlike_legs(probes.leg_losses(term), probes.bus_v)):
        return UNLIKE_LEGS.format(where=where), None
    response = probes.response(term)
    if not response.leaves_trace:
        return NO_TRACE, None
    ends = [
        (probes.response(_at(term, name, p.low)), probes.response(_at(term, name, p.high)))
        for name, p in kept.parameters.items()
        if p.fitted and p.low is not None and p.high is not None
    ]
    whole = response.with_variances(ends)
    courses = slow, fast = probes.courses(term, response)
    if slow.ratio > MAX_SLOW_HISTORY_RATIO or fast.ratio > MAX_FAST_HISTORY_RATIO:
        return _of_history(max(courses, key=lambda one: one.ratio), "no table's"), None
    if fast.ratio > MAX_OUTSIDE_RATIO or slow.ratio > MAX_OUTSIDE_RATIO:
        return f"it is compensated in part: {_of_history(max(courses, key=lambda one: one.ratio), 'left')}", whole
    if response.outside_ratio <= MAX_OUTSIDE_RATIO:
        return None, whole
    of_leg = _uneven_leg(probes.leg_losses(term), probes.bus_v) if effect.layer is EffectLayer.INVERTER else ""
    return of_leg or PARTLY.format(part=f"{response.outside_ratio:.0%}"), whole


def _of_history(course: Course, lacking: str) -> str:
    """The sentence of an effect that depends on what was before."""
    return HISTORY.format(part=f"{min(course.ratio, 1.0):.0%}", lacking=lacking, time=quantity(course.rise_s, "s"))


def _reason(probes: Probes, term: EffectTerm) -> str:
    """Why an effect is not the drive's to take out."""
    layer = term.candidate.effect.layer
    if layer is EffectLayer.RESISTANCE:
        of_constant, of_changing = probes.voltages_taken(term)
        if of_changing > 0.0:
            return OF_RIPPLE if of_constant < TRACE_RATIO * of_changing else OF_WINDING
    return REASONS.get(layer, NOT_COMPENSABLE)


def _unlike_legs(lost_v: Array, bus_v: float) -> str:
    """In which phases a loss (3, k) acts, where it is not nearly the same function in all of them; else empty."""
    size, difference = (float(np.sqrt(np.mean(x**2))) for x in (lost_v, lost_v - lost_v.mean(axis=0)))
    if size <= TRACE_RATIO * bus_v or difference <= MAX_LEG_DIFFERENCE_RATIO * size:
        return ""
    rms = np.sqrt(np.mean(lost_v**2, axis=1))
    phases = [phase for phase, loss in zip("abc", rms, strict=True) if loss >= MIN_LEG_SHARE * rms.max()]
    if len(phases) == 3:
        return "its loss differs from phase to phase"
    return f"in phase {phases[0]} alone" if len(phases) == 1 else f"in phases {listed(phases)} alone"


def _uneven_leg(lost_v: Array, bus_v: float) -> str:
    """The leg whose loss (3, k) differs most from the mean, where it differs at all that much; else empty."""
    mean = lost_v.mean(axis=0)
    if float(np.sqrt(np.mean(mean**2))) <= TRACE_RATIO * bus_v:
        return ""
    ratios = lost_v @ mean / (mean @ mean) - 1.0
    leg = int(np.argmax(np.abs(ratios)))
    if abs(ratios[leg]) <= MAX_OUTSIDE_RATIO:
        return ""
    which = "larger" if ratios[leg] > 0.0 else "smaller"
    return OF_MEAN_LEG.format(leg="abc"[leg], percent=100.0 * abs(ratios[leg]), which=which)


def _at(term: EffectTerm, name: str, value: float) -> EffectTerm:
    return dataclasses.replace(term, values={**term.values, name: value})
