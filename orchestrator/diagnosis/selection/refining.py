"""Effects' flexible forms: freed where the evidence requires them, fixed again where the simple form suffices.

The wrong shape of the right effect causes most spurious second ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.selection.scoring import log_evidence, loss_without, select_terms
from protocols import ParameterRole

MAX_DEFERRED_FORM_GAIN: float = 0.3
"""Part of a flexible form's linear gain that may be postponed: few of its parameters bring most of the gain, and the
others are judged anew once those are free."""
MIN_SHARE_OF_FORM_DETAIL: float = 0.5
"""Part of the excess chi2 that a form's details have to remove to be freed; less may belong to another effect."""
MAX_FORM_EXTENSIONS: int = 8
"""Maximum number of extensions of a flexible form."""
LEAST_CHI2_LOSS_OF_SIMPLE_FORM: float = 1000.0
"""Loss of chi2, to first order, beyond which an effect's simple form does not suffice."""


def refit_newest(fitter: Fitter, fit: Fit, inflation: float) -> Fit:
    """Fit the newest effect to convergence, in its flexible form where the evidence requires it."""
    return extend_newest(fitter, fit_newest(fitter, fit), inflation)


def fit_newest(fitter: Fitter, fit: Fit) -> Fit:
    """Fit the newest effect to convergence in its present form."""
    linearisation = fitter.linearise(fit.model, fit.linearisation)
    return fitter.fit(fit.model, linearisation, steps=4, relinearisations=0, tolerance=1e-3)


def extend_newest(fitter: Fitter, fit: Fit, inflation: float) -> Fit:
    """Free the newest effect's refinements where the evidence requires them."""
    extended = _try_refinements(fitter, fit, len(fit.model.active) - 1, inflation)
    return fit if extended is None else extended


def extend_earlier(fitter: Fitter, fit: Fit) -> Fit:
    """Free the earlier effects' refinements, where the effect added since shows their gain."""
    for index in range(0 if fitter.budget.is_spent else len(fit.model.active) - 1):
        trial = _try_refinements(fitter, fit, index, 1.0)
        fit = fit if trial is None else trial
    return fit


def fixed_refinements(effects: Sequence[EffectTerm]) -> list[tuple[EffectTerm, str]]:
    """Refinements of some effects that are held fixed."""
    return [(a, n) for a in effects for n in a.candidate.of_role(ParameterRole.REFINEMENT) if n not in a.free]


def converge(fitter: Fitter, fit: Fit) -> Fit:
    """Fit to convergence, each effect in its simple form again where that now fits as well."""
    best = fitter.fit(fit.model, fit.linearisation, steps=8, relinearisations=3, tolerance=3e-4)
    for index in range(len(best.model.active)):
        free_refinements = best.model.active[index].free_refinements
        if free_refinements and not fitter.budget.is_spent:
            best = _simplify(fitter, best, index, free_refinements) or best
    return best


def _simplify(fitter: Fitter, fit: Fit, index: int, names: Sequence[str]) -> Fit | None:
    """The fit with some refinements of one effect at neutral; None where they are needed."""
    active, limits = fit.model.active[index], fit.criteria.selection
    if loss_without(fit, active, names) > LEAST_CHI2_LOSS_OF_SIMPLE_FORM:
        return None
    models = list(fit.model.active)
    models[index] = active.fix(*names)
    trial = fitter.fit(fit.model.with_active(models), fit.linearisation, steps=8, relinearisations=0, tolerance=3e-4)
    inflation = max(1.0, min(fit.chi2_per_dof, trial.chi2_per_dof))
    simple, free = log_evidence(trial, inflation), log_evidence(fit, inflation)
    fitter.trace.record(
        "fix_shape",
        [active.name],
        before=fit,
        after=trial,
        measure="log_evidence",
        score=simple - free,
        threshold=-limits.tie,
        taken=simple > free - limits.tie,
    )
    return trial if simple > free - limits.tie else None


def _try_refinements(fitter: Fitter, fit: Fit, index: int, inflation: float) -> Fit | None:
    """The fit with one effect's flexible form; None where nothing is left to free or the evidence is against it."""
    active = fit.model.active[index]
    if fitter.budget.is_spent or set(active.candidate.of_role(ParameterRole.REFINEMENT)) <= set(active.free):
        return None
    best = _extend_form(fitter, fit, index, active, fit, inflation) or fit
    for form in _alternative_starts(active, best, index):
        best = _extend_form(fitter, fit, index, form, best, inflation) or best
    if best is fit:
        return None
    inflation = max(1.0, min(inflation, best.chi2_per_dof))
    tie = fit.criteria.selection.tie
    free, simple = log_evidence(best, inflation), log_evidence(fit, inflation)
    fitter.trace.record(
        "free_shape",
        [active.name],
        before=fit,
        after=best,
        measure="log_evidence",
        score=free - simple,
        threshold=tie,
        taken=free > simple + tie,
    )
    return best if free > simple + tie else None


