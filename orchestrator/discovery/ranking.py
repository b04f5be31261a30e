"""Ranking of hypotheses by the marginal likelihood of their flexible laws, from one linearisation of a fit.

With S and g the information about a law's coefficients and their gradient, R_s, the map and the fitted effects
eliminated, K their precision (`bases.penalty`) and s the noise's factor,

    log E(tau) = 1/2 g' (S/s + K/tau^2)^-1 g / s^2 - 1/2 log det(I + tau^2 K^-1 S/s),

the gain of the restricted likelihood over the model without the law. tau maximises it. s is the smallest chi2 per
degree of freedom that any of the laws could leave, as in the diagnosis' own comparisons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, eigh

from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.discovery.bases import penalty
from orchestrator.discovery.hypotheses import Hypothesis, SharedColumns, names
from orchestrator.discovery.places import VOLTAGE_GAIN
from orchestrator.discovery.quantities import PHASE_VOLTAGE
from orchestrator.numerics.types import Array

MAX_CHANGE_OF_RESISTANCE: float = 0.05
"""Change of R_s, relative to it, beyond which a law of the voltage's gain only makes all of the equations smaller: with
neither voltage nor resistance nor flux they hold exactly."""
RIDGE_OF_ROUNDING: float = 1e-10
"""Information added to each fitted number, relative to its own."""
STEP_FROM_BOUND: float = 1e-3
"""Step in standard deviations of the prior that shows whether a fitted parameter is at a bound."""
DECADES: tuple[float, float] = (-6.0, 8.0)
"""Range of log10 tau^2, in units in which the law's information is one."""


@dataclass(frozen=True)
class Score:
    """One hypothesis beside a fit, to first order.

    Attributes
    ----------
    hypothesis : Hypothesis
    log_evidence : float
        Gain of the restricted log likelihood [nat].
    chi2 : float
        Of the fitted stages, that it would leave.
    coefficients : array, shape (size,)
        Posterior mean, in the unit of the place.
    covariance : array, shape (size, size)
    share : float
        Part of the excess chi2 that it removes.
    width : float
        Standard deviation of the law's values before the data, by the likeliest tau.
    """

    hypothesis: Hypothesis
    log_evidence: float
    chi2: float
    coefficients: Array
    covariance: Array
    share: float
    width: float


def rank(fitter: Fitter, fit: Fit, hypotheses: Sequence[Hypothesis], noise: float | None = None) -> list[Score]:
    """Scores of all hypotheses, the best first.

    Parameters
    ----------
    noise : float, optional
        Factor s of the noise's variance; by default the smallest chi2 per degree of freedom that any would leave.
    """
    blocks = _blocks(fitter, fit, hypotheses)
    if noise is None:
        least = (_least_chi2(fit, b) for b in blocks if not scales_voltage(b.hypothesis))
        noise = max(1.0, min(least, default=fit.chi2) / fit.dof)
    return sorted((_score(fit, block, noise) for block in blocks), key=lambda score: -score.log_evidence)


@dataclass(frozen=True)
class _Block:
    """Information about one law's coefficients, minus their gradient, and the change of R_s with each [ohm]."""

    hypothesis: Hypothesis
    information: Array
    gradient: Array
    resistance: Array


def _blocks(fitter: Fitter, fit: Fit, hypotheses: Sequence[Hypothesis]) -> list[_Block]:
    """All that is fitted eliminated; coefficients in units of `size`."""
    shared = SharedColumns()
    columns = [(term, name) for one in hypotheses for term in [one.candidate(shared).absent()] for name in names(one)]
    evaluated = fitter.evaluate(fit.model, fit.linearisation, columns, known=fit)
    total, pulls = evaluated.system()
    fitted = len(total) - len(columns)
    gradient = -pulls.sum(axis=0)
    gradient[:fitted] = _gradient_of_fitted(fit, gradient[:fitted])
    moves = _can_move(fit, gradient[:fitted])
    across, normal = total[:fitted, fitted:][moves], total[:fitted, :fitted][np.ix_(moves, moves)]
    own = total[fitted:, fitted:] - np.eye(len(columns))
    follow = _solved(normal, across)
    own -= across.T @ follow
    rest = gradient[:fitted][moves]
    gradient = gradient[fitted:] - follow.T @ rest
    blocks, at = [], 0
    for one in hypotheses:
        k = slice(at, at + one.basis.size)
        blocks.append(_Block(one, own[k, k], gradient[k], -follow[0, k]))
        at += one.basis.size
    return blocks


