"""Which absent effects a recording cannot tell from one of the model: by their contrasts, or by their signals.

Installed effects declare what separates them. A file of one's own may declare nothing, so that its effects are compared
by their signals.
"""

from __future__ import annotations

from collections.abc import Sequence

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.guarded import is_own
from orchestrator.diagnosis.fitting.imitation import resembling
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.contrasts import separable


def inseparable_from(
    fitter: Fitter, fit: Fit, present: EffectTerm, candidates: Sequence[CandidateEffect]
) -> frozenset[str]:
    """Names of the absent candidates that the recording does not separate from an effect of the fit.

    Parameters
    ----------
    present : EffectTerm
        An effect of the fit's model.
    candidates : sequence of CandidateEffect
        Those that the model has already are passed over.
    """
    effect = present.candidate.effect
    absent = [c for c in candidates if c.name not in fit.model.names]
    tied = {c.name for c in absent if not separable(fit.prepared, c.effect, effect)}
    undeclared = [c for c in absent if (is_own(c.effect) or is_own(effect)) and c.name not in tied]
    if undeclared:
        tied |= {c.name for c in undeclared} & set(resembling(fitter, fit, present.name, undeclared))
    return frozenset(tied)
