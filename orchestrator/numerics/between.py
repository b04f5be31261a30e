"""Random-effects model: mean and spread of a population from values with known errors.

    y_k = mu + b_k + e_k,      b_k ~ N(0, tau^2),      e_k ~ N(0, s_k^2),      s_k known

mu is integrated out, and tau is weighted by its marginal likelihood under a flat prior (Gelman 2006,
doi:10.1214/06-BA117A): the most likely tau of few values is often zero, which underestimates the spread of the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Population:
    """Predictive distribution of the next value's mu + b.

    Attributes
    ----------
    mean : float
    std : float
        Standard deviation of the next value: the spread, and the uncertainty of mean and spread.
    between : float
        Root of the mean of tau^2.
    """

    mean: float
    std: float
    between: float


def population(values: Array, errors: Array, nodes: int = 800, widest: float = 8.0) -> Population:
    """Mean and spread behind values (n,) with standard errors (n,), n being four or more.

    Parameters
    ----------
    nodes : int
        Nodes of the integral over tau.
    widest : float
        Upper limit of the integral, in standard deviations of the values.
    """
    unit = float(np.std(values, ddof=1))
    if not unit > 0.0:
        unit = float(np.median(errors)) or max(abs(float(np.mean(values))), 1.0) * np.finfo(np.float64).eps
    tau = unit * widest * (np.arange(nodes) + 0.5) / nodes
    variances = tau[:, None] ** 2 + errors**2
    known = np.sum(1.0 / variances, axis=1)
    middle = np.sum(values / variances, axis=1) / known
    squares = np.sum((values - middle[:, None]) ** 2 / variances, axis=1)
    log_likelihood = -0.5 * (np.sum(np.log(variances), axis=1) + np.log(known) + squares)
    weight = np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    mean = float(weight @ middle)
    between = float(weight @ tau**2)
    variance = between + float(weight @ (1.0 / known)) + float(weight @ (middle - mean) ** 2)
    return Population(mean, float(np.sqrt(variance)), float(np.sqrt(between)))
