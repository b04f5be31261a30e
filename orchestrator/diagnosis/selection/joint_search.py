"""Joint search: all effects are in the model from the start, then backward elimination by evidence.

With many small effects, forward search depends on the order: the wrong shape of the first draws in others. A joint fit
under the priors has no order. First amplitudes are fitted, then shapes and flexible forms of significant effects; last,
effects that the data do not require are removed (Savage and Dickey, doi:10.1214/aoms/1177693507).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, Library, standardised
from orchestrator.diagnosis.fitting.chords import fit_with_frozen_jacobian, trial_step
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.judgement.intervals import BLOCKS, block_scatter
from orchestrator.diagnosis.selection.contrasts import separable
from orchestrator.diagnosis.selection.refining import fixed_refinements, refinement_groups
from orchestrator.diagnosis.selection.scoring import (
    add_threshold,
    fits_as_well,
    keep_threshold,
    linear_gain,
    linear_gain_of_absent,
    linear_view,
    log_density_ratio,
    log_evidence,
    score,
    select_terms,
)
from orchestrator.numerics.types import Array
from protocols import Effect, ParameterRole, SearchMove

MIN_GAIN_OF_SECOND_EFFECT: float = 0.3
"""Part of the largest predicted gain of an absent effect from which another one is tried together with it."""
MAX_JOINT_ROUNDS: tuple[int, int] = (6, 15)
"""Relinearisations of the model with all effects: with amplitudes alone, and with shapes."""
JOINT_TOLERANCE: float = 1e-2
"""Gain of a round of the joint fit, as a part of the excess chi2, below which it ends."""
INDISTINGUISHABLE_SHARE: float = 0.8
"""Fall of chi2 by an alternative, relative to the best one's, from which they are indistinguishable."""
MAX_EVIDENCE_DEFICIT: float = 0.1
"""Part of an effect's log evidence missing after one step with another in its place, above which the trial ends."""
MAX_CHI2_RATIO_OF_SECOND_FORM: float = 10.0
"""Factor of the first form's chi2 that the second may leave after one step; beyond, the trial ends. On switching
benches it was 1.1 where the second form did better, and 90 where it did not."""


def fit_full_model(fitter: Fitter, start: Model, library: Library) -> Fit:
    """Fit the amplitudes of all effects of the library together, each effect in the better of its forms.

    Parameters
    ----------
    start : Model
        Initial map and effects.
    """
    limits = fitter.prepared.criteria.selection
    fit = refit_briefly(fitter, with_all_effects(start, library))
    fitter.trace.record("full_model", fit.model.names, after=fit, taken=True)
    for other in (c.absent_in_alternative_form() for c in library):
        if other is None or fit.chi2_per_dof <= limits.detected_chi2:
            continue
        model = _with_form(fit.model, other)
        if trial_step(fitter, model, fit).chi2_per_dof <= MAX_CHI2_RATIO_OF_SECOND_FORM * fit.chi2_per_dof:
            trial = refit_briefly(fitter, model, fit)
            _record_form(fitter, other.name, fit, trial, taken=trial.objective < fit.objective)
            fit = trial if trial.objective < fit.objective else fit
    return fit


def _record_form(fitter: Fitter, name: str, fit: Fit, trial: Fit, *, taken: bool) -> None:
    gain = fit.objective - trial.objective
    fitter.trace.record(
        "switch_form", [name], before=fit, after=trial, measure="objective", score=gain, threshold=0.0, taken=taken
    )


def with_all_effects(model: Model, library: Library) -> Model:
    """The model with all other effects of the library added at neutral."""
    present = {active.name: active for active in model.active}
    return model.with_active([present.get(c.name, c.absent()) for c in library])


def free_own_shapes(fitter: Fitter, fit: Fit) -> Fit:
    """Free the shapes of significant effects, and flexible forms where the evidence requires them."""
    known = fit if fit.linearisation.noise is fitter.noise else None
    given, fit = fit, refit(fitter, release_shapes(fitter, fit), known)
    fit = refit(fitter, release_refinements(fitter, fit, share=math.inf), fit)
    _record_shapes(fitter, given, fit)
    return fit


def _record_shapes(fitter: Fitter, fit: Fit, freer: Fit) -> None:
    before = {a.name: len(a.free) for a in fit.model.active}
    freed = [a.name for a in freer.model.active if len(a.free) > before.get(a.name, 0)]
    if not freed:
        return
    gain = fit.objective - freer.objective
    fitter.trace.record("free_shape", freed, before=fit, after=freer, measure="objective", score=gain, taken=True)


