"""Forward search: effects are added one by one while the data require them.

An effect is scored linearly first; the best few are refitted with their shapes free and compared by Laplace
evidence, with the noise inflated by the best chi2 per degree of freedom reached. An accepted effect's shape is
refined before another is tried: the wrong shape of the right effect causes most spurious second ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import MAP_RUNGS, CandidateEffect, EffectTerm, Library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.contributions import Contribution
from orchestrator.diagnosis.selection.contrasts import separable, separating_contrasts
from orchestrator.diagnosis.selection.joint_search import INDISTINGUISHABLE_SHARE
from orchestrator.diagnosis.selection.refining import (
    extend_earlier,
    extend_newest,
    fit_newest,
    fixed_refinements,
    refit_newest,
)
from orchestrator.diagnosis.selection.scoring import (
    LinearView,
    Score,
    add_threshold,
    fits_as_well,
    linear_gain_of_absent,
    linear_view,
    log_evidence,
    refinement_gain,
    score,
)
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number
from protocols import ParameterRole

MIN_SHARE_BEFORE_REFINEMENTS: float = 0.5
"""Part of the excess chi2 that an absent effect has to explain to be tried before refinements."""
MIN_EFFECT_SIZE: float = 0.02
"""Size of an effect, relative to its typical size, below which it is not named."""
MIN_SHARE_OF_EXCESS: float = 0.2
"""Part of the excess chi2 - 1 that an effect has to remove to be added; half of it in the linear estimate."""
MIN_RELATIVE_LINEAR_GAIN: float = 0.3
"""Linear gain of an alternative, relative to the best one's, from which it is refitted too."""
MAX_EXCESS_RATIO_TO_BEST: float = 2.0
"""Factor of the best alternative's excess chi2 up to which others are fitted to convergence."""
SHAPE_STARTS: tuple[float, ...] = (-2.0, -1.0, 1.0)
"""Initial shapes of a refit besides the typical one, in standard deviations of the prior."""


@dataclass(frozen=True)
class AcceptedModel:
    """One step of the ladder: the effect added, the model refitted with it, and the gain in log evidence [nat]."""

    added: str | None
    fit: Fit
    log_evidence: float = 0.0


def refit_steps(setup: DiagnosisSetup, steps: Sequence[AcceptedModel]) -> list[AcceptedModel]:
    """The models refitted with the setup's noise."""
    return [replace(step, fit=setup.fitter.fit(step.fit.model)) for step in steps]


@dataclass
class SearchResult:
    """The ladder of models that a search has accepted, and its findings beside them."""

    steps: list[AcceptedModel]
    detected_not_named: list[str] = field(default_factory=list)
    indistinguishable: dict[str, list[str]] = field(default_factory=dict)
    """For an accepted effect, those that fit as well in its place."""
    view: LinearView | None = None
    """Linear view of the last fit; None before it is needed."""
    has_deferred_refinements: bool = False
    """Whether the newest effect's refinements are postponed until an absent effect that explains more is added."""
    below_materiality: tuple[str, ...] = ()
    """Effects of the last fit that are too small to be causes."""
    contributions: Mapping[str, Contribution] = field(default_factory=dict)
    """Contribution of each effect of a joint fit; empty after a forward search."""

    @property
    def fit(self) -> Fit:
        return self.steps[-1].fit

    @property
    def baseline_models(self) -> list[AcceptedModel]:
        """The models without any effect: the first, and those that only free the map."""
        return [step for step in self.steps if step.added is None or step.added in MAP_RUNGS]


