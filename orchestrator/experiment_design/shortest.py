"""The shortest plan that finds some effects and tells them apart, of points that are offered.

Time is shared as a D_s-optimal design says (`optimal`), as little of it as will do; the points of that design are then
taken whole, and one after the other left out again, the longest first, as long as the rest will do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.config import PlannedPoint
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.selection.contrasts import SAME_CURRENT
from orchestrator.diagnosis.selection.sufficiency import OPERATING_POINTS_PER_SWEEP
from orchestrator.experiment_design.information import Information, Places
from orchestrator.experiment_design.isolability import answer, isolability
from orchestrator.experiment_design.optimal import ApproximateDesign, optimal_weights
from orchestrator.numerics.types import Array
from protocols import Trapezoid

LEAST_WEIGHT: float = 1e-3
"""Part of the time below which a point of an approximate design is left out."""
OPTIMALITY_TOLERANCE: float = 0.005
"""Excess of the largest directional derivative over its bound up to which the weights count as optimal."""
MAX_ITERATIONS: int = 20_000
"""Steps of the multiplicative algorithm."""
MAX_REPEATS: int = 100
"""How often a point may be measured before what it cannot separate counts as out of reach."""
SIZE_MARGIN: float = 1.2
"""Factor by which a designed plan has to exceed the required size: its points run in another order than they were
chosen in."""


@dataclass(frozen=True)
class Offer:
    """What may be measured, and what each point of it would tell.

    Attributes
    ----------
    points : tuple of PlannedPoint
    known : Information
        A piece for each point, in their order.
    """

    points: tuple[PlannedPoint, ...]
    known: Information

    @property
    def seconds(self) -> Array:
        """Of each point, settling included."""
        return np.array([point.seconds for point in self.points])

    def normal(self, times: Array) -> Array:
        """Normal matrix when each point is measured so many times, without the prior."""
        return np.asarray(np.tensordot(times, self.known.pieces, 1))

    def shows(self, times: Array, criteria: Criteria) -> bool:
        """Whether as many places of the current plane are seen as it takes to trust a cause."""
        limits = criteria.selection
        used = [point for point, n in zip(self.points, times, strict=True) if n > 0]
        sweeps = sum(isinstance(point.excitation, Trapezoid) for point in used)
        targets = np.array([point.target for point in used if point.target is not None]).reshape(-1, 2)
        apart = SAME_CURRENT * max(point.excitation.longest_current_a for point in self.points)
        seen = len(np.unique(np.round(targets / apart), axis=0)) + OPERATING_POINTS_PER_SWEEP * sweeps
        return seen >= limits.few_views


@dataclass(frozen=True)
class Shortest:
    """How often each point is measured, and the approximate design that it is from.

    Attributes
    ----------
    times : array, shape (points,)
        Whole numbers.
    approximate : ApproximateDesign
    seconds : float
        Of the approximate design, were its points divisible.
    """

    times: Array
    approximate: ApproximateDesign
    seconds: float


def out_of_reach(offer: Offer, size: float, criteria: Criteria) -> list[tuple[str, ...]]:
    """Effects and pairs that are beyond a size when all that is offered is measured as often as is reasonable."""
    often = np.full(len(offer.points), MAX_REPEATS)
    return isolability(offer.known, offer.normal(often), criteria).beyond(size)


def shortest(offer: Offer, size: float, criteria: Criteria, *, at_least_s: float = 0.0) -> Shortest:
    """The least time in which all effects of the offer are found, and told apart, at a size.

    Parameters
    ----------
    at_least_s : float
        Of the approximate design, where a shorter one turned out not to do.
    """
    seconds = max(at_least_s, float(offer.seconds.min()))
    columns, asked = _of_typical_shapes(offer.known)
    block = np.ix_(columns, columns)
    rates = np.stack([piece[block] for piece in offer.known.pieces]) / offer.seconds[:, None, None]
    prior = offer.known.prior[block]
    weights: Array | None = None
    while True:
        found = optimal_weights(
            rates, prior, asked, seconds, within=OPTIMALITY_TOLERANCE, most=MAX_ITERATIONS, start=weights
        )
        weights = np.maximum(found.weights, 1e-3 * LEAST_WEIGHT)
        weights /= weights.sum()
        shares = np.where(found.weights > LEAST_WEIGHT, found.weights, 0.0)
        if _does(offer, seconds * shares / offer.seconds, size, criteria):
            break
        seconds *= 2.0
    times = np.ceil(seconds * shares / offer.seconds)
    order = np.argsort(-found.weights)
    for k in order:
        if offer.shows(times, criteria):
            break
        times[k] = max(times[k], 1.0)
    dear = sorted(order.tolist(), key=lambda k: (-offer.seconds[k], found.weights[k]))
    return Shortest(_without_spare(offer, times, size, criteria, dear), found, seconds)


def _of_typical_shapes(known: Information) -> tuple[Places, Places]:
    """Columns of R_s, the map and every effect in its typical shape; which of these are amplitudes."""
    effects = known.effects.values()
    columns = np.concatenate([np.arange(known.machine), *(effect.in_typical_shape for effect in effects)])
    return columns, np.flatnonzero(np.isin(columns, np.concatenate([effect.amplitudes for effect in effects])))


def _without_spare(offer: Offer, times: Array, size: float, criteria: Criteria, order: Sequence[int]) -> Array:
    """What is left when each point in turn goes as far as it can be spared: altogether, or but for one time."""
    for k in order:
        for fewer in (0.0, 1.0):
            if fewer < times[k]:
                trial = times.copy()
                trial[k] = fewer
                if offer.shows(trial, criteria) and _does(offer, trial, size, criteria):
                    times = trial
                    break
    return times


def _does(offer: Offer, times: Array, size: float, criteria: Criteria) -> bool:
    normal, names = offer.normal(times), list(offer.known.effects)
    questions = [*((a,) for a in names), *((a, b) for k, a in enumerate(names) for b in names[:k])]
    return all(answer(offer.known, normal, q, criteria) <= size / SIZE_MARGIN for q in questions)
