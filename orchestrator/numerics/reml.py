"""Least squares with modes that are free and modes that are probably small; how small, the data say. Pure algebra.

    y = X b + Z d + e,      d ~ N(0, t),      e ~ N(0, 1)

t is that of the largest restricted likelihood, the free modes integrated out (G. Wahba, "Spline Models for
Observational Data", SIAM 1990, doi:10.1137/1.9781611970128, section 4.8; H. D. Patterson, R. Thompson, "Recovery of
inter-block information when block sizes are unequal", Biometrika 58 (1971) 545-554, doi:10.1093/biomet/58.3.545).
Splines that are not alike in anything but their free modes may be compared by it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array

_FAINT = 1e-12  # of a free mode's largest information, for those that no datum sees
_RANGE = (-6.0, 16.0)  # decades of t times the best seen mode's information


@dataclass(frozen=True)
class Solution:
    """Modes found.

    Attributes
    ----------
    modes : array, shape (k,)
    root : array, shape (k, k)
        Whose product with its transpose is the covariance.
    cost : float
        Minus twice the logarithm of the restricted likelihood, but for constants of the data.
    """

    modes: Array
    root: Array
    cost: float


def most_likely(rows: Array, target: Array, free: int) -> Solution:
    """Solve for all modes.

    Parameters
    ----------
    rows : array, shape (n, k)
        What each mode does to each datum, in units of its standard deviation; the first `free` modes are free.
    target : array, shape (n,)
    free : int
    """
    from scipy.linalg import cho_factor, cho_solve, eigh, solve_triangular
    from scipy.optimize import minimize_scalar

    normal, right = rows.T @ rows, rows.T @ target
    # Modes are of very different sizes; only their scaled information can be inverted.
    size = np.sqrt(np.maximum(np.diag(normal)[:free], 1e-300))
    seen = normal[:free, :free] / np.outer(size, size) + _FAINT * np.eye(free)
    factor = cho_factor(seen, lower=True)
    across = normal[:free, free:] / size[:, None]
    level = right[:free] / size
    left = normal[free:, free:] - across.T @ cho_solve(factor, across)
    asked = right[free:] - across.T @ cho_solve(factor, level)
    information, turn = eigh(0.5 * (left + left.T))
    information = np.maximum(information, 0.0)
    asked = turn.T @ asked
    best_seen = max(float(information[-1]), 1e-300) if len(information) else 1.0
    squares = float(target @ target - level @ cho_solve(factor, level))
    constant = squares + 2.0 * float(np.log(np.diag(factor[0])).sum() + np.log(size).sum())

    def spread(log_t: float) -> Array:
        return np.asarray(1.0 / (10.0**-log_t * best_seen + information))

    def cost(log_t: float) -> float:
        own = spread(log_t)
        # log(1 + t g) as a sum of what neither overflows nor cancels
        grown = np.log(10.0**-log_t * best_seen * own)
        return constant - float((own * asked**2).sum() + grown.sum())

    places = np.linspace(*_RANGE, 23)
    near = float(places[int(np.argmin([cost(float(x)) for x in places]))])
    best = minimize_scalar(cost, bounds=(near - 1.0, near + 1.0), method="bounded", options={"xatol": 0.02})
    own = np.sqrt(spread(float(best.x)))
    rough = turn * own
    found = rough @ (own * asked)
    modes = np.concatenate([cho_solve(factor, level - across @ found) / size, found])
    root = np.zeros((len(modes), len(modes)))
    root[:free, :free] = solve_triangular(factor[0], np.eye(free), lower=True).T / size[:, None]
    root[:free, free:] = -cho_solve(factor, across @ rough) / size[:, None]
    root[free:, free:] = rough
    return Solution(modes, root, float(best.fun))
