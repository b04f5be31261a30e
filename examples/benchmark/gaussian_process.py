"""Bayesian calibration with a discrepancy (Kennedy and O'Hagan 2001, doi:10.1111/1467-9868.00294).

y = base + effects + d(i_d, i_q, kind of row) + noise: sizes have normal priors, d is a Gaussian process over the
currents. Effects whose posterior lies three standard deviations from zero are named; where d itself is larger than the
noise, the answer is that something is unknown.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from regression import Problem, answer_of, main
from scipy.linalg import cho_factor, cho_solve

ROWS = 1200
"""Of the recording's, drawn at random: the cost grows with the cube."""
PRIOR_SIZES = 3.0
"""Prior standard deviation of a size, in units of the typical one."""
SIGMAS = 3.0
DISCREPANCY_NOISES = 3.0
"""Standard deviation of d, in units of the noise, from which it is something unknown."""


def search(problem: Problem, entry: dict[str, Any]) -> dict[str, Any]:
    """Maximise the marginal likelihood over the discrepancy's size and length, and name what is significant."""
    allowed = problem.allowed(entry)
    rng = np.random.default_rng(0)
    drawn = np.sort(rng.choice(len(problem.y), min(ROWS, len(problem.y)), replace=False))
    typical = np.array([problem.columns[k].typical for k in allowed])
    x, y, where = problem.effects[drawn][:, allowed] * typical, problem.y[drawn], problem.where[drawn]
    basis = np.linalg.qr(problem.base[drawn] / (np.sqrt(np.mean(problem.base[drawn] ** 2, axis=0)) + 1e-300))[0]
    prior = PRIOR_SIZES**2 * x @ x.T + 1e6 * len(y) * basis @ basis.T
    distance = np.sum((where[:, None, :2] - where[None, :, :2]) ** 2, axis=2)
    same = where[:, None, 2] == where[None, :, 2]
    best: tuple[float, float, Any] = (-np.inf, 0.0, None)
    for length in (0.15, 0.5):
        shape = np.exp(-0.5 * distance / length**2) * same
        for size in (0.0, 1.0, 4.0, 16.0, 64.0, 256.0):
            factor = cho_factor(prior + size**2 * shape + 1.001 * np.eye(len(y)), lower=True)
            evidence = -0.5 * float(y @ cho_solve(factor, y)) - float(np.sum(np.log(np.diag(factor[0]))))
            if evidence > best[0]:
                best = evidence, size, factor
    _, size, factor = best
    mean = PRIOR_SIZES**2 * x.T @ cho_solve(factor, y)
    covariance = PRIOR_SIZES**2 * np.eye(x.shape[1]) - PRIOR_SIZES**4 * x.T @ cho_solve(factor, x)
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    answer = answer_of(problem, allowed[np.abs(mean) > SIGMAS * std], entry)
    unknown = size > DISCREPANCY_NOISES
    answer["verdict"] = "unknown" if unknown else "explained" if answer["names"] else "clean"
    answer["usable"] = not unknown
    return answer


if __name__ == "__main__":
    main(search, __doc__)
