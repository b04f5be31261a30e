"""Moves that add effects: one with the largest evidence, or all of the library at once.

An effect is screened by a score test; the best few are refitted with their shapes free, and compared by Laplace
evidence, with the noise inflated by the best chi2 per degree of freedom reached.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

from orchestrator.diagnosis.fitting.baseline import with_finest_map
from orchestrator.diagnosis.fitting.candidates import EffectTerm, Library
from orchestrator.diagnosis.fitting.chords import trial_step
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.contrasts import inseparable_from, separating_contrasts
from orchestrator.diagnosis.selection.scoring import (
    LinearView,
    Score,
    add_threshold,
    fits_as_well,
    linear_gain_of_absent,
    log_evidence,
    score,
)
from orchestrator.diagnosis.selection.search_state import Move, SearchState
from orchestrator.formatting.names import plain
from protocols import ParameterRole

MIN_SHARE_OF_EXCESS: float = 0.2
"""Part of the excess chi2 - 1 that an effect has to remove to be added; half of it in the linear estimate."""
MIN_RELATIVE_LINEAR_GAIN: float = 0.3
"""Linear gain of an alternative, relative to the best one's, from which it is refitted too."""
MIN_SHARE_ON_ONE_MAP: float = 0.5
"""Part of the excess chi2 that the best effect has to remove for all to be compared on the same map."""
MAX_EXCESS_RATIO_TO_BEST: float = 2.0
"""Factor of the best alternative's excess chi2 up to which others are fitted to convergence."""
INDISTINGUISHABLE_SHARE: float = 0.8
"""Fall of chi2 by an alternative, relative to the best one's, from which they are indistinguishable."""
SHAPE_STARTS: tuple[float, ...] = (-2.0, -1.0, 1.0)
"""Initial shapes of a refit besides the typical one, in standard deviations of the prior."""


def add_moves(state: SearchState, view: LinearView, library: Library) -> Iterator[Move]:
    """Add the absent effects with the largest gain: one, or in a joint model all that gain much."""
    shortlist = _shortlist(state, _scores(state, view, library))
    if shortlist:
        add = _add_to_joint if state.is_joint else _add_best
        effects = tuple(s.candidate.name for s in shortlist)
        yield Move("add", effects, partial(add, state, shortlist), shortlist[0].gain)


def record_screen(state: SearchState, view: LinearView, library: Library) -> None:
    """Record the predicted gains of absent effects in the trace."""
    scores = _scores(state, view, library)
    shortlist = _shortlist(state, scores)
    if scores:
        effects, needed = tuple(s.candidate.name for s in shortlist or scores[:1]), _min_gain(state, scores[0])
        taken = None if shortlist else False
        state.record("screen", effects, None, scores[0].gain, needed, measure="chi2", taken=taken)


def _scores(state: SearchState, view: LinearView, library: Library) -> list[Score]:
    """Scores of the absent effects that may be added."""
    rejected = set(state.refused) if state.is_joint else {*state.refused, *_inseparable(state, library)}
    return [s for s in score(view) if s.candidate.name not in rejected]


def sub_threshold_effects(state: SearchState, view: LinearView) -> list[str]:
    """Absent effects whose linear gain is significant although they explain little of the residual."""
    return [s.candidate.name for s in score(view)[:3] if s.gain > _significant(state, s, state.noise)]


def full_model(state: SearchState, library: Library) -> SearchState:
    """The amplitudes of all effects of the library, fitted together."""
    present = {active.name: active for active in state.fit.model.active}
    model = state.fit.model.with_active([present.get(c.name, c.absent()) for c in library])
    joint = replace(state, is_joint=True, refused=())
    fit = joint.minimum(model)
    state.record("full_model", fit.model.names, fit, None, None, taken=True)
    return joint.after(fit)


def added(state: SearchState, scored: Score) -> Fit:
    """The model refitted with one more effect from its best linear estimate, its shape free, converged shapes held."""
    fit = state.fit
    active = _best_start(state, scored).release(*scored.candidate.of_role(ParameterRole.SHAPE))
    others_fixed = [replace(a, free=a.candidate.amplitudes) for a in fit.model.active]
    model = fit.model.with_active([*others_fixed, active])
    rough = state.fitter.fit(model, fit.linearisation, steps=4, relinearisations=0, tolerance=0.03)
    released = [replace(a, free=b.free) for a, b in zip(rough.model.active, [*fit.model.active, active], strict=True)]
    return state.fitter.evaluate(rough.model.with_active(released), fit.linearisation) if others_fixed else rough


