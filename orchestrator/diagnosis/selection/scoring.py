"""Gain of an effect: to first order while it is absent, by log evidence and Bayes factor once it is in the model.

One fit gives every effect's log Bayes factor: the ratio of Savage and Dickey (doi:10.1214/aoms/1177693507), with a
Gaussian posterior of the amplitudes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, Library
from orchestrator.diagnosis.fitting.fit import Fitter, absent_columns
from orchestrator.diagnosis.fitting.gauss_newton import is_stuck
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import BLOCKS, block_scatter
from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Score:
    """Linear estimate of an absent effect."""

    candidate: CandidateEffect
    gain: float
    """Fall of chi2 with its prior."""
    coordinates: Array
    """Standardised amplitudes, shape (amplitudes,)."""


@dataclass(frozen=True)
class LinearView:
    """A fit with all absent effects of the library, to first order.

    Attributes
    ----------
    absent : tuple of CandidateEffect
        Effects that are not in the model.
    columns : tuple of (EffectTerm, str)
        The model's free parameters, the amplitudes of the absent effects, then the requested refinements.
    normal, right : array, shape (columns, columns) and (columns,)
        Normal matrix and gradient of the columns, with R_s and the map eliminated.
    """

    fit: Fit
    absent: tuple[CandidateEffect, ...]
    columns: tuple[tuple[EffectTerm, str], ...]
    normal: Array
    right: Array

    @property
    def fitted(self) -> int:
        """Number of free parameters of the model, whose columns are the first."""
        return len(self.fit.model.free)

    @property
    def extra(self) -> range:
        """Indices of the columns that are not free in the model."""
        return range(self.fitted, len(self.columns))

    def columns_of(self, name: str) -> list[int]:
        """Indices of an absent effect's columns."""
        return [k for k in self.extra if self.columns[k][0].name == name]


def log_evidence(fit: Fit, inflation: float) -> float:
    """Laplace's approximation to the log evidence of a fit, up to a constant of the recording."""
    count = len(fit.model.free)
    priors = sum(a.prior_residual(n) ** 2 for a, n in fit.model.free)
    value = -0.5 * (fit.chi2 / inflation + fit.log_det + priors)
    if count:
        normal = fit.projected()[0][:count, :count]
        value -= 0.5 * float(np.linalg.slogdet(np.eye(count) + normal / inflation)[1])
    return value


def add_threshold(fit: Fit, candidate: CandidateEffect) -> float:
    """Gain in log evidence required to name an effect [nat]."""
    return fit.criteria.selection.log_evidence - candidate.prior_log_odds


def keep_threshold(fit: Fit, candidate: CandidateEffect) -> float:
    """Log evidence below which an effect is removed; an effect included a priori needs evidence against it [nat]."""
    usual = fit.criteria.selection.prior_probability
    if candidate.included_a_priori:
        return -(candidate.prior_log_odds + math.log(usual / (1.0 - usual)))
    return add_threshold(fit, candidate)


def fits_as_well(rival: Fit, named: Fit) -> bool:
    """Whether an alternative fits data and priors as well as the named effect, whatever its number of parameters.

    Log evidence decides which one is named, but its penalty for parameters is no measurement that separates the two.
    """
    inflation = max(1.0, min(rival.chi2_per_dof, named.chi2_per_dof))
    return rival.objective - named.objective < 2.0 * named.criteria.selection.tie * inflation


def linear_view(
    fitter: Fitter,
    fit: Fit,
    candidates: Library,
    refinement_columns: Sequence[tuple[EffectTerm, str]] = (),
) -> LinearView:
    """Linear view of a fit with all absent effects, and with some refinements of those present."""
    absent = tuple(c for c in candidates if c.name not in fit.model.names)
    columns = [*absent_columns(absent), *refinement_columns]
    normal, right = fitter.evaluate(fit.model, fit.linearisation, columns, known=fit).projected()
    return LinearView(fit, absent, (*fit.model.free, *columns), normal, right)


def score(view: LinearView) -> list[Score]:
    """Linear scores of the absent effects, best first; the model's own parameters and the map adapt."""
    scores = [
        Score(c, *linear_gain_of_absent(c, view.normal, view.right, view.fitted, view.columns_of(c.name)))
        for c in view.absent
    ]
    return sorted(scores, key=lambda s: -s.gain)


def gain_of_all(view: LinearView) -> float:
    """Fall of chi2 by all absent effects together."""
    columns = movable(view, [k for c in view.absent for k in view.columns_of(c.name)])
    return linear_gain(view.normal, view.right, view.fitted, columns)[0] if columns else 0.0


def movable(view: LinearView, columns: Sequence[int]) -> list[int]:
    """Those of some columns that no bound holds, neither alone nor as they move together."""
    alone = {k: float(linear_gain(view.normal, view.right, view.fitted, [k])[1][0]) for k in columns}
    left = list(columns)
    while left:
        _, steps = linear_gain(view.normal, view.right, view.fitted, left)
        moves = [
            _can_move(view, k, alone[k]) or _can_move(view, k, float(step)) for k, step in zip(left, steps, strict=True)
        ]
        if all(moves):
            break
        left = [k for k, is_free in zip(left, moves, strict=True) if is_free]
    return left