def joint_search(fitter: Fitter, fit: Fit, library: Library) -> tuple[Fit, dict[str, list[str]]]:
    """Search from a joint fit: effects that the data require, and for each the alternatives that fit as well.

    Parameters
    ----------
    fit : Fit
        Fit of all effects, their forms free.
    """
    fit, indistinguishable = swap_step(fitter, backward_elimination(fitter, fit), library)
    fit, doubles = merge_indistinguishable(fitter, backward_elimination(fitter, forward_step(fitter, fit, library)))
    fit = free_remaining_shapes(fitter, fit)
    return fit, {
        name: [*indistinguishable.get(name, []), *doubles.get(name, [])] for name in {**indistinguishable, **doubles}
    }


def free_remaining_shapes(fitter: Fitter, fit: Fit) -> Fit:
    """Free the shapes and flexible forms that have become significant since the last release."""
    for form in (release_shapes, partial(release_refinements, share=0.0)):
        while fit.chi2_per_dof > fit.criteria.selection.detected_chi2:
            freed = form(fitter, fit)
            if len(freed.free) == len(fit.model.free):
                break
            given, fit = fit, refit(fitter, freed, fit)
            _record_shapes(fitter, given, fit)
    return fit


def refit(fitter: Fitter, model: Model, known: Fit | None = None) -> Fit:
    """Fit a model with many effects with frozen Jacobians, up to `MAX_JOINT_ROUNDS` relinearisations."""
    return fit_with_frozen_jacobian(fitter, model, rounds=MAX_JOINT_ROUNDS[1], tolerance=JOINT_TOLERANCE, known=known)


def refit_briefly(fitter: Fitter, model: Model, known: Fit | None = None) -> Fit:
    """`refit` with the few relinearisations that amplitudes need."""
    return fit_with_frozen_jacobian(fitter, model, rounds=MAX_JOINT_ROUNDS[0], tolerance=JOINT_TOLERANCE, known=known)


def forward_step(fitter: Fitter, fit: Fit, library: Library) -> Fit:
    """Add the absent effects that are significant to first order beside the present fit.

    An effect whose first step went to the wrong side of a bound has stayed at neutral. Effects that gain much less than
    the best may explain the same error: they are tested again once that one is in the model.
    """
    noise = max(fit.chi2_per_dof, 1.0)
    asking = [
        s for s in score(linear_view(fitter, fit, library)) if s.gain > 2.0 * add_threshold(fit, s.candidate) * noise
    ]
    if not asking:
        return fit
    best_gain = max(s.gain for s in asking)
    overlooked = []
    for one in (s for s in asking if s.gain > MIN_GAIN_OF_SECOND_EFFECT * best_gain):
        active = one.candidate.absent().release(*one.candidate.of_role(ParameterRole.SHAPE))
        for name, x in zip(one.candidate.amplitudes, one.coordinates, strict=True):
            active = active.moved(name, float(x))
        overlooked.append(active)
    more = refit(fitter, fit.model.with_active([*fit.model.active, *overlooked]), fit)
    fitter.trace.record(
        "add",
        [active.name for active in overlooked],
        before=fit,
        after=more,
        measure="objective",
        score=fit.objective - more.objective,
        threshold=0.0,
        taken=more.objective < fit.objective,
    )
    if more.objective >= fit.objective:
        return fit
    return forward_step(fitter, more, library) if len(overlooked) < len(asking) else more


def release_shapes(_: Fitter, fit: Fit) -> Model:
    """The model with the shapes of significant effects free."""
    shown, threshold = log_bayes_factors(fit), fit.criteria.selection.log_evidence
    shapes = (ParameterRole.SHAPE,)
    return fit.model.with_active(
        [a.release(*a.candidate.of_role(*shapes)) if shown[a.name] > threshold else a for a in fit.model.active]
    )


def release_refinements(fitter: Fitter, fit: Fit, share: float | None = None) -> Model:
    """The model with flexible forms free where their linear gain is sufficient.

    Only parameters that bring nearly all of the gain are freed. Details must also remove a `share` of the excess chi2.
    """
    rigid = fixed_refinements(fit.model.active)
    view = fitter.evaluate(fit.model, fit.linearisation, rigid, known=fit).projected()
    names = [n for _, n in (*fit.model.free, *rigid)]
    fitted, noise = len(fit.model.free), max(fit.chi2_per_dof, 1.0)
    active = []
    for one in fit.model.active:
        own_columns = (fitted + k for k, (a, _) in enumerate(rigid) if a.name == one.name)
        forms = refinement_groups(fit, one, names, own_columns, noise, share)
        active.append(one.release(*(names[k] for k in select_terms(view, fitted, forms))))
    return fit.model.with_active(active)


