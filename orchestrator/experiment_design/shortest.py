"""The shortest plan of candidate points that detects and separates some effects.

A D_s-optimal design (`optimal`) shares the least sufficient time among the points. Its shares are rounded up to whole
measurements, which are then dropped one after the other, the longest first, as long as the rest suffices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.config import PlannedPoint
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.judgement.sufficiency import OPERATING_POINTS_PER_SWEEP
from orchestrator.diagnosis.selection.contrasts import SAME_CURRENT
from orchestrator.experiment_design.information import Information
from orchestrator.experiment_design.isolability import isolability, required_size
from orchestrator.experiment_design.optimal import ApproximateDesign, optimal_weights
from orchestrator.numerics.types import Array
from protocols import Trapezoid

MIN_WEIGHT: float = 1e-3
"""Part of the time below which a point of an approximate design is left out."""
OPTIMALITY_TOLERANCE: float = 0.005
"""Excess of the largest directional derivative over its bound up to which the weights count as optimal."""
MAX_ITERATIONS: int = 20_000
"""Steps of the multiplicative algorithm."""
MAX_REPEATS: int = 100
"""Measurements of a point after which an effect that is still not separated counts as out of reach."""
SIZE_MARGIN: float = 1.2
"""Factor by which a designed plan has to exceed the required size, because its points run in another order."""


@dataclass(frozen=True)
class Offer:
    """The candidate points of a design, and their information.

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
        """Duration of each point, settling included."""
        return np.array([point.seconds for point in self.points])

    def normal(self, times: Array) -> Array:
        """Normal matrix when each point is measured so many times, without the prior."""
        return np.asarray(np.tensordot(times, self.known.pieces, 1))

    def covers_plane(self, times: Array, criteria: Criteria) -> bool:
        """Whether the points cover enough of the current plane to name a cause."""
        limits = criteria.selection
        used = [point for point, n in zip(self.points, times, strict=True) if n > 0]
        sweeps = sum(isinstance(point.excitation, Trapezoid) for point in used)
        targets = np.array([point.target for point in used if point.target is not None]).reshape(-1, 2)
        distance = SAME_CURRENT * max(point.excitation.longest_current_a for point in self.points)
        covered = len(np.unique(np.round(targets / distance), axis=0)) + OPERATING_POINTS_PER_SWEEP * sweeps
        return covered >= limits.few_views


@dataclass(frozen=True)
class ShortestPlan:
    """The number of measurements of each point, and the approximate design behind it.

    Attributes
    ----------
    times : array, shape (points,)
        Whole numbers.
    approximate : ApproximateDesign
    seconds : float
        Duration of the approximate design, with divisible points.
    """

    times: Array
    approximate: ApproximateDesign
    seconds: float


def out_of_reach(offer: Offer, size: float, criteria: Criteria) -> list[tuple[str, ...]]:
    """Effects and pairs that remain open at a size when every point is measured `MAX_REPEATS` times."""
    often = np.full(len(offer.points), MAX_REPEATS)
    return isolability(offer.known, offer.normal(often), criteria).beyond(size)


def shortest(offer: Offer, size: float, criteria: Criteria, *, at_least_s: float = 0.0) -> ShortestPlan:
    """The shortest plan in which all effects of the offer are detected and separated at a size.

    Parameters
    ----------
    at_least_s : float
        Least duration of the approximate design, where a shorter one turned out not to suffice.
    """
    seconds = max(at_least_s, float(offer.seconds.min()))
    effects = offer.known.effects.values()
    columns = np.concatenate([np.arange(offer.known.machine_columns), *(effect.in_typical_shape for effect in effects)])
    amplitudes = np.flatnonzero(np.isin(columns, np.concatenate([effect.amplitudes for effect in effects])))
    block = np.ix_(columns, columns)
    rates = np.stack([piece[block] for piece in offer.known.pieces]) / offer.seconds[:, None, None]
    prior = offer.known.prior[block]
    weights: Array | None = None
    while True:
        design = optimal_weights(
            rates, prior, amplitudes, seconds, tolerance=OPTIMALITY_TOLERANCE, max_steps=MAX_ITERATIONS, start=weights
        )
        weights = np.maximum(design.weights, 1e-3 * MIN_WEIGHT)
        weights /= weights.sum()
        shares = np.where(design.weights > MIN_WEIGHT, design.weights, 0.0)
        if _suffices(offer, seconds * shares / offer.seconds, size, criteria):
            break
        seconds *= 2.0
    times = np.ceil(seconds * shares / offer.seconds)
    order = np.argsort(-design.weights)
    for k in order:
        if offer.covers_plane(times, criteria):
            break
        times[k] = max(times[k], 1.0)
    longest_first = sorted(order.tolist(), key=lambda k: (-offer.seconds[k], design.weights[k]))
    return ShortestPlan(_without_redundant(offer, times, size, criteria, longest_first), design, seconds)


def _without_redundant(offer: Offer, times: Array, size: float, criteria: Criteria, order: Sequence[int]) -> Array:
    """The plan when each point in turn is dropped, or reduced to one measurement, where the rest suffices."""
    for k in order:
        for fewer in (0.0, 1.0):
            if fewer < times[k]:
                trial = times.copy()
                trial[k] = fewer
                if offer.covers_plane(trial, criteria) and _suffices(offer, trial, size, criteria):
                    times = trial
                    break
    return times


def _suffices(offer: Offer, times: Array, size: float, criteria: Criteria) -> bool:
    normal, names = offer.normal(times), list(offer.known.effects)
    questions = [*((a,) for a in names), *((a, b) for k, a in enumerate(names) for b in names[:k])]
    return all(required_size(offer.known, normal, q, criteria) <= size / SIZE_MARGIN for q in questions)
