"""What is too faint to be a cause, and yet no chance: in the model and measured, where nothing hides it.

Beside a cause, what is as little may be that cause's form.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import Candidate
from orchestrator.diagnosis.selection.forward_search import Search, Step, with_effect
from orchestrator.diagnosis.selection.joint_search import downwards, exchanged, log_bayes_factors
from orchestrator.diagnosis.uncertainty.block_scatter import certainty


def with_faint(setup: DiagnosisSetup, search: Search, library: Sequence[Candidate], seen: Collection[str]) -> Search:
    """A search that named nothing, with those effects in a last fit that it saw and that the data do ask for.

    Parameters
    ----------
    seen : collection of str
        Effects that were beyond chance, but too small to be named.
    """
    fit = search.fit
    if fit.model.active or not seen:
        return search
    for candidate in library:
        if candidate.name in seen:
            fit = with_effect(setup.fitter, fit, candidate)
    fit = downwards(setup.fitter, fit)
    sure = certainty(fit)
    steady = [a for a in fit.model.active if sure[a.name] >= fit.criteria.selection.least_certainty]
    note = "below the threshold of the search: in the model, and no cause"
    setup.fitter.trace.record("add", [a.name for a in steady], before=search.fit, taken=bool(steady), note=note)
    if not steady:
        return search
    if len(steady) < len(fit.model.active):
        fit = setup.fitter.fit(fit.model.with_active(steady))
    fit, rivals = exchanged(setup.fitter, fit, library)
    factors = log_bayes_factors(fit)
    active = sorted(fit.model.active, key=lambda a: -factors[a.name])
    steps = list(search.steps)
    for count, one in enumerate(active, 1):
        model = fit.model.with_active(active[:count])
        reached = fit if count == len(active) else setup.fitter.fit(model)
        steps.append(Step(one.name, reached, factors[one.name]))
    return replace(search, steps=steps, rivals=rivals, view=None, minor=tuple(a.name for a in active))