def _add_best(state: SearchState, shortlist: Sequence[Score]) -> SearchState | None:
    """Add the effect with the largest evidence; where it explains too little, it is refused."""
    fit, limits = state.fit, state.limits
    state.fitter.under_way(f"testing {', '.join(plain(s.candidate.name) for s in shortlist)}")
    trials = _refit_all(state, shortlist)
    inflation = max(1.0, min(trial.chi2_per_dof for trial in trials))
    before, odds = log_evidence(fit, inflation), [s.candidate.prior_log_odds for s in shortlist]
    gains = [log_evidence(trial, inflation) - before + more for trial, more in zip(trials, odds, strict=True)]
    ranked = sorted(zip(gains, [s.candidate.name for s in shortlist], trials, strict=True), key=lambda one: -one[0])
    for gain, name, trial in ranked:
        state.record("refit", (name,), trial, gain, limits.log_evidence, taken=None)
    gain, name, best = ranked[0]
    if gain < limits.log_evidence:
        state.record("add", (name,), best, gain, limits.log_evidence, taken=False)
        return None
    if _share(fit, best) < MIN_SHARE_OF_EXCESS:
        note = "removes too little of the misfit"
        state.record("add", (name,), best, gain, limits.log_evidence, taken=False, note=note)
        return replace(state, refused=(*state.refused, *(n for g, n, _ in ranked if g > limits.log_evidence)))
    others = tuple(
        other
        for g, other, trial in ranked[1:]
        if gain - g < limits.tie or fits_as_well(trial, best) or _is_indistinguishable(state, best, trial)
    )
    grown = state.minimum(best.model, best)
    taken = grown.objective < fit.objective
    note = "" if taken else "the complete refit leaves more than before"
    state.record("add", (name,), grown, gain, limits.log_evidence, taken=taken, note=note)
    if not taken:
        return replace(state, refused=(*state.refused, name))
    indistinguishable = {**state.indistinguishable, name: others}
    known = {**state.gains, name: gain}
    return replace(state.after(grown), indistinguishable=indistinguishable, gains=known, refused=())


def _add_to_joint(state: SearchState, shortlist: Sequence[Score]) -> SearchState | None:
    """Add effects to a joint model; those that it does not need are removed again."""
    terms = []
    for one in shortlist:
        term = one.candidate.absent().release(*one.candidate.of_role(ParameterRole.SHAPE))
        for name, x in zip(one.candidate.amplitudes, one.coordinates, strict=True):
            term = term.moved(name, float(x))
        terms.append(term)
    names, model = tuple(term.name for term in terms), state.fit.model.with_active([*state.fit.model.active, *terms])
    trial = trial_step(state.fitter, model, state.fit)
    if trial.objective < state.fit.objective:
        trial = state.minimum(trial.model, trial)
    gain = state.fit.objective - trial.objective
    state.record("add", names, trial, gain, 0.0, measure="objective", taken=gain > 0.0)
    if gain <= 0.0:
        return replace(state, refused=(*state.refused, *names))
    return replace(state.after(trial), late=state.late.union(names))


def _inseparable(state: SearchState, library: Library) -> set[str]:
    """Candidates that this recording cannot separate from an effect of the model, or that fit as well as one."""
    active = state.fit.model.active
    tied = {name for others in state.indistinguishable.values() for name in others}
    return tied.union(*(inseparable_from(state.fitter, state.fit, present, library) for present in active))


def _is_indistinguishable(state: SearchState, best: Fit, other: Fit) -> bool:
    """Whether an alternative that the recording cannot separate from the best effect explains nearly as much."""
    if state.fit.chi2 - other.chi2 <= INDISTINGUISHABLE_SHARE * (state.fit.chi2 - best.chi2):
        return False
    newest, alternative = best.model.active[-1], other.model.active[-1].candidate
    return alternative.name in inseparable_from(state.fitter, best, newest, [alternative])


