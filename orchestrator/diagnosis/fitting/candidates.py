"""Candidate effects scaled to the machine, and effect terms of a model with standardised parameters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from orchestrator.diagnosis.fitting.guarded import require_effect
from orchestrator.numerics.types import Array
from orchestrator.validation.messages import suggestion
from protocols import (
    Effect,
    EffectParameter,
    EffectParameters,
    Manifest,
    ParameterRole,
    PluginError,
    Signals,
    hook_of,
    unit_powers,
)

SATURATION = "saturation"
CROSS_SATURATION = "cross_saturation"
MAP_RUNGS = (SATURATION, CROSS_SATURATION)
"""Steps of the ladder that free the map instead of adding an effect."""


@dataclass(frozen=True)
class CandidateEffect:
    """One effect with its parameters scaled to the machine."""

    effect: Effect
    parameters: tuple[EffectParameter, ...]
    centres: Mapping[str, float] = field(default_factory=dict)
    """Prior means of amplitudes as standardised values, by name; zero where omitted."""
    prior_log_odds: float = 0.0
    """Prior log odds of presence from a fleet, relative to an effect without a prior [nat]."""
    included_a_priori: bool = False
    """Whether nearly all motors of a fleet have it: it is included until the data contradict it."""
    alias: str = ""
    """Name where it is in a model more than once; the effect's where empty."""

    @cached_property
    def name(self) -> str:
        return self.alias or self.effect.name

    def named(self, name: str) -> EffectParameter:
        return self._by_name[name]

    @cached_property
    def _by_name(self) -> Mapping[str, EffectParameter]:
        return {p.name: p for p in self.parameters}

    def of_role(self, *roles: ParameterRole) -> tuple[str, ...]:
        return tuple(p.name for p in self.parameters if p.role in roles)

    @cached_property
    def amplitudes(self) -> tuple[str, ...]:
        return self.of_role(ParameterRole.AMPLITUDE)

    @cached_property
    def standing(self) -> Array:
        """Prior means of the amplitudes as standardised values, shape (amplitudes,)."""
        return np.array([self.centres.get(name, 0.0) for name in self.amplitudes])

    def absent(self) -> EffectTerm:
        """The effect at neutral amplitudes, which are free, and typical shapes."""
        values = {p.name: p.typical if p.role is ParameterRole.SHAPE else p.neutral for p in self.parameters}
        return EffectTerm(self, values, self.amplitudes)

    def absent_in_alternative_form(self) -> EffectTerm | None:
        """The absent effect in its second form, a separate minimum; None where its shapes have only one form."""
        alternative = {p.name: p.other_form for p in self.parameters if p.other_form is not None}
        if not any(self.named(name).role is ParameterRole.SHAPE for name in alternative):
            return None
        absent = self.absent()
        return replace(absent, values={**absent.values, **alternative})


Library = Sequence[CandidateEffect]
"""Candidate effects of a diagnosis, in the order of the effects."""


@dataclass(frozen=True)
class EffectTerm:
    """An effect in the model: its parameter values, and which of them are free."""

    candidate: CandidateEffect
    values: Mapping[str, float]
    free: tuple[str, ...]

    @cached_property
    def name(self) -> str:
        return self.candidate.name

    def moved(self, name: str, x: float) -> EffectTerm:
        """A copy with one parameter at the standardised value `x`."""
        return replace(self, values={**self.values, name: value_at(self.candidate.named(name), x)})

    def standardised_value(self, name: str) -> float:
        return standardised(self.candidate.named(name), self.values[name])

    def prior_residual(self, name: str) -> float:
        """Standardised value minus its prior mean, in standard deviations of the prior."""
        return self.standardised_value(name) - self.candidate.centres.get(name, 0.0)

    def release(self, *names: str) -> EffectTerm:
        return replace(self, free=self.free + tuple(n for n in names if n not in self.free))

    def fix(self, *names: str) -> EffectTerm:
        """A copy with some parameters neutral and not free."""
        neutral = {n: value_at(self.candidate.named(n), 0.0) for n in names}
        return replace(self, free=tuple(n for n in self.free if n not in names), values={**self.values, **neutral})

    @property
    def free_refinements(self) -> tuple[str, ...]:
        """Refinements that are free."""
        return tuple(n for n in self.candidate.of_role(ParameterRole.REFINEMENT) if n in self.free)

    def alternative_forms(self) -> list[EffectTerm]:
        """Copies in the second form, with other refinements fixed at neutral and, if any are free, also as they are.

        Empty where there is only one form, or the values are nearer to the second.
        """
        names = self.candidate.of_role(ParameterRole.REFINEMENT)
        named = self.candidate.named
        alternative = {n: x for n in names if (x := named(n).other_form) is not None}
        if all(abs(self.values[n] - x) <= abs(self.values[n] - named(n).neutral) for n, x in alternative.items()):
            return []
        leading = [n for n in alternative if not named(n).detail]
        simple, extended = self.fix(*names).release(*leading), self.release(*leading)
        forms = [simple, extended] if any(n not in alternative for n in self.free_refinements) else [simple]
        return [replace(form, values={**form.values, **alternative}) for form in forms]

    @cached_property
    def parameters(self) -> EffectParameters:
        """The values as an instance of the effect's parameter class."""
        return self.candidate.effect.Parameters(**self.values)

    @cached_property
    def is_absent(self) -> bool:
        """Whether all amplitudes are neutral."""
        return all(self.values[n] == self.candidate.named(n).neutral for n in self.candidate.amplitudes)

    @property
    def relative_size(self) -> float:
        """Size of the first parameter relative to its typical one (the largest amplitude where there are several)."""
        sizes = []
        for name in self.candidate.amplitudes:
            p = self.candidate.named(name)
            ratio = p.typical / self.values[name] if p.strong_when_small else self.values[name] / p.typical
            sizes.append(abs(ratio))
        return max(sizes)