def forward(
    fitter: Fitter,
    steps: Sequence[AcceptedModel],
    candidates: Library,
    *,
    indistinguishable: Mapping[str, Sequence[str]] | None = None,
    max_effects: int | None = None,
) -> SearchResult:
    """Add effects to the last model until the data require no more.

    Parameters
    ----------
    indistinguishable : mapping, optional
        For each effect of the given models, those that fit as well in its place.
    max_effects : int, optional
        Maximum number of effects in the model; the criteria's by default.
    """
    max_effects = fitter.prepared.criteria.selection.most_effects if max_effects is None else max_effects
    search = SearchResult(
        list(steps), indistinguishable={name: list(tied) for name, tied in (indistinguishable or {}).items()}
    )
    # An alternative to an accepted effect is not separable from it.
    rejected = {n for tied in (indistinguishable or {}).values() for n in tied}
    while len(search.fit.model.active) < max_effects and not fitter.budget.is_spent:
        if not _add_best(fitter, search, candidates, rejected) and not _free_deferred(fitter, search):
            break
    search.detected_not_named = [n for n in dict.fromkeys(search.detected_not_named) if n not in search.fit.model.names]
    return search


def _current_view(fitter: Fitter, search: SearchResult, candidates: Library) -> LinearView:
    """The linear view of the search's last fit, computed once."""
    if search.view is None or search.view.fit.model is not search.fit.model:
        search.view = linear_view(fitter, search.fit, candidates)
    return search.view


def _add_best(fitter: Fitter, search: SearchResult, candidates: Library, rejected: set[str]) -> bool:
    """Add the effect with the largest evidence, or reject it; False where no candidate exceeds the thresholds."""
    fit, limits = search.fit, fitter.prepared.criteria.selection
    rejected |= _inseparable(fit, candidates)
    view = _current_view(fitter, search, candidates)
    scores = [s for s in score(view) if s.candidate.name not in rejected]
    shortlist = _shortlist(scores, fit)
    if scores:
        fitter.trace.record(
            "screen",
            [s.candidate.name for s in shortlist or scores[:1]],
            before=fit,
            measure="chi2",
            score=scores[0].gain,
            threshold=_min_gain(scores[0], fit),
            taken=None if shortlist else False,
        )
    if not shortlist:
        search.detected_not_named += _sub_threshold_effects(scores, fit)
        return False
    fitter.under_way(f"which is missing? {', '.join(plain(s.candidate.name) for s in shortlist)}")
    trials = _refit_all(fitter, fit, shortlist)
    inflation = max(1.0, min(t.chi2_per_dof for _, t in trials))
    before = log_evidence(fit, inflation)
    prior_log_odds = {c.name: c.prior_log_odds for c in candidates}
    weighed = ((log_evidence(t, inflation) - before + prior_log_odds[n], n, t) for n, t in trials)
    ranked = sorted(weighed, key=lambda item: -item[0])
    gain, name, trial = ranked[0]
    record = partial(fitter.trace.record, before=fit, measure="log_evidence", threshold=limits.log_evidence)
    for g, n, t in ranked:
        record("refit", [n], after=t, score=g)
    if gain < limits.log_evidence:
        record("add", [name], after=trial, score=gain, taken=False)
        return False
    if _size(trial, name) < MIN_EFFECT_SIZE or _share(fit, trial) < MIN_SHARE_OF_EXCESS:
        note = "too small, or removes too little of the misfit"
        record("add", [name], after=trial, score=gain, taken=False, note=note)
        rejected.update(n for g, n, _ in ranked if g > limits.log_evidence)
        search.detected_not_named.append(name)
        return True
    search.indistinguishable[name] = [
        n
        for g, n, t in ranked[1:]
        if gain - g < limits.tie or fits_as_well(t, trial) or _is_indistinguishable(fit, trial, t, name, n)
    ]
    _accept(fitter, search, AcceptedModel(name, trial, gain), candidates, inflation)
    if search.fit.objective > fit.objective:
        # The linear prediction failed: the objective rose after the full refit.
        note = "the complete refit leaves more than before"
        record("add", [name], after=search.fit, score=gain, taken=False, note=note)
        search.steps.pop()
        search.view = None
        rejected.add(name)
        search.detected_not_named.append(name)
        return True
    record("add", [name], after=search.fit, score=gain, taken=True)
    rejected.clear()
    rejected.update(n for tied in search.indistinguishable.values() for n in tied)
    return True


