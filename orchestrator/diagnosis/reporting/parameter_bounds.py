"""Parameters of a fitted model that ended at a bound of their effect's declaration: their values are the bound's."""

from __future__ import annotations

from collections.abc import Container

from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.guarded import is_own
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.formatting.names import parameter_words
from orchestrator.formatting.quantities import number, quantity
from protocols import EffectParameter, ParameterRole, Remark

MAX_DISTANCE_OF_AMPLITUDE: float = 1e-6
"""Distance from a bound that rounding makes, relative to the bound."""
MAX_DISTANCE_OF_SHAPE: float = 0.01
"""A shape is fitted on a scale on which its bounds are at infinity; distance from a bound, relative to the bound."""


def bound_remarks(fit: Fit, besides: Container[str] = ()) -> list[Remark]:
    """A remark, code ``at_bound``, for each free amplitude or shape at a bound; effects in `besides` are left out."""
    text = "{effect}: {parameter} is at its bound {bound}: its best value may lie beyond; {advice}"
    return [
        Remark.of(
            "at_bound", text, effect=term.name, parameter=parameter_words(name), bound=bound, advice=bound_advice(term)
        )
        for term in fit.model.active
        if term.name not in besides
        for name, bound in bounds_reached(term).items()
    ]


def bound_advice(term: EffectTerm) -> str:
    """What to do about a parameter at its bound: an own effect's can be wider, an installed one's is the plausible."""
    if is_own(term.candidate.effect):
        return "declare a wider bound in its class and fit again"
    return "beyond it the effect is not plausible, so look for another cause as well"


def bounds_reached(term: EffectTerm) -> dict[str, str]:
    """The bounds that an effect's free amplitudes and shapes ended at, in words, by the parameters' names.

    An amplitude at a neutral bound is no such parameter: it says that the effect is absent.
    """
    stated = {p.name: p for p in term.candidate.effect.Parameters.declared()}
    found = {}
    for name in (*term.candidate.amplitudes, *term.candidate.of_role(ParameterRole.SHAPE)):
        scaled = term.candidate.named(name)
        end = _end_reached(scaled, term.values[name]) if name in term.free else None
        if end is not None:
            found[name] = _in_words(end, stated[name], scaled)
    return found


def _end_reached(p: EffectParameter, value: float) -> str | None:
    """``low`` or ``high``; None within the range."""
    largest = MAX_DISTANCE_OF_SHAPE if p.role is ParameterRole.SHAPE else MAX_DISTANCE_OF_AMPLITUDE
    for end, bound in (("low", p.low), ("high", p.high)):
        is_absence = p.role is ParameterRole.AMPLITUDE and bound == p.neutral
        if not is_absence and abs(value - bound) <= largest * abs(bound):
            return end
    return None


def _in_words(end: str, stated: EffectParameter, scaled: EffectParameter) -> str:
    """The bound on this machine, and how it is declared: ``444 mV (high = 5 V, scaled by 0.0889 to this machine)``."""
    factor = scaled.typical / stated.typical
    source = f"{end} = {quantity(getattr(stated, end), stated.unit)}"
    if factor != 1.0:
        source = f"{source}, scaled by {number(factor, 2)} to this machine"
    return f"{quantity(getattr(scaled, end), scaled.unit)} ({source})"
