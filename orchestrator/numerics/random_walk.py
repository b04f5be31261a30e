"""Least squares with a random walk whose size is estimated from the data.

    y = X b + Z d + e,      d ~ N(0, s^2 t),      e ~ N(0, s^2)

Z d are the walk's steps; s is profiled, and t maximises the restricted likelihood (`reml`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orchestrator.numerics.reml import RestrictedLikelihood
from orchestrator.numerics.types import Array, Mask


@dataclass(frozen=True)
class Walk:
    """A random walk in a regression, with its steps rotated so that the data separate them.

    Attributes
    ----------
    steps : array, shape (n, m)
        Influence of each step on each datum.
    seen : array, shape (m,)
        Sum of squares of each column.
    ratio : float
        t, the variance of the steps over that of the data.
    """

    steps: Array
    seen: Array
    ratio: float = 0.0

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom of the walk."""
        return float(np.sum(self.ratio * self.seen / (1.0 + self.ratio * self.seen)))

    def weighed(self, x: Array, y: Array) -> Array:
        """x' V^-1 y with V the covariance of the data in units of s^2."""
        share = self.ratio / (1.0 + self.ratio * self.seen)
        out: Array = x.T @ y - ((x.T @ self.steps) * share) @ (self.steps.T @ y)
        return out

    def solve(self, design: Array, target: Array) -> tuple[float, Array]:
        """Weighted residual sum of squares, and the estimate of b."""
        size = _sizes(design)
        scaled = design / size
        information = self.weighed(scaled, scaled)
        estimate = np.linalg.pinv(information, rcond=1e-13, hermitian=True) @ self.weighed(scaled, target)
        off = target - scaled @ estimate
        return float(max(self.weighed(off[:, None], off[:, None])[0, 0], 0.0)), estimate / size

    def covariance(self, design: Array, known: Array | None = None) -> Array:
        """Covariance of the estimate, in units of s^2.

        Parameters
        ----------
        known : array, shape (columns,), optional
            Prior precision of each coefficient, in these units.
        """
        size = _sizes(design)
        if known is not None:
            # Without this, columns with prior information alone would dominate the inverse.
            size = np.sqrt(size**2 + known)
        information = self.weighed(design / size, design / size)
        if known is not None:
            information = information + np.diag(known / size**2)
        out = np.linalg.pinv(information, rcond=1e-13, hermitian=True)
        return np.asarray(out / np.outer(size, size), dtype=np.float64)

    def likeliest(self, design: Array, target: Array) -> Walk:
        """The walk with the ratio that maximises the restricted likelihood."""
        if not self.seen.size:
            return self
        rows = np.concatenate([design / _sizes(design), self.steps], axis=1)
        likelihood = RestrictedLikelihood(rows, target, design.shape[1], noise_known=False)
        # Range from a negligible walk to one that follows each datum.
        unit = max(float(self.seen.max()), 1e-300)
        return replace(self, ratio=1.0 / likelihood.likeliest((-2.5, 9.5), unit, tolerance=1e-5))


def _sizes(design: Array) -> Array:
    size = np.linalg.norm(design, axis=0)
    return np.where(size > 0.0, size, 1.0)


def no_walk(count: int) -> Walk:
    """A walk of zero size for so many data."""
    return Walk(np.zeros((count, 0)), np.zeros(0))


def random_walk(time: Array, gain: Array, counted: Mask, nodes: int = 24) -> Walk:
    """A walk w(t) that acts through `gain`; its mean over the counted instants is zero.

    Parameters
    ----------
    time : array, shape (n,)
    gain : array, shape (n, k)
        Influence of w = 1 on each of an instant's k data; the model has n * k rows.
    counted : array of bool, shape (n,)
    nodes : int
        Nodes of the walk, with equally many data between them, linear in between.
    """
    span = float(np.ptp(time))
    if span <= 0.0:
        return no_walk(gain.size)
    knots = np.unique(np.quantile(time, np.linspace(0.0, 1.0, nodes)))
    since = (knots - knots[0]) / span
    walk = np.sqrt(np.diff(since)) * np.tri(len(knots), len(knots) - 1, -1)
    values = np.stack([np.interp(time, knots, step) for step in walk.T], axis=1)
    values -= values[counted].mean(axis=0)
    steps = (gain[:, :, None] * values[:, None, :]).reshape(gain.size, -1)
    seen, turn = np.linalg.eigh(steps.T @ steps)
    return Walk(steps @ turn, np.maximum(seen, 0.0))
