"""How to share time among experiments: an approximate D_s-optimal design, and the proof that it is one.

Experiment j tells N_j a unit of time, a design gives it the part w_j of a time T, and P is what is known beforehand,

    M(w) = P + T sum_j w_j N_j,        maximise  log det M - log det M_nn,

the information on the parameters that are asked for when the others, n, follow. Towards experiment j it grows by

    d_j(w) = T (tr M^-1 N_j - tr M_nn^-1 N_j,nn) = T tr S^-1 A N_j A',    A = [1, -M_an M_nn^-1],    S = A M A'

(the second form does not cancel), and w is optimal if, and only if, no d_j exceeds the mean sum_k w_k d_k (Kiefer and
Wolfowitz, doi:10.4153/CJM-1960-030-4; with P, Chaloner and Verdinelli, doi:10.1214/ss/1177009939). Without P that mean
is the number of parameters asked for. The criterion is concave, so that no design is better than this one by more than
the largest d_j exceeds the mean. Steps w_j <- w_j sqrt(d_j), scaled to one, do not make it worse (of their kind: Yu,
doi:10.1214/09-AOS761; without the root they do where few parameters are asked for). Knows no motor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class ApproximateDesign:
    """Parts of the time, and how near they are to the best.

    Attributes
    ----------
    weights : array, shape (experiments,)
        They add up to one.
    largest, bound : float
        Largest directional derivative, and the mean one that it may not exceed where the design is optimal.
    """

    weights: Array
    largest: float
    bound: float

    @property
    def excess(self) -> float:
        """By how much the equivalence theorem is missed, relatively."""
        return self.largest / self.bound - 1.0


def optimal_weights(
    information: Array,
    prior: Array,
    asked: NDArray[np.int64],
    time: float,
    *,
    within: float,
    most: int,
    start: Array | None = None,
) -> ApproximateDesign:
    """The design of most information on some parameters.

    Parameters
    ----------
    information : array, shape (experiments, n, n)
        Normal matrix of each a unit of time.
    prior : array, shape (n, n)
    asked : array of int
        The parameters that are asked for.
    time : float
        Of the whole.
    within : float
        Relative excess over the theorem's bound at which to stop.
    most : int
        Steps.
    start : array, optional
        Weights to begin with, none of them nil.
    """
    weights = np.full(len(information), 1.0 / len(information)) if start is None else start
    for step in range(most + 1):
        slopes = derivatives(information, prior, asked, weights, time)
        bound = float(weights @ slopes)
        if slopes.max() <= (1.0 + within) * bound or step == most:
            break
        weights = weights * np.sqrt(slopes)
        weights /= weights.sum()
    return ApproximateDesign(weights, float(slopes.max()), bound)


def derivatives(information: Array, prior: Array, asked: NDArray[np.int64], weights: Array, time: float) -> Array:
    """d_j of each experiment, shape (experiments,)."""
    whole = prior + time * np.tensordot(weights, information, 1)
    others = np.setdiff1d(np.arange(len(whole)), asked)
    reduced = np.zeros((len(asked), len(whole)))
    reduced[:, asked] = np.eye(len(asked))
    reduced[:, others] = -np.linalg.solve(whole[np.ix_(others, others)], whole[np.ix_(others, asked)]).T
    towards = reduced.T @ np.linalg.solve(reduced @ whole @ reduced.T, reduced)
    return np.asarray(time * np.tensordot(information, towards, 2))