def _gradient_of_fitted(fit: Fit, of_data: Array) -> Array:
    """Minus the objective's gradient by R_s, the map and the effects' parameters, with their priors.

    That of R_s and the map is zero. That of an effect's parameter is not, where it or another one is at a bound.
    """
    gradient = np.zeros_like(of_data)
    free = fit.model.free
    if free:
        gradient[-len(free) :] = of_data[-len(free) :] - [term.prior_residual(name) for term, name in free]
    return gradient


def _can_move(fit: Fit, gradient: Array) -> NDArray[np.bool_]:
    """Which of the fitted numbers may follow a law: not those that their gradient holds at a bound."""
    moves = np.ones(len(gradient), dtype=np.bool_)
    first = len(gradient) - len(fit.model.free)
    for k, (term, name) in enumerate(fit.model.free, first):
        x, step = term.standardised_value(name), float(np.sign(gradient[k])) * STEP_FROM_BOUND
        moves[k] = step == 0.0 or term.moved(name, x + step).values[name] != term.values[name]
    return moves


def _solved(normal: Array, right: Array) -> Array:
    """normal^-1 right; a fitted law that hardly shows leaves the matrix without full rank, but for rounding."""
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(size, size) + RIDGE_OF_ROUNDING * np.eye(len(normal))
    return np.asarray(cho_solve(cho_factor(scaled), right / size[:, None]) / size[:, None], dtype=np.float64)


def scales_voltage(hypothesis: Hypothesis) -> bool:
    """Whether a law may make all of the equations smaller."""
    return hypothesis.place is VOLTAGE_GAIN or hypothesis.quantity is PHASE_VOLTAGE


def _least_chi2(fit: Fit, block: _Block) -> float:
    """chi2 without a penalty."""
    ridge = 1e-9 * np.trace(block.information) / len(block.information) + 1e-300
    regular = block.information + ridge * np.eye(len(block.information))
    return fit.chi2 - float(block.gradient @ np.linalg.solve(regular, block.gradient))


def _score(fit: Fit, block: _Block, noise: float) -> Score:
    hypothesis, information, gradient = block.hypothesis, block.information, block.gradient
    prior = penalty(hypothesis.basis)
    root = np.linalg.inv(np.linalg.cholesky(prior)).T  # c = root z, z ~ N(0, tau^2)
    values, turn = eigh(root.T @ information @ root / noise)
    values = np.maximum(values, 0.0)
    along = turn.T @ (root.T @ gradient) / noise
    unit = max(float(values[-1]), 1e-300)
    taus = 10.0 ** np.arange(DECADES[0], DECADES[1] + 0.1, 0.25) / unit
    gains = 0.5 * np.sum(along**2 / (1.0 / taus[:, None] + values), axis=1)
    gains -= 0.5 * np.log1p(taus[:, None] * values).sum(axis=1)
    back = root @ turn
    if scales_voltage(hypothesis):
        moved = np.abs(block.resistance @ back @ (along / (1.0 / taus[:, None] + values)).T)
        gains[moved > MAX_CHANGE_OF_RESISTANCE * abs(fit.model.r_s)] = -np.inf
    best = int(np.argmax(gains))
    posterior = 1.0 / (1.0 / taus[best] + values)
    mean = back @ (along * posterior)
    left = fit.chi2 - float(2.0 * mean @ gradient - mean @ information @ mean)
    used = float(np.sum(values * posterior))
    excess = fit.chi2 - fit.dof
    return Score(
        hypothesis=hypothesis,
        log_evidence=float(gains[best]),
        chi2=left,
        coefficients=hypothesis.size * mean,
        covariance=hypothesis.size**2 * (back * posterior) @ back.T,
        share=float((fit.chi2 - left - used) / excess) if excess > 0.0 else 0.0,
        width=hypothesis.size * float(np.sqrt(taus[best] * np.linalg.eigvalsh(np.linalg.inv(prior))[-1])),
    )
