"""Shares of time among experiments: an approximate D_s-optimal design, and its check by the equivalence theorem.

Experiment j has the information N_j per unit of time, a design gives it the part w_j of a time T, and P is the prior,

    M(w) = P + T sum_j w_j N_j,        maximise  log det M - log det M_nn,

the information on the parameters of interest with the others, n, as nuisances. Towards experiment j it grows by

    d_j(w) = T (tr M^-1 N_j - tr M_nn^-1 N_j,nn) = T tr S^-1 A N_j A',    A = [1, -M_an M_nn^-1],    S = A M A'

(the second form does not cancel), and w is optimal if, and only if, no d_j exceeds the mean sum_k w_k d_k (Kiefer and
Wolfowitz, doi:10.4153/CJM-1960-030-4; with P, Chaloner and Verdinelli, doi:10.1214/ss/1177009939). Without P that mean
is the number of parameters of interest. The criterion is concave, so that no design is better than this one by more
than the largest d_j exceeds the mean. Steps w_j <- w_j sqrt(d_j), scaled to one, do not make it worse (of their kind:
Yu, doi:10.1214/09-AOS761; without the root they do where few parameters are of interest).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class ApproximateDesign:
    """Shares of the time, and their distance from the optimum.

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
        """Relative excess of the largest derivative over the theorem's bound."""
        return self.largest / self.bound - 1.0


def optimal_weights(
    information: Array,
    prior: Array,
    interest: NDArray[np.int64],
    time: float,
    *,
    tolerance: float,
    max_steps: int,
    start: Array | None = None,
) -> ApproximateDesign:
    """The D_s-optimal design for the parameters of interest.

    Parameters
    ----------
    information : array, shape (experiments, n, n)
        Normal matrix of each per unit of time.
    prior : array, shape (n, n)
    interest : array of int
        The parameters of interest.
    time : float
        Duration of all experiments.
    tolerance : float
        Relative excess over the theorem's bound at which to stop.
    max_steps : int
    start : array, optional
        Weights to begin with, none of them zero.
    """
    weights = np.full(len(information), 1.0 / len(information)) if start is None else start
    for step in range(max_steps + 1):
        slopes = derivatives(information, prior, interest, weights, time)
        bound = float(weights @ slopes)
        if slopes.max() <= (1.0 + tolerance) * bound or step == max_steps:
            break
        weights = weights * np.sqrt(slopes)
        weights /= weights.sum()
    return ApproximateDesign(weights, float(slopes.max()), bound)


def derivatives(information: Array, prior: Array, interest: NDArray[np.int64], weights: Array, time: float) -> Array:
    """d_j of each experiment, shape (experiments,)."""
    whole = prior + time * np.tensordot(weights, information, 1)
    others = np.setdiff1d(np.arange(len(whole)), interest)
    reduced = np.zeros((len(interest), len(whole)))
    reduced[:, interest] = np.eye(len(interest))
    reduced[:, others] = -np.linalg.solve(whole[np.ix_(others, others)], whole[np.ix_(others, interest)]).T
    towards = reduced.T @ np.linalg.solve(reduced @ whole @ reduced.T, reduced)
    return np.asarray(time * np.tensordot(information, towards, 2))