def _record_evidence(
    fitter: Fitter,
    move: SearchMove,
    effects: Sequence[str],
    fits: tuple[Fit, Fit],
    gain: float,
    threshold: float,
    *,
    taken: bool,
    note: str = "",
) -> None:
    """Record a move decided by the log evidence of two fits."""
    before, after = fits
    fitter.trace.record(
        move,
        effects,
        before=before,
        after=after,
        measure="log_evidence",
        score=gain,
        threshold=threshold,
        taken=taken,
        note=note,
    )


def _with_form(model: Model, form: EffectTerm) -> Model:
    """The model with one effect in another form."""
    return model.with_active([form if a.name == form.name else a for a in model.active])


def backward_elimination(fitter: Fitter, fit: Fit) -> Fit:
    """Remove effects that the data do not require and refit, until all that remain are required.

    Scatter between blocks may be due to another effect's form: where the loss is too large, it is not counted.
    """
    while out := redundant_terms(fit):
        trial = _without(fitter, fit, out)
        lost, max_loss = _evidence_gain(fit, trial), fit.criteria.selection.log_evidence * len(out)
        _record_evidence(fitter, "remove", out, (fit, trial), -lost, -max_loss, taken=lost <= max_loss)
        if lost > max_loss:
            out = redundant_terms(fit, with_block_scatter=False)
            if not out:
                break
            trial = _without(fitter, fit, out)
            lost = _evidence_gain(fit, trial)
            note = "the scatter between blocks does not count"
            _record_evidence(fitter, "remove", out, (fit, trial), -lost, -max_loss, taken=True, note=note)
        fit = trial
    return fit


def _without(fitter: Fitter, fit: Fit, out: Sequence[str]) -> Fit:
    return refit_briefly(fitter, fit.model.with_active([a for a in fit.model.active if a.name not in out]), fit)


def redundant_terms(fit: Fit, *, with_block_scatter: bool = True) -> list[str]:
    """Effects that can be removed one by one, the least evidence first, the others adapting linearly."""
    mean, covariance, names = _posterior(fit, with_block_scatter=with_block_scatter)
    columns, known = _places(names), {active.name: active.candidate for active in fit.model.active}
    out: list[str] = []
    while columns:
        spare = {
            name: _log_bayes_factor(mean[k], covariance[np.ix_(k, k)], known[name]) - keep_threshold(fit, known[name])
            for name, k in columns.items()
        }
        weakest = min(spare, key=lambda name: spare[name])
        if spare[weakest] >= 0.0:
            break
        # Distribution of the others conditional on the absence of this effect.
        gone = columns.pop(weakest)
        follow = np.linalg.solve(covariance[np.ix_(gone, gone)], covariance[gone]).T
        mean = mean - follow @ mean[gone]
        covariance = covariance - follow @ covariance[gone]
        out.append(weakest)
    return out


def swap_step(
    fitter: Fitter, fit: Fit, library: Library, names: Sequence[str] | None = None
) -> tuple[Fit, dict[str, list[str]]]:
    """Replace each effect by an absent one that fits better; returns also the alternatives that fit as well.

    Parameters
    ----------
    names : sequence of str, optional
        Effects to test; all by default.
    """
    limits, indistinguishable = fit.criteria.selection, dict[str, list[str]]()
    candidate_swaps = [pair for pair in _swap_candidates(fitter, fit, library) if names is None or pair[0] in names]
    for name, other in candidate_swaps[: limits.most_trials]:
        if name not in fit.model.names or other.name in fit.model.names:
            continue
        others = [a for a in fit.model.active if a.name != name]
        shapes = other.candidate.of_role(ParameterRole.SHAPE)
        replaced = fit.model.with_active([*others, other.release(*shapes)])
        trial = trial_step(fitter, replaced, fit)
        if _evidence_gain(trial, fit) < -limits.tie - MAX_EVIDENCE_DEFICIT * log_bayes_factors(fit)[name]:
            continue
        trial = refit_briefly(fitter, replaced, trial)
        gain = _evidence_gain(trial, fit) + other.candidate.prior_log_odds - _candidate(fit, name).prior_log_odds
        better, lesser = (trial, fit) if gain > 0.0 else (fit, trial)
        parted = separable(fit.prepared, other.candidate.effect, _effect(fit, name))
        tied = abs(gain) < limits.tie or not parted or fits_as_well(lesser, better)
        note = "both do as well" if tied else ""
        _record_evidence(fitter, "swap", [other.name, name], (fit, trial), gain, 0.0, taken=gain > 0.0, note=note)
        if gain > 0.0:
            fit = trial
            indistinguishable[other.name] = [*indistinguishable.pop(name, []), name] if tied else []
        elif tied:
            indistinguishable.setdefault(name, []).append(other.name)
    return fit, indistinguishable


