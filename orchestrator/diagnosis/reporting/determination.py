"""Whether a recording determines an effect's size: the interval that it leaves, beside the effect's typical size.

Where the interval is wider than a typical size, the recording neither confirms nor excludes the effect.
"""

from __future__ import annotations

import math

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import INTERVAL_SIGMAS
from orchestrator.diagnosis.selection.contrasts import CONTRASTS, holds
from orchestrator.formatting.names import parameter_words
from orchestrator.formatting.quantities import quantity
from orchestrator.formatting.sentences import listed
from orchestrator.numerics.types import Array
from protocols import Contrast, Effect, EffectParameter, FoundEffect


def undetermined_words(fit: Fit, found: FoundEffect) -> str:
    """What is known of an effect of the fit whose intervals are wider than its typical size; empty for any other."""
    candidate = next(term.candidate for term in fit.model.active if term.name == found.name)
    halves = {
        name: max(p.high - p.value, p.value - p.low)
        for name, p in found.parameters.items()
        if name in candidate.amplitudes and p.value is not None and p.low is not None and p.high is not None
    }
    return _words(fit, candidate, halves)


def undeterminable_words(fitter: Fitter, fit: Fit, candidate: CandidateEffect) -> str:
    """The same of an effect that the fit lacks, by the intervals that a fit with it would have."""
    columns = absent_columns([candidate])
    normal, _ = fitter.evaluate(fit.model, fit.linearisation, columns, known=fit).projected()
    variances: Array = np.diag(np.linalg.inv(normal + np.eye(len(normal)))).astype(np.float64)
    stds = np.sqrt(variances)[len(normal) - len(columns) :]
    halves = {
        name: INTERVAL_SIGMAS * float(std) * candidate.named(name).prior_width
        for (_, name), std in zip(columns, stds, strict=True)
    }
    return _words(fit, candidate, halves)


def _words(fit: Fit, candidate: CandidateEffect, halves: dict[str, float]) -> str:
    sizes = {name: candidate.named(name) for name in halves}
    if not halves or any(not halves[name] >= _typical(p) for name, p in sizes.items()):
        return ""
    known = [f"its {parameter_words(name)} to ±{quantity(halves[name], p.unit, 2)}" for name, p in sizes.items()]
    typical = [quantity(p.typical, p.unit) for p in sizes.values()]
    return (
        f"this recording cannot determine it ({listed(known)}, where {listed(list(dict.fromkeys(typical)))} is "
        f"typical): R_s, the map and the other effects take it up{_remedy(fit, candidate.effect)}"
    )


def _typical(p: EffectParameter) -> float:
    """Distance of the typical from the neutral value; infinite for one that is strong where it is small."""
    return math.inf if p.strong_when_small else abs(p.typical - p.neutral)


def _remedy(fit: Fit, effect: Effect) -> str:
    """What the effect declares to need and the recording lacks, or else a second rotor angle."""
    lacking = [CONTRASTS[need].text for need in effect.needs if not holds(fit.prepared, need)]
    if lacking:
        return f"; needs {listed(lacking)}"
    angle = Contrast.SECOND_ANGLE
    return "" if holds(fit.prepared, angle) else f"; {CONTRASTS[angle].text} may tell it from them"
