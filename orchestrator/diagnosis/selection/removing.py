"""Moves that remove effects or put another in an effect's place."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, Library, standardised
from orchestrator.diagnosis.fitting.chords import trial_step
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.form_mixture import mix_forms
from orchestrator.diagnosis.judgement.intervals import certainty
from orchestrator.diagnosis.judgement.verdict import prediction_gain
from orchestrator.diagnosis.selection.adding import added
from orchestrator.diagnosis.selection.contrasts import separable
from orchestrator.diagnosis.selection.scoring import (
    LinearView,
    fits_as_well,
    keep_threshold,
    linear_gain,
    linear_gain_of_absent,
    linear_view,
    log_bayes_factors,
    loss_without,
    redundant_terms,
    score,
)
from orchestrator.diagnosis.selection.search_state import Move, SearchState, evidence_gain
from orchestrator.diagnosis.selection.shape_moves import with_best_shapes
from orchestrator.formatting.names import plain
from orchestrator.formatting.sentences import listed
from protocols import ParameterRole

MAX_EVIDENCE_DEFICIT: float = 0.1
"""Part of an effect's log evidence that another may lack in its place, by prediction and after one step."""
MAX_EFFECTS_IN_OTHER_FORMS: int = 4
"""Number of effects up to which each is compared with other forms of the others: each form is an evaluation."""
NOTEWORTHY_CHI2: float = 1.5
"""chi2 per degree of freedom without an effect above which no refinement of another can replace it."""
MINOR_EFFECT_SIZE: float = 0.15
"""Size of an effect, relative to its typical size, below which it is tested for redundancy."""
MAX_EXCESS_OF_REDUNDANT_EFFECTS: float = 0.03
"""Excess chi2 allowed without the minor effects, over the root of the excess before the first effect."""
OBVIOUS_EFFECT_FACTOR: float = 10.0
"""Factor of that excess from which an effect's linear loss exempts it from the test."""
MIN_EFFECT_SIZE: float = 0.02
"""Size of an effect, relative to its typical size, below which it is not named."""
MIN_UNDETECTED_SIZE: float = 0.03
"""Relative size from which an effect is named although the model fits without it."""
MIN_CERTAINTY: float = 5.0
"""Significance from which a minor effect is named, in standard deviations including the scatter between blocks."""


def remove_moves(state: SearchState) -> Iterator[Move]:
    """Remove effects that the data do not require: all that are needed neither to first order nor in a refit."""
    out = [name for name in redundant_terms(state.fit) if name not in state.needed]
    if out:
        yield Move("remove", tuple(out), partial(_remove_redundant, state, out))
    elif not state.is_part and (factors := log_bayes_factors(state.fit)):
        # To first order all are needed; the fit may have stopped where the others leave less without one, or the
        # weakest may fit noise, and stages that were held out tell.
        weakest = min(factors, key=lambda name: factors[name])
        if weakest not in state.needed:
            yield Move("remove", (weakest,), partial(_remove_redundant, state, [weakest]))
    if not state.is_joint and not state.is_part:
        minor = sorted((a for a in state.fit.model.active if _is_minor(state, a)), key=lambda a: a.relative_size)
        for active in minor:
            yield Move("remove", (active.name, "minor"), partial(_remove_minor, state, active))


def other_form_moves(state: SearchState) -> Iterator[Move]:
    """Remove an effect that may be another one's form: a mixture of the others' forms has about as much evidence.

    A name needs as much more evidence than any other explanation as an effect needs to be added.
    """
    others = len(state.fit.model.active) - 1
    if not state.is_part and 1 <= others < MAX_EFFECTS_IN_OTHER_FORMS:
        factors = log_bayes_factors(state.fit)
        for name in sorted(factors, key=lambda name: factors[name]):
            yield Move("remove", (name, "form"), partial(_remove_other_form, state, name), is_once=True)


