"""How much the data ask for each effect of a model: one fit gives every effect's log Bayes factor.

The ratio is that of Savage and Dickey (doi:10.1214/aoms/1177693507), with a Gaussian posterior of the amplitudes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orchestrator.diagnosis.fitting.candidates import CandidateEffect
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import BLOCKS, block_scatter
from orchestrator.diagnosis.selection.scoring import keep_threshold, log_density_ratio
from orchestrator.numerics.types import Array


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
    return fitter.evaluate(fit.model.with_active(others), fit.linearisation)


def _log_bayes_factor(mean: Array, covariance: Array, candidate: CandidateEffect) -> float:
    """Savage and Dickey's density ratio at zero, for amplitudes with priors of unit variance."""
    return log_density_ratio(mean, covariance) - 0.5 * float(candidate.standing @ candidate.standing)


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