def merge_indistinguishable(fitter: Fitter, fit: Fit) -> tuple[Fit, dict[str, list[str]]]:
    """Keep one of two effects that the recording cannot separate, where it suffices; returns also those removed."""
    gone: dict[str, list[str]] = {}
    limits = fit.criteria.selection
    for one, other in combinations(fit.model.names, 2):
        if not {one, other} <= set(fit.model.names) or separable(fit.prepared, _effect(fit, one), _effect(fit, other)):
            continue
        factors = log_bayes_factors(fit)
        lesser, stays = sorted((one, other), key=lambda name: factors[name] + _candidate(fit, name).prior_log_odds)
        if (alone := _sufficient_alone(fitter, fit, lesser, stays)) is not None:
            given, (keeps, fit) = fit, alone
            pair, gain = [keeps, stays if keeps == lesser else lesser], _evidence_gain(fit, given)
            _record_evidence(fitter, "merge", pair, (given, fit), gain, -limits.log_evidence, taken=True)
            gone.setdefault(keeps, []).append(stays if keeps == lesser else lesser)
    return fit, gone


def _sufficient_alone(fitter: Fitter, fit: Fit, lesser: str, stays: str) -> tuple[str, Fit] | None:
    """Which of two effects fits as well alone as both, and that fit; None where neither does."""
    # A lesser effect with the same amplitude's name may have the right form: it is tried too where the other does not
    # suffice, or needs more refinements.
    sufficient: list[tuple[str, Fit]] = []
    is_same_kind = bool(_shared_amplitudes(fit, lesser, stays))
    for goes, keeps in ((lesser, stays), (stays, lesser))[: 2 if is_same_kind else 1]:
        trial = _refit_without_one(fitter, fit, goes, keeps)
        if _evidence_gain(fit, trial) < keep_threshold(fit, _candidate(fit, goes)):
            sufficient.append((keeps, trial))
            if not _needs_more_refinements(fit, keeps, trial):
                break
    return max(
        sufficient, key=lambda one: _evidence_gain(one[1], fit) + _candidate(fit, one[0]).prior_log_odds, default=None
    )


def _shared_amplitudes(fit: Fit, one: str, other: str) -> set[str]:
    """Names of amplitudes that two effects share, such as the voltage of a dead time and of a device drop."""
    return set(_candidate(fit, one).amplitudes) & set(_candidate(fit, other).amplitudes)


def _needs_more_refinements(fit: Fit, name: str, trial: Fit) -> bool:
    """Whether an effect has more refinements in a trial than in the fit."""
    before, after = (next(a for a in f.model.active if a.name == name) for f in (fit, trial))
    return len(after.free_refinements) > len(before.free_refinements)


def _refit_without_one(fitter: Fitter, fit: Fit, goes: str, keeps: str) -> Fit:
    """The fit without one of two effects, refitted from a start where the other takes over its amplitude."""
    went, stayed = (next(a for a in fit.model.active if a.name == name) for name in (goes, keeps))
    shared = _shared_amplitudes(fit, goes, keeps)
    for name in shared:
        whole = stayed.values[name] + went.values[name]
        stayed = stayed.moved(name, standardised(stayed.candidate.named(name), whole))
    active = [stayed if a.name == keeps else a for a in fit.model.active if a is not went]
    trial = refit(fitter, fit.model.with_active(active), fit)
    # Two effects of the same kind may together imitate the form of either.
    trial = refit(fitter, release_refinements(fitter, trial), trial)
    return free_remaining_shapes(fitter, trial) if shared else trial


def _evidence_gain(trial: Fit, fit: Fit) -> float:
    """Gain in log evidence of one fit over another, with the noise inflated to the better one's residual."""
    inflation = max(1.0, min(fit.chi2_per_dof, trial.chi2_per_dof))
    return log_evidence(trial, inflation) - log_evidence(fit, inflation)


