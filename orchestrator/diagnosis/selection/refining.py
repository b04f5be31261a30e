"""Effects' flexible forms: freed where the evidence asks for them, and taken back where the simple form will do.

The wrong shape of the right effect causes most spurious second ones.
"""

from __future__ import annotations

from collections.abc import Sequence

from orchestrator.diagnosis.fitting.candidates import Active
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.scoring import evidence_for, log_evidence, loss_without
from protocols import ParameterRole


def polished(fitter: Fitter, fit: Fit, inflation: float) -> Fit:
    """The newest effect's flexible form where the evidence asks for it, fitted to the end."""
    plain = fitter.fit(fit.model, fitter.frame(fit.model, fit.frame), steps=4, renewals=0, tolerance=1e-3)
    flexible = _flexible(fitter, plain, len(plain.model.active) - 1, inflation)
    return plain if flexible is None else flexible


def repolished(fitter: Fitter, fit: Fit) -> Fit:
    """The earlier effects' flexible forms, where what hid their worth is now in the model."""
    for index in range(0 if fitter.effort.exhausted else len(fit.model.active) - 1):
        trial = _flexible(fitter, fit, index, 1.0)
        fit = fit if trial is None else trial
    return fit


def settled(fitter: Fitter, fit: Fit) -> Fit:
    """The fit taken to its end; each effect in its simple form again where that does as well now that all is known.

    Else without those refinements that can be spared.
    """
    best = fitter.fit(fit.model, fit.frame, steps=8, renewals=0, tolerance=3e-4)
    for index in range(len(best.model.active)):
        active = best.model.active[index]
        for spared in (active.bent_by, to_spare(best, active)):
            if spared and not fitter.effort.exhausted and (trial := _rigid(fitter, best, index, spared)) is not None:
                best = trial
                break
    return best


def to_spare(fit: Fit, active: Active) -> list[str]:
    """Free refinements of an effect that the data do not ask for, the least asked for first.

    Each by what it costs beside those that are spared already: what is needed does not go in the company of what is
    not. All together they cost no more than a tie.
    """
    spared = [n for n in active.bent_by if active.coordinate(n) == 0.0]
    so_far, lost = evidence_for(fit, active, spared) if spared else 0.0, 0.0
    for name in sorted((n for n in active.bent_by if n not in spared), key=lambda n: evidence_for(fit, active, [n])):
        together = evidence_for(fit, active, [*spared, name])
        cost = max(together - so_far, 0.0)
        if lost + cost <= fit.criteria.selection.tie:
            spared.append(name)
            so_far, lost = together, lost + cost
    return spared


def _rigid(fitter: Fitter, fit: Fit, index: int, names: Sequence[str]) -> Fit | None:
    """The fit without some refinements of one effect; None where they are needed."""
    active, limits = fit.model.active[index], fit.criteria.selection
    if loss_without(fit, active, names) > limits.flexible_form_needed:
        return None
    models = list(fit.model.active)
    models[index] = active.resting(*names)
    trial = fitter.fit(fit.model.with_active(models), fit.frame, steps=8, renewals=0, tolerance=3e-4)
    inflation = max(1.0, min(fit.chi2_per_dof, trial.chi2_per_dof))
    return trial if log_evidence(trial, inflation) > log_evidence(fit, inflation) - limits.tie else None


def _flexible(fitter: Fitter, fit: Fit, index: int, inflation: float) -> Fit | None:
    """The fit with one effect's flexible form; None where it has no more of it or the evidence is against."""
    active = list(fit.model.active)
    names = active[index].candidate.of_role(ParameterRole.REFINEMENT)
    if fitter.effort.exhausted or set(names) <= set(active[index].free):
        return None
    best = fit
    for form in _forms(active[index], fit):
        best = _bent(fitter, fit, index, form, best, inflation) or best
    if best is fit:
        return None
    inflation = max(1.0, min(inflation, best.chi2_per_dof))
    tie = fit.criteria.selection.tie
    return best if log_evidence(best, inflation) > log_evidence(fit, inflation) + tie else None


def _forms(active: Active, fit: Fit) -> list[Active]:
    """An effect's flexible form, begun where it is, and at its second form where the first has not explained all."""
    freed = active.freeing(*active.candidate.of_role(ParameterRole.REFINEMENT))
    other = active.in_other_form() if fit.chi2_per_dof > fit.criteria.selection.detected_chi2 else None
    return [freed] if other is None else [freed, other]


def _bent(fitter: Fitter, fit: Fit, index: int, form: Active, best: Fit, inflation: float) -> Fit | None:
    """The fit with one effect in a flexible form; None where it does no better than the best so far, or promises so."""
    active = list(fit.model.active)
    active[index] = form
    # Whether it pays shows early; the last fit of all is taken to its end.
    trial = fitter.evaluate(fit.model.with_active(active), fit.frame)
    if best.objective - trial.objective + fitter.promise(trial) < fit.criteria.selection.tie * inflation:
        return None
    trial = fitter.fit(trial.model, trial.frame, steps=5, renewals=0, tolerance=3e-3)
    return trial if trial.objective < best.objective else None