def _remove_other_form(state: SearchState, name: str) -> SearchState | None:
    trial = _without(state, [name])
    if trial.chi2_per_dof - 1.0 > state.fit.criteria.verdict.immaterial_excess_chi2:
        return None
    mixture = mix_forms(state.fitter, trial, trial.model.names)
    if mixture is None:
        return None
    worth, by_forms = evidence_gain(state.fit, trial), mixture.log_evidence / state.noise
    taken = by_forms > worth - state.limits.log_evidence
    note = f"another form of {listed([plain(n) for n in mixture.effects])} does as well" if taken else ""
    least = -state.limits.log_evidence
    state.record("remove", (name,), trial, by_forms - worth, least, taken=taken, note=note)
    return replace(state.after(trial), refused=(*state.refused, name)) if taken else None


def _without(state: SearchState, names: Sequence[str]) -> Fit:
    return state.minimum(state.fit.model.with_active([a for a in state.fit.model.active if a.name not in names]))


def _remove_redundant(state: SearchState, out: Sequence[str], *, is_refused: bool = False) -> SearchState:
    """The state without as many of some effects as possible, the weaker first; single ones that are refused are needed.

    A group that is refused is halved (group testing; R. Dorfman, doi:10.1214/aoms/1177731363).
    """
    if not is_refused and (after := _remove(state, out)) is not None:
        return after
    if len(out) == 1:
        return replace(state, needed=state.needed.union(out))
    weaker, stronger = out[: len(out) // 2], out[len(out) // 2 :]
    after = _remove_redundant(state, weaker)
    # Without the weaker half, removing the stronger one is what was refused.
    is_refused = not set(weaker) & set(after.fit.model.names)
    return _remove_redundant(after, stronger, is_refused=is_refused)


def _remove(state: SearchState, out: Sequence[str]) -> SearchState | None:
    trial = _without(state, out)
    lost, max_loss = evidence_gain(state.fit, trial), state.limits.log_evidence * len(out)
    if not state.is_part:
        lost += prediction_gain(state.fit, trial)
    state.record("remove", tuple(out), trial, -lost, -max_loss, taken=lost <= max_loss)
    if lost > max_loss:
        return None
    # What was added to a joint model and removed is not tried again; a first removal may have been wrong.
    refused = [name for name in out if name in state.late or not state.is_joint]
    # In a smaller model, what was needed is needed even more.
    return replace(state.after(trial), refused=(*state.refused, *refused), needed=state.needed)


def _is_minor(state: SearchState, active: EffectTerm) -> bool:
    """Whether an effect is small and its linear loss does not make it obviously necessary."""
    lost = loss_without(state.fit, active, active.candidate.amplitudes) / state.fit.dof
    return active.relative_size < MINOR_EFFECT_SIZE and lost < OBVIOUS_EFFECT_FACTOR * _redundancy_limit(state)


def _redundancy_limit(state: SearchState) -> float:
    """Largest chi2 - 1 allowed without the minor effects."""
    form_error = MAX_EXCESS_OF_REDUNDANT_EFFECTS * math.sqrt(max(state.first_chi2 - 1.0, 0.0))
    return max(state.limits.detected_chi2 - 1.0, form_error)


def _remove_minor(state: SearchState, active: EffectTerm) -> SearchState | None:
    """Remove an effect whose gain may be the others' shape or chance."""
    trial = _without(state, [active.name])
    lost, threshold = evidence_gain(state.fit, trial), keep_threshold(state.fit, active.candidate)
    taken = lost < threshold or (not active.candidate.included_a_priori and _is_redundant(state, trial, active))
    note = "small, uncertain, or what another effect's form makes" if taken else ""
    state.record("remove", (active.name,), trial, -lost, -threshold, taken=taken, note=note)
    return replace(state.after(trial), refused=(*state.refused, active.name)) if taken else None


def _is_redundant(state: SearchState, without: Fit, active: EffectTerm) -> bool:
    size, detected = active.relative_size, state.limits.detected_chi2
    if size < MIN_EFFECT_SIZE or certainty(state.fit)[active.name] < MIN_CERTAINTY:
        return True
    if without.chi2_per_dof < detected and size < MIN_UNDETECTED_SIZE:
        return True
    # Another effect's slightly wrong form would leave a misfit; an effect that removes all of it is real.
    to_the_noise = state.is_explained and without.chi2_per_dof > NOTEWORTHY_CHI2
    if len(state.fit.model.active) < 2 or to_the_noise:
        return False
    return without.chi2_per_dof - 1.0 < _redundancy_limit(state)


def swap_moves(state: SearchState, view: LinearView) -> Iterator[Move]:
    """Replace an effect of a joint model by an absent one; on the whole recording only effects that are new there."""
    pairs = [pair for pair in _swap_pairs(view) if state.is_part or pair[0] in state.late]
    for name, other in pairs[: state.limits.most_trials]:
        yield Move("swap", (name, other.name), partial(_swap, state, name, other), is_once=True)


def _swap_pairs(view: LinearView) -> list[tuple[str, EffectTerm]]:
    """Pairs of an effect and an absent one, at its linear estimate, that makes up for most of the effect's loss."""
    free, normal, right = view.fit.model.free, view.normal, view.right
    amplitudes = [k for k, (a, n) in enumerate(free) if n in a.candidate.amplitudes]
    pairs = []
    for one in view.fit.model.active:
        stay = [k for k in amplitudes if free[k][0].name != one.name]
        go = [k for k in amplitudes if free[k][0].name == one.name]
        away = -np.array([one.standardised_value(free[k][1]) for k in go])
        pull = right + normal[:, go] @ away
        order = [*stay, *go]
        worth, _ = linear_gain(normal[np.ix_(order, order)], pull[order], len(stay), range(len(stay), len(order)))
        for c in view.absent:
            order = [*stay, *view.columns_of(c.name)]
            place = range(len(stay), len(order))
            gain, x = linear_gain_of_absent(c, normal[np.ix_(order, order)], pull[order], len(stay), place)
            if gain > (1.0 - MAX_EVIDENCE_DEFICIT) * worth:
                other = c.absent()
                for n, value in zip(c.amplitudes, x, strict=True):
                    other = other.moved(n, float(value))
                pairs.append((gain / worth, one.name, other))
    return [(name, other) for _, name, other in sorted(pairs, key=lambda pair: -pair[0])]


def _swap(state: SearchState, name: str, other: EffectTerm) -> SearchState | None:
    fit, tie = state.fit, state.limits.tie
    others = [a for a in fit.model.active if a.name != name]
    model = fit.model.with_active([*others, other.release(*other.candidate.of_role(ParameterRole.SHAPE))])
    trial = trial_step(state.fitter, model, fit)
    if evidence_gain(trial, fit) < -tie - MAX_EVIDENCE_DEFICIT * log_bayes_factors(fit)[name]:
        return None
    trial = state.minimum(model, trial)
    gone = _candidate(fit, name)
    gain = evidence_gain(trial, fit) + other.candidate.prior_log_odds - gone.prior_log_odds
    better, lesser = (trial, fit) if gain > 0.0 else (fit, trial)
    are_separable = separable(fit.prepared, other.candidate.effect, gone.effect)
    are_tied = abs(gain) < tie or not are_separable or fits_as_well(lesser, better)
    note = "both do as well" if are_tied else ""
    state.record("swap", (other.name, name), trial, gain, 0.0, taken=gain > 0.0, note=note)
    known = dict(state.indistinguishable)
    if gain > 0.0:
        known[other.name] = (*known.pop(name, ()), name) if are_tied else ()
        return replace(state.after(trial), indistinguishable=known)
    return replace(state, indistinguishable=_with_tie(known, name, other.name)) if are_tied else None


def tied_moves(state: SearchState, library: Library) -> Iterator[Move]:
    """Put an effect that did as well when one was added in that one's place: in its best shape it may do better."""
    for name, others in state.indistinguishable.items():
        for candidate in (c for c in library if c.name in others):
            yield Move("swap", (name, candidate.name), partial(_swap_tied, state, name, candidate), is_once=True)


def _swap_tied(state: SearchState, name: str, candidate: CandidateEffect) -> SearchState | None:
    fit = state.fit
    others = [a for a in fit.model.active if a.name != name]
    alone = state.after(state.fitter.evaluate(fit.model.with_active(others), fit.linearisation))
    rough = added(alone, score(linear_view(state.fitter, alone.fit, [candidate]))[0])
    trial = with_best_shapes(state.after(state.minimum(rough.model, rough))).fit
    gain = evidence_gain(trial, fit)
    taken = gain > state.limits.tie
    state.record("swap", (candidate.name, name), trial, gain, state.limits.tie, taken=taken)
    if not taken:
        return None
    ties, gains = dict(state.indistinguishable), dict(state.gains)
    ties[candidate.name] = (*(n for n in ties.pop(name) if n != candidate.name), name)
    gains[candidate.name] = gains.pop(name)
    return replace(state.after(trial), indistinguishable=ties, gains=gains)


def merge_moves(state: SearchState) -> Iterator[Move]:
    """Keep one of two effects that the recording cannot separate, where it suffices."""
    for one, other in combinations(state.fit.model.active, 2):
        if not separable(state.fit.prepared, one.candidate.effect, other.candidate.effect):
            names = one.name, other.name
            yield Move("merge", names, partial(_merge, state, *names), is_once=True)


def _merge(state: SearchState, one: str, other: str) -> SearchState | None:
    # A lesser effect with the same amplitude's name may have the right form: it is tried too where the other does not
    # suffice, or needs more refinements.
    fit, factors = state.fit, log_bayes_factors(state.fit)
    odds = {name: factors[name] + _candidate(fit, name).prior_log_odds for name in (one, other)}
    lesser, stays = sorted(odds, key=lambda name: odds[name])
    is_same_kind = bool(_shared_amplitudes(fit, one, other))
    sufficient: list[tuple[float, str, Fit]] = []
    for goes, keeps in ((lesser, stays), (stays, lesser))[: 2 if is_same_kind else 1]:
        trial = _with_one_of_both(state, goes, keeps)
        gain = evidence_gain(trial, fit)
        if -gain < keep_threshold(fit, _candidate(fit, goes)):
            sufficient.append((gain + _candidate(fit, keeps).prior_log_odds, keeps, trial))
            if not _needs_more_refinements(fit, keeps, trial):
                break
    if not sufficient:
        return None
    _, keeps, trial = max(sufficient, key=lambda found: found[0])
    gone = stays if keeps == lesser else lesser
    threshold = -state.limits.log_evidence
    state.record("merge", (keeps, gone), trial, evidence_gain(trial, fit), threshold, taken=True)
    indistinguishable = _with_tie(state.indistinguishable, keeps, gone)
    return replace(state.after(trial), indistinguishable=indistinguishable, refused=(*state.refused, gone))


def _with_tie(known: Mapping[str, tuple[str, ...]], name: str, other: str) -> dict[str, tuple[str, ...]]:
    """Alternatives with one more for an effect."""
    return {**known, name: tuple(dict.fromkeys([*known.get(name, ()), other]))}


def _with_one_of_both(state: SearchState, goes: str, keeps: str) -> Fit:
    """The fit without one of two effects, from a start where the other takes over its amplitude."""
    fit = state.fit
    went, stayed = (next(a for a in fit.model.active if a.name == name) for name in (goes, keeps))
    for name in _shared_amplitudes(fit, goes, keeps):
        whole = stayed.values[name] + went.values[name]
        stayed = stayed.moved(name, standardised(stayed.candidate.named(name), whole))
    model = fit.model.with_active([stayed if a.name == keeps else a for a in fit.model.active if a is not went])
    # Two effects of the same kind may together imitate the form of either.
    return with_best_shapes(state.after(state.minimum(model))).fit


def _candidate(fit: Fit, name: str) -> CandidateEffect:
    return next(a.candidate for a in fit.model.active if a.name == name)


def _shared_amplitudes(fit: Fit, one: str, other: str) -> set[str]:
    """Names of amplitudes that two effects share, such as the voltage of a dead time and of a device drop."""
    return set(_candidate(fit, one).amplitudes) & set(_candidate(fit, other).amplitudes)


def _needs_more_refinements(fit: Fit, name: str, trial: Fit) -> bool:
    """Whether an effect has more refinements in a trial than in the fit."""
    before, after = (next(a for a in f.model.active if a.name == name) for f in (fit, trial))
    return len(after.free_refinements) > len(before.free_refinements)