def _effect(fit: Fit, name: str) -> Effect:
    return _candidate(fit, name).effect


def _candidate(fit: Fit, name: str) -> CandidateEffect:
    return next(a.candidate for a in fit.model.active if a.name == name)


def _swap_candidates(fitter: Fitter, fit: Fit, library: Library) -> list[tuple[str, EffectTerm]]:
    """Pairs of an effect and an absent one, at its linear estimate, that makes up for most of the effect's loss."""
    absent = [c for c in library if c.name not in fit.model.names]
    columns = absent_columns(absent)
    normal, right = fitter.evaluate(fit.model, fit.linearisation, columns, known=fit).projected()
    free = fit.model.free
    amplitudes = [k for k, (a, n) in enumerate(free) if n in a.candidate.amplitudes]
    pairs = []
    for one in fit.model.active:
        stay = [k for k in amplitudes if free[k][0].name != one.name]
        go = [k for k in amplitudes if free[k][0].name == one.name]
        away = -np.array([one.standardised_value(free[k][1]) for k in go])
        pull = right + normal[:, go] @ away
        order = [*stay, *go]
        worth, _ = linear_gain(normal[np.ix_(order, order)], pull[order], len(stay), range(len(stay), len(order)))
        for c in absent:
            place = [len(free) + k for k, (a, _) in enumerate(columns) if a.name == c.name]
            order = [*stay, *place]
            columns_of = range(len(stay), len(order))
            gain, x = linear_gain_of_absent(c, normal[np.ix_(order, order)], pull[order], len(stay), columns_of)
            if gain > INDISTINGUISHABLE_SHARE * worth:
                other = c.absent()
                for n, value in zip(c.amplitudes, x, strict=True):
                    other = other.moved(n, float(value))
                pairs.append((gain / worth, one.name, other))
    return [(name, other) for _, name, other in sorted(pairs, key=lambda pair: -pair[0])]


def log_bayes_factors(fit: Fit) -> dict[str, float]:
    """Log Bayes factor of each active effect: the model with it over the model without it [nat]."""
    mean, covariance, names = _posterior(fit)
    known = {active.name: active.candidate for active in fit.model.active}
    return {
        name: _log_bayes_factor(mean[k], covariance[np.ix_(k, k)], known[name]) for name, k in _places(names).items()
    }


def probabilities(fit: Fit) -> dict[str, float]:
    """Posterior probability that each active effect is present."""
    prior = fit.criteria.selection.prior_probability
    odds = math.log(prior / (1.0 - prior))
    priors = {active.name: active.candidate.prior_log_odds for active in fit.model.active}
    return {
        name: 0.5 * (1.0 + math.tanh(0.5 * (f + odds + priors[name]))) for name, f in log_bayes_factors(fit).items()
    }


def _log_bayes_factor(mean: Array, covariance: Array, candidate: CandidateEffect) -> float:
    """Savage and Dickey's density ratio at zero, for amplitudes with priors of unit variance."""
    return log_density_ratio(mean, covariance) - 0.5 * float(candidate.standing @ candidate.standing)


def _posterior(fit: Fit, *, with_block_scatter: bool = True) -> tuple[Array, Array, list[str]]:
    """Mean and covariance of the amplitudes, shapes fixed, noise inflated to the residual, and their effects."""
    which = [k for k, (a, n) in enumerate(fit.model.free) if n in a.candidate.amplitudes]
    free = [fit.model.free[k] for k in which]
    normal = fit.projected()[0][np.ix_(which, which)] / max(fit.chi2_per_dof, 1.0)
    covariance = np.asarray(np.linalg.inv(normal + np.eye(len(which))), dtype=np.float64)
    if with_block_scatter:
        covariance += np.diag(block_scatter(fit)[which] ** 2 / BLOCKS)
    return np.array([a.standardised_value(n) for a, n in free]), covariance, [a.name for a, _ in free]


def _places(names: Sequence[str]) -> dict[str, list[int]]:
    return {name: [k for k, other in enumerate(names) if other == name] for name in names}


def without_effect(fitter: Fitter, fit: Fit, name: str) -> Fit:
    """R_s and the map refitted without one effect, the other effects fixed."""
    others = [replace(a, free=()) for a in fit.model.active if a.name != name]
    return fitter.evaluate(fit.model.with_active(others), fit.linearisation)