def _accept(fitter: Fitter, search: SearchResult, step: AcceptedModel, candidates: Library, inflation: float) -> None:
    """Add an effect to the model, and free refinements unless an absent effect explains more of the residual."""
    fit = fit_newest(fitter, step.fit)
    search.view = linear_view(fitter, fit, candidates, fixed_refinements(fit.model.active[-1:]))
    search.has_deferred_refinements = _outweighs_refinements(search.view, _inseparable(fit, candidates))
    if not search.has_deferred_refinements:
        fit = extend_earlier(fitter, extend_newest(fitter, fit, inflation))
    search.steps.append(replace(step, fit=fit))
    fitter.tell(f"+ {plain(step.added or '')}: chi2 {number(search.fit.chi2_per_dof)}")


def _free_deferred(fitter: Fitter, search: SearchResult) -> bool:
    """Free the postponed refinements, as no other effect was added; False where none are postponed."""
    if not search.has_deferred_refinements:
        return False
    search.has_deferred_refinements = False
    search.steps[-1] = replace(search.steps[-1], fit=extend_earlier(fitter, extend_newest(fitter, search.fit, 1.0)))
    return True


def _outweighs_refinements(view: LinearView, inseparable: set[str]) -> bool:
    """Whether an absent effect explains most of the residual, and more than the newest effect's refinements."""
    # Refinements would adapt to the missing effect; they are tried again once it is in the model.
    scores, fit = [s for s in score(view) if s.candidate.name not in inseparable], view.fit
    min_gain = MIN_SHARE_BEFORE_REFINEMENTS * (fit.chi2 - fit.dof)
    return bool(scores) and scores[0].gain > max(refinement_gain(view), min_gain)


def _inseparable(fit: Fit, candidates: Library) -> set[str]:
    """Candidates that this recording cannot separate from an effect of the model."""
    return {
        c.name
        for c in candidates
        for a in fit.model.active
        if c.name != a.name and not separable(fit.prepared, c.effect, a.candidate.effect)
    }


def _is_indistinguishable(before: Fit, best: Fit, other: Fit, name: str, other_name: str) -> bool:
    """Whether an alternative that the recording cannot separate from the best effect explains nearly as much."""
    effects = {a.name: a.candidate.effect for t in (best, other) for a in t.model.active}
    if separable(before.prepared, effects[name], effects[other_name]):
        return False
    return before.chi2 - other.chi2 > INDISTINGUISHABLE_SHARE * (before.chi2 - best.chi2)


def _shortlist(scores: Sequence[Score], fit: Fit) -> list[Score]:
    """The best few by linear gain, and effects that may be confused with the best; empty if that gains too little."""
    if not scores:
        return []
    best, limits = scores[0], fit.criteria.selection
    inflation = max(1.0, (fit.chi2 - best.gain) / fit.dof)

    def min_gain(s: Score) -> float:
        return 2.0 * add_threshold(fit, s.candidate) * inflation

    if best.gain < _min_gain(best, fit):
        return []

    def resembles_best(s: Score) -> bool:
        return bool(separating_contrasts(s.candidate.effect, best.candidate.effect))

    shortlist = [s for s in scores if s.gain > MIN_RELATIVE_LINEAR_GAIN * best.gain or resembles_best(s)]
    return [s for s in shortlist if s.gain > min_gain(s)][: limits.most_trials]


def _min_gain(best: Score, fit: Fit) -> float:
    """Linear gain required of the best effect, half of what its refit has to reach: a free shape adds to it."""
    inflation = max(1.0, (fit.chi2 - best.gain) / fit.dof)
    share = 0.5 * MIN_SHARE_OF_EXCESS
    return max(2.0 * add_threshold(fit, best.candidate) * inflation, share * (fit.chi2 - fit.dof))