def _shortlist(state: SearchState, scores: Sequence[Score]) -> list[Score]:
    """The best few by linear gain, and effects that may be confused with the best; empty if that gains too little."""
    if not scores or scores[0].gain < _min_gain(state, scores[0]):
        return []
    best, noise = scores[0], _noise_with(state, scores[0])

    def is_rival(s: Score) -> bool:
        alike = not state.is_joint and bool(separating_contrasts(s.candidate.effect, best.candidate.effect))
        return s.gain > MIN_RELATIVE_LINEAR_GAIN * best.gain or alike

    return [s for s in scores if is_rival(s) and s.gain > _significant(state, s, noise)][: state.limits.most_trials]


def _min_gain(state: SearchState, best: Score) -> float:
    """Linear gain required of the best effect, half of what its refit has to reach: a free shape adds to it."""
    share = 0.5 * MIN_SHARE_OF_EXCESS
    return max(_significant(state, best, _noise_with(state, best)), share * (state.fit.chi2 - state.fit.dof))


def _noise_with(state: SearchState, best: Score) -> float:
    """The residual's variance with the best effect, relative to the known noise; in a joint model the present one."""
    return state.noise if state.is_joint else max(1.0, (state.fit.chi2 - best.gain) / state.fit.dof)


def _significant(state: SearchState, s: Score, noise: float) -> float:
    """Fall of chi2 from which an effect is significant."""
    return 2.0 * add_threshold(state.fit, s.candidate) * noise


def _share(before: Fit, after: Fit) -> float:
    """Part of the excess chi2 that is removed."""
    # Where the noise is overestimated, the floor is below one.
    floor = min(1.0, after.chi2_per_dof)
    excess = before.chi2_per_dof - floor
    return (before.chi2_per_dof - after.chi2_per_dof) / excess if excess > 0.0 else 0.0


def _refit_all(state: SearchState, shortlist: Sequence[Score]) -> list[Fit]:
    """Refits with each effect of the shortlist.

    On a map that is too coarse the right effect may remove little. Where none removes much of a part's misfit, each is
    given the finest map that it justifies.
    """
    trials = _converged(state, shortlist)
    may_be_map = state.is_part and state.fit.model.space.is_free and len(trials) > 1
    if not may_be_map or max(_share(state.fit, trial) for trial in trials) > MIN_SHARE_ON_ONE_MAP:
        return trials
    return [with_finest_map(state.setup, state.fitter, trial) for trial in trials]


def _converged(state: SearchState, shortlist: Sequence[Score]) -> list[Fit]:
    """Refits on the present map; only those near the best are fitted to convergence."""
    rough = [added(state, scored) for scored in shortlist]
    dof = state.fit.dof
    near = MAX_EXCESS_RATIO_TO_BEST * max(min(trial.chi2 for trial in rough) - dof, 0.1 * dof) + dof
    if sum(trial.chi2 < near for trial in rough) < 2:
        return rough
    return [
        state.fitter.fit(trial.model, trial.linearisation, steps=5, relinearisations=0) if trial.chi2 < near else trial
        for trial in rough
    ]


def _best_start(state: SearchState, scored: Score) -> EffectTerm:
    """The absent effect at its linear estimate for the best of a few shapes, as a descent finds a local minimum."""
    fit, candidate = state.fit, scored.candidate
    best, gain, coordinates = candidate.absent(), scored.gain, scored.coordinates
    for shape in candidate.of_role(ParameterRole.SHAPE)[:1]:
        variants = [candidate.absent().moved(shape, x) for x in SHAPE_STARTS]
        columns = [(v, n) for v in variants for n in candidate.amplitudes]
        normal, right = state.fitter.evaluate(fit.model, fit.linearisation, columns, known=fit).projected()
        fitted, each = len(fit.model.free), len(candidate.amplitudes)
        for k, variant in enumerate(variants):
            amplitudes = list(range(fitted + k * each, fitted + (k + 1) * each))
            estimate = linear_gain_of_absent(candidate, normal, right, fitted, amplitudes)
            if estimate[0] > gain:
                best, gain, coordinates = variant, *estimate
    for name, x in zip(candidate.amplitudes, coordinates, strict=True):
        best = best.moved(name, float(x))
    return best
