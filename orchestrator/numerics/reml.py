"""Least squares with fixed and random effects, the latter with a variance estimated from the data (REML).

    y = X b + Z d + e,      d ~ N(0, s^2 t),      e ~ N(0, s^2)

t maximises the restricted likelihood, with the fixed effects b integrated out (G. Wahba, "Spline Models for
Observational Data", SIAM 1990, doi:10.1137/1.9781611970128, section 4.8; H. D. Patterson, R. Thompson, "Recovery of
inter-block information when block sizes are unequal", Biometrika 58 (1971) 545-554, doi:10.1093/biomet/58.3.545).
s is one, or profiled. With M the projection orthogonal to X, twice the negative log likelihood is

    log |X'X| + sum log(1 + t g) + Q / s^2,      Q = y'M y - sum a^2 / (1/t + g),

with g the eigenvalues of Z'M Z and a the data along its eigenvectors; for a profiled s, (n - p) log Q replaces Q / s^2.
Values are comparable only between models with equal fixed effects.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Solution:
    """The solution for all effects.

    Attributes
    ----------
    coefficients : array, shape (k,)
    root : array, shape (k, k)
        Root R of the covariance R R^T.
    cost : float
        Minus twice the log restricted likelihood, up to a constant of the data.
    """

    coefficients: Array
    root: Array
    cost: float


class RestrictedLikelihood:
    """The restricted likelihood of 1/t, and the solution at a value.

    Parameters
    ----------
    rows : array, shape (n, k)
        Influence of each effect on each datum; the first `fixed` are fixed effects.
    target : array, shape (n,)
    fixed : int
    noise_known : bool
        Whether s is one, for data in units of their standard deviation; else it is profiled.
    ridge : float
        Relative information added to each fixed effect, for those without data.
    """

    def __init__(
        self, rows: Array, target: Array, fixed: int, *, noise_known: bool = True, ridge: float = 1e-12
    ) -> None:
        from scipy.linalg import cho_factor, cho_solve, eigh

        normal, right = rows.T @ rows, rows.T @ target
        # Effects differ greatly in scale; only their scaled information can be inverted.
        self._size = np.sqrt(np.maximum(np.diag(normal)[:fixed], 1e-300))
        scaled = normal[:fixed, :fixed] / np.outer(self._size, self._size) + ridge * np.eye(fixed)
        self._factor = cho_factor(scaled, lower=True)
        self._across = normal[:fixed, fixed:] / self._size[:, None]
        self._level = right[:fixed] / self._size
        schur = normal[fixed:, fixed:] - self._across.T @ cho_solve(self._factor, self._across)
        along = right[fixed:] - self._across.T @ cho_solve(self._factor, self._level)
        information, self._turn = eigh(0.5 * (schur + schur.T), driver="evd")
        self._information = np.maximum(information, 0.0)
        self._along = self._turn.T @ along
        self._squares = float(target @ target - self._level @ cho_solve(self._factor, self._level))
        self._freedom = None if noise_known else max(len(target) - fixed, 1)

    @property
    def largest_information(self) -> float:
        """Information of the random effect that the data determine best."""
        return max(float(self._information[-1]), 1e-300) if len(self._information) else 1.0

    @cached_property
    def _determinant(self) -> float:
        return 2.0 * float(np.log(np.diag(self._factor[0])).sum() + np.log(self._size).sum())

    def cost(self, precision: float) -> float:
        """Minus twice the log restricted likelihood at a 1/t, up to a constant of the data."""
        return float(self._costs(np.array([precision]))[0])

    def _costs(self, precision: Array) -> Array:
        """`cost` at several values, shape (n,)."""
        variance = 1.0 / (precision[:, None] + self._information)
        explained = variance @ self._along**2
        # -sum log(1 + t g), in a form that neither overflows nor cancels
        log_shrinkage = np.log(precision[:, None] * variance).sum(axis=1)
        if self._freedom is None:
            return np.asarray(self._squares - explained + self._determinant - log_shrinkage)
        residual = np.maximum(self._squares - explained, 1e-300)
        return np.asarray(self._freedom * np.log(residual) + self._determinant - log_shrinkage)

    def likeliest(self, decades: tuple[float, float], unit: float, tolerance: float) -> float:
        """The 1/t with the largest likelihood.

        Parameters
        ----------
        decades : (float, float)
            Range of log10(unit t), scanned in steps of one; the result may lie one beyond.
        unit : float
            Unit of 1/t.
        tolerance : float
            Tolerance of the result, in decades.
        """
        from scipy.optimize import minimize_scalar

        def cost(decade: float) -> float:
            return self.cost(10.0**-decade * unit)

        places = np.arange(decades[0], decades[1] + 0.5)
        near = float(places[np.argmin(self._costs(10.0**-places * unit))])
        best = minimize_scalar(cost, bounds=(near - 1.0, near + 1.0), method="bounded", options={"xatol": tolerance})
        return float(10.0 ** -float(best.x) * unit)

    def solution(self, precision: float) -> Solution:
        """All effects at a 1/t, for noise of variance one."""
        from scipy.linalg import cho_solve, solve_triangular

        fixed, size = len(self._size), self._size[:, None]
        std = np.sqrt(1.0 / (precision + self._information))
        rough = self._turn * std
        small = rough @ (std * self._along)
        coefficients = np.concatenate([cho_solve(self._factor, self._level - self._across @ small) / self._size, small])
        root = np.zeros((len(coefficients), len(coefficients)))
        root[:fixed, :fixed] = solve_triangular(self._factor[0], np.eye(fixed), lower=True).T / size
        root[:fixed, fixed:] = -cho_solve(self._factor, self._across @ rough) / size
        root[fixed:, fixed:] = rough
        return Solution(coefficients, root, self.cost(precision))


def most_likely(rows: Array, target: Array, fixed: int) -> Solution:
    """Solve for all effects with known noise.

    Parameters
    ----------
    rows : array, shape (n, k)
        Influence of each effect on each datum in standard deviations; the first `fixed` are fixed effects.
    target : array, shape (n,)
    fixed : int
    """
    likelihood = RestrictedLikelihood(rows, target, fixed)
    # Range from negligible random effects to practically fixed ones; the likelihood is flat beyond.
    return likelihood.solution(likelihood.likeliest((-6.0, 16.0), likelihood.largest_information, tolerance=0.02))