def _can_move(view: LinearView, column: int, step: float) -> bool:
    active, name = view.columns[column]
    return not is_stuck(active, name, active.standardised_value(name) + step)


def linear_gain(normal: Array, right: Array, fitted: int, columns: Sequence[int]) -> tuple[float, Array]:
    """Fall of chi2 and coordinates of some columns under their priors; the first `fitted` columns are eliminated."""
    block, pull = normal[np.ix_(columns, columns)], right[columns]
    if fitted:
        inner, across = normal[:fitted, :fitted] + np.eye(fitted), normal[np.ix_(range(fitted), columns)]
        follow = np.linalg.solve(inner, across)
        block, pull = block - across.T @ follow, pull - follow.T @ right[:fitted]
    x = np.asarray(-np.linalg.solve(block + np.eye(len(columns)), pull), dtype=np.float64)
    return float(-pull @ x), x


def select_columns(normal: Array, right: Array, fitted: int, columns: Sequence[int], spare: float) -> list[int]:
    """The fewest of some columns that together lose no more than `spare` of their linear gain.

    Columns are dropped one by one, the smallest loss first; the first `fitted` columns are eliminated.
    """
    selected = list(columns)
    min_gain = linear_gain(normal, right, fitted, selected)[0] - spare if selected else 0.0
    while selected:
        without = [[k for k in selected if k != gone] for gone in selected]
        gains = [linear_gain(normal, right, fitted, some)[0] if some else 0.0 for some in without]
        best = int(np.argmax(gains))
        if gains[best] < min_gain:
            break
        selected = without[best]
    return selected


def select_terms(
    view: tuple[Array, Array], fitted: int, forms: Sequence[tuple[Sequence[int], float]], later: float = 0.0
) -> list[int]:
    """`select_columns` of the first group of columns whose linear gain exceeds its required gain.

    `later` is the part of the group's gain that may be postponed.
    """
    for columns, min_gain in forms:
        gain = linear_gain(*view, fitted, columns)[0] if columns else 0.0
        if gain > min_gain:
            return select_columns(*view, fitted, columns, max(forms[0][1], later * gain))
    return []


def linear_gain_of_absent(
    candidate: CandidateEffect, normal: Array, right: Array, fitted: int, columns: Sequence[int]
) -> tuple[float, Array]:
    """`linear_gain` of an absent effect's amplitudes, whose prior means need not be zero."""
    pull = right.copy()
    pull[columns] -= candidate.standing
    gain, x = linear_gain(normal, pull, fitted, columns)
    return gain - float(candidate.standing @ candidate.standing), x


def loss_without(fit: Fit, active: EffectTerm, names: Sequence[str]) -> float:
    """Rise of chi2, to first order, if some parameters were put back to neutral and all others adapted.

    Wald's test, in units of the residual's variance.
    """
    free = fit.model.free
    which = [k for k, (a, n) in enumerate(free) if a.name == active.name and n in names]
    away = np.array([active.standardised_value(free[k][1]) for k in which])
    block = fit.covariance(max(fit.chi2_per_dof, 1.0))[np.ix_(which, which)]
    return float(away @ np.linalg.solve(block, away))


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


def redundant_terms(fit: Fit) -> list[str]:
    """Effects that can be removed one by one, the least evidence first, the others adapting linearly."""
    mean, covariance, names = _posterior(fit)
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


def without_effect(fitter: Fitter, fit: Fit, name: str) -> Fit:
    """R_s and the map refitted without one effect, the other effects fixed."""
    others = [replace(a, free=()) for a in fit.model.active if a.name != name]
    return fitter.relinearise(fit.model.with_active(others), fit.linearisation)


def _log_bayes_factor(mean: Array, covariance: Array, candidate: CandidateEffect) -> float:
    """Savage and Dickey's density ratio at zero, for amplitudes with priors of unit variance."""
    posterior = np.linalg.slogdet(covariance)[1] + mean @ np.linalg.solve(covariance, mean)
    return 0.5 * float(posterior) - 0.5 * float(candidate.standing @ candidate.standing)


def _posterior(fit: Fit) -> tuple[Array, Array, list[str]]:
    """Mean and covariance of the amplitudes, shapes fixed, noise inflated to the residual, and their effects."""
    which = [k for k, (a, n) in enumerate(fit.model.free) if n in a.candidate.amplitudes]
    free = [fit.model.free[k] for k in which]
    normal = fit.projected()[0][np.ix_(which, which)] / max(fit.chi2_per_dof, 1.0)
    covariance = np.asarray(np.linalg.inv(normal + np.eye(len(which))), dtype=np.float64)
    covariance += np.diag(block_scatter(fit)[which] ** 2 / BLOCKS)
    return np.array([a.standardised_value(n) for a, n in free]), covariance, [a.name for a, _ in free]


def _places(names: Sequence[str]) -> dict[str, list[int]]:
    return {name: [k for k, other in enumerate(names) if other == name] for name in names}