def scaled_library(
    effects: Sequence[Effect], manifest: Manifest, without: Sequence[str] = ()
) -> tuple[CandidateEffect, ...]:
    """Candidates for one machine, in the effects' order; raises `PluginError` where one cannot be fitted."""
    for effect in effects:
        require_effect(effect)
    scale = MachineScale.of(manifest)
    return tuple(
        CandidateEffect(effect, tuple(scale.scaled(p) for p in effect.Parameters.declared()))
        for effect in effects
        if effect.name not in without
    )


def observable_effects(library: Sequence[CandidateEffect], signals: Sequence[Signals]) -> tuple[CandidateEffect, ...]:
    """The candidates that some segment can show; raises `PluginError` where an effect's `shows_in` fails."""
    return tuple(c for c in library if any(_can_show(c.effect, s) for s in signals))


def _can_show(effect: Effect, signals: Signals) -> bool:
    shows_in = hook_of(effect, "shows_in")
    try:
        return shows_in is None or bool(shows_in(signals))
    except Exception as error:  # somebody else's code may raise anything
        raise PluginError("effects", effect.name, f"shows_in: {type(error).__name__}: {error}") from error


def require_known(names: Sequence[str], effects: Sequence[Effect]) -> None:
    """Raise `PluginError` where a name is neither an effect nor one of `MAP_RUNGS`."""
    have = [e.name for e in effects] + list(MAP_RUNGS)
    for name in names:
        if name not in have:
            hint = suggestion(name, have)
            joint = "" if hint.endswith("?") else ";"
            raise PluginError("effects", name, f"no such effect; {hint}{joint} --effects FILE gives one of your own")


def standardised(p: EffectParameter, value: float) -> float:
    """Standardised value, whose prior is unit normal: amplitudes over their width, shapes by a logit within bounds."""
    if p.role is ParameterRole.SHAPE:
        return (_logit(p, value) - _logit(p, p.typical)) / p.prior_width
    if p.strong_when_small:
        return p.typical / value * p.typical / p.prior_width if value < p.neutral else 0.0
    return (value - p.neutral) / p.prior_width


def value_at(p: EffectParameter, x: float) -> float:
    """Inverse of `standardised`, limited to the bounds."""
    if p.role is ParameterRole.SHAPE:
        u = _logit(p, p.typical) + p.prior_width * x
        return p.low + (p.high - p.low) / (1.0 + math.exp(-min(max(u, -12.0), 12.0)))
    if p.strong_when_small:
        share = x * p.prior_width / p.typical
        return p.neutral if share <= p.typical / p.neutral else max(p.typical / share, p.low)
    return min(max(p.neutral + p.prior_width * x, p.low), p.high)


def typical_standardised_value(p: EffectParameter) -> float:
    """Standardised typical value; the secant from neutral to here gives the column of an absent effect."""
    return standardised(p, p.typical)


def _logit(p: EffectParameter, value: float) -> float:
    part = min(max((value - p.low) / (p.high - p.low), 1e-6), 1.0 - 1e-6)
    return math.log(part / (1.0 - part))


@dataclass(frozen=True)
class MachineScale:
    """Ratios of a machine's ratings to those of the reference machine; 1 where the nameplate has none.

    Attributes
    ----------
    amps, volts, ohms, webers : float
        Ratios of the rated current, the bus voltage, the phase resistance, and L_d times the rated current.
    """

    amps: float
    volts: float
    ohms: float
    webers: float

    @classmethod
    def of(
        cls,
        manifest: Manifest,
        *,
        rated_current_rms_a: float = 1.66,
        dc_bus_voltage_v: float = 540.0,
        stator_resistance_ohm: float = 4.25,
        d_inductance_h: float = 0.04325,
    ) -> MachineScale:
        """From a recording's nameplate and the reference machine's ratings, which are the defaults."""
        motor = manifest.motor
        amps = (motor.rated_current_rms_a or rated_current_rms_a) / rated_current_rms_a
        volts = manifest.drive.dc_bus_voltage_v / dc_bus_voltage_v
        ohms = motor.stator_resistance_ohm / stator_resistance_ohm if motor.stator_resistance_ohm else volts / amps
        webers = (motor.d_inductance_h / d_inductance_h if motor.d_inductance_h else ohms) * amps
        return cls(amps, volts, ohms, webers)

    def of_unit(self, unit: str) -> float:
        """Ratio for a quantity of this unit; 1 for units that do not scale."""
        scales = {
            "A": self.amps,
            "V": self.volts,
            "ohm": self.ohms,
            "Wb": self.webers,
            "H": self.webers / self.amps,
            "W": self.ohms * self.amps**2,
            "Nm": self.webers * self.amps,
        }
        return math.prod(scales.get(symbol, 1.0) ** power for symbol, power in unit_powers(unit).items())

    def scaled(self, p: EffectParameter) -> EffectParameter:
        """The parameter scaled to this machine; a shape's prior width, in its logit, does not change."""
        factor = self.of_unit(p.unit)
        names = ["typical", "low", "high", "neutral"]
        if p.role is not ParameterRole.SHAPE:
            names.append("prior_width")
        if p.other_form is not None:
            names.append("other_form")
        return dataclasses.replace(p, **{name: getattr(p, name) * factor for name in names})