def _sub_threshold_effects(scores: Sequence[Score], fit: Fit) -> list[str]:
    """Effects whose linear gain is significant although they explain little of the residual."""
    inflation = max(1.0, fit.chi2_per_dof)
    return [s.candidate.name for s in scores[:3] if s.gain > 2.0 * add_threshold(fit, s.candidate) * inflation]


def _size(fit: Fit, name: str) -> float:
    return next(a.relative_size for a in fit.model.active if a.name == name)


def _share(before: Fit, after: Fit) -> float:
    """Part of the excess chi2 that is removed."""
    # Where the noise is overestimated, the floor is below one.
    floor = min(1.0, after.chi2_per_dof)
    excess = before.chi2_per_dof - floor
    return (before.chi2_per_dof - after.chi2_per_dof) / excess if excess > 0.0 else 0.0


def with_effect(fitter: Fitter, fit: Fit, candidate: CandidateEffect) -> Fit:
    """The model refitted with one named effect, in its flexible form where the evidence requires it."""
    scored = score(linear_view(fitter, fit, [candidate]))[0]
    return refit_newest(fitter, _refit(fitter, fit, scored), 1.0)


def _refit_all(fitter: Fitter, fit: Fit, shortlist: Sequence[Score]) -> list[tuple[str, Fit]]:
    """Refits with each effect of the shortlist; only those near the best are fitted to convergence."""
    rough = [(s.candidate.name, _refit(fitter, fit, s)) for s in shortlist]
    best = min(t.chi2 for _, t in rough)
    near = MAX_EXCESS_RATIO_TO_BEST * max(best - fit.dof, 0.1 * fit.dof) + fit.dof
    if sum(t.chi2 < near for _, t in rough) < 2:
        return rough
    return [
        (n, fitter.fit(t.model, t.linearisation, steps=5, relinearisations=0) if t.chi2 < near else t) for n, t in rough
    ]


def _refit(fitter: Fitter, fit: Fit, scored: Score) -> Fit:
    """The model refitted with one more effect from its best linear estimate, its shape free, converged shapes held."""
    active = _best_start(fitter, fit, scored)
    active = active.release(*scored.candidate.of_role(ParameterRole.SHAPE))
    with_others_fixed = [replace(a, free=a.candidate.amplitudes) for a in fit.model.active]
    rough = fitter.fit(
        fit.model.with_active([*with_others_fixed, active]),
        fit.linearisation,
        steps=4,
        relinearisations=0,
        tolerance=0.03,
    )
    released = [replace(a, free=b.free) for a, b in zip(rough.model.active, [*fit.model.active, active], strict=True)]
    return fitter.evaluate(rough.model.with_active(released), fit.linearisation) if with_others_fixed else rough


def _best_start(fitter: Fitter, fit: Fit, scored: Score) -> EffectTerm:
    """The absent effect at its linear estimate for the best of a few shapes, as a descent finds a local minimum."""
    candidate = scored.candidate
    best, gain, coordinates = candidate.absent(), scored.gain, scored.coordinates
    for shape in candidate.of_role(ParameterRole.SHAPE)[:1]:
        variants = [candidate.absent().moved(shape, x) for x in SHAPE_STARTS]
        columns = [(v, n) for v in variants for n in candidate.amplitudes]
        normal, right = fitter.evaluate(fit.model, fit.linearisation, columns, known=fit).projected()
        fitted, each = len(fit.model.free), len(candidate.amplitudes)
        for k, variant in enumerate(variants):
            amplitudes = list(range(fitted + k * each, fitted + (k + 1) * each))
            estimate = linear_gain_of_absent(candidate, normal, right, fitted, amplitudes)
            if estimate[0] > gain:
                best, gain, coordinates = variant, *estimate
    for name, x in zip(candidate.amplitudes, coordinates, strict=True):
        best = best.moved(name, float(x))
    return best