def _alternative_starts(active: EffectTerm, best: Fit, index: int) -> list[EffectTerm]:
    """Further initial values of an effect's flexible form, where the best fit so far leaves more than noise.

    - the alternative start (second form);
    - the alternative start with the refinements of the first form;
    - the form without parameters that ran to a bound: these compensated for something else.
    """
    if best.chi2_per_dof <= best.criteria.selection.detected_chi2:
        return []
    ended, extended = _at_bounds(active), best.model.active[index]
    return [*active.alternative_forms(), *extended.alternative_forms()[1:], *([active.fix(*ended)] if ended else [])]


def _at_bounds(active: EffectTerm) -> list[str]:
    """Refinements at a bound of their range, unless that is neutral."""
    declared = ((n, active.candidate.named(n)) for n in active.free_refinements)
    return [n for n, p in declared if active.values[n] in (p.low, p.high) and active.values[n] != p.neutral]


def _extend_form(fitter: Fitter, fit: Fit, index: int, form: EffectTerm, best: Fit, inflation: float) -> Fit | None:
    """The fit with one effect in a flexible form; None where its linear or actual gain does not beat the best fit."""
    # Parameters that bring most of the gain are freed and fitted first, then those that still gain beside them.
    trial, reached = None, best.objective
    for _ in range(MAX_FORM_EXTENSIONS):
        whole = fitter.evaluate(
            _with_term(fit if trial is None else trial, index, _release_refinements(form)), fit.linearisation
        )
        if reached - whole.objective + fitter.predicted_reduction(whole) < fit.criteria.selection.tie * inflation:
            break
        more = _select_refinements(whole, form, inflation)
        if trial is not None and not more:
            break
        form = form.release(*more)
        # A rough fit suffices for the decision; the last fit is taken to convergence.
        model = _with_term(whole, index, form)
        trial = fitter.fit(model, fit.linearisation, steps=5, relinearisations=0, tolerance=3e-3)
        form, reached = trial.model.active[index], trial.objective
        inflation = max(1.0, min(inflation, trial.chi2_per_dof))
    return trial if trial is not None and trial.objective < best.objective else None


def _release_refinements(form: EffectTerm) -> EffectTerm:
    """An effect with its refinements free, except those that lead from its first form to the second."""
    declared = ((n, form.candidate.named(n)) for n in form.candidate.of_role(ParameterRole.REFINEMENT))
    return form.release(*(n for n, p in declared if p.other_form is None or form.values[n] != p.neutral))


def _with_term(fit: Fit, index: int, form: EffectTerm) -> Model:
    """The model of a fit with one effect in another form."""
    active = list(fit.model.active)
    active[index] = form
    return fit.model.with_active(active)


def _select_refinements(whole: Fit, form: EffectTerm, inflation: float) -> list[str]:
    """Fixed refinements that together bring most of the gain of all fixed ones."""
    free = whole.model.free
    requested = [k for k, (a, n) in enumerate(free) if a.name == form.name and n not in form.free]
    order = [*(k for k in range(len(free)) if k not in requested), *requested]
    normal, right = whole.projected()
    fitted = len(free) - len(requested)
    forms = refinement_groups(whole, form, [free[k][1] for k in order], range(fitted, len(free)), inflation)
    some = select_terms((normal[np.ix_(order, order)], right[order]), fitted, forms, MAX_DEFERRED_FORM_GAIN)
    return [free[order[k]][1] for k in some]


def refinement_groups(
    fit: Fit,
    active: EffectTerm,
    names: Sequence[str],
    which: Iterable[int],
    inflation: float,
    share: float | None = None,
) -> list[tuple[list[int], float]]:
    """Groups of an effect's refinements as column indices, each with the fall of chi2 required of it.

    Details must also remove a `share` of the excess chi2, because they adapt to any missing effect.
    """
    limits = fit.criteria.selection
    first, details = list[int](), list[int]()
    for k in which:
        (details if active.candidate.named(names[k]).detail else first).append(k)
    min_gain = 2.0 * limits.tie * inflation
    if fit.chi2_per_dof <= limits.detected_chi2:
        return [(first, min_gain), (details, min_gain)]
    share = MIN_SHARE_OF_FORM_DETAIL if share is None else share
    return [(first, min_gain), (details, max(min_gain, share * (fit.chi2 - fit.dof)))]
