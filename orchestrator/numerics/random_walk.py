"""Least squares beside a random walk: how far it wanders between the data, the data say. Knows no physics.

    y = X b + Z d + e,      d ~ N(0, s^2 t),      e ~ N(0, s^2)

Z d are the walk's steps; s is profiled, t is that of the largest restricted likelihood (`reml`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orchestrator.numerics.reml import RestrictedLikelihood
from orchestrator.numerics.types import Array, Mask


@dataclass(frozen=True)
class Walk:
    """A random walk in a regression, its steps turned so that the data see them apart.

    Attributes
    ----------
    steps : array, shape (n, m)
        What each does to each datum.
    seen : array, shape (m,)
        Sum of the squares of each.
    ratio : float
        t: variance of the steps to that of the data.
    """

    steps: Array
    seen: Array
    ratio: float = 0.0

    @property
    def freedom(self) -> float:
        """How many data the walk takes up."""
        return float(np.sum(self.ratio * self.seen / (1.0 + self.ratio * self.seen)))

    def weighed(self, x: Array, y: Array) -> Array:
        """x' V^-1 y, V being the covariance of the data in units of s^2."""
        share = self.ratio / (1.0 + self.ratio * self.seen)
        out: Array = x.T @ y - ((x.T @ self.steps) * share) @ (self.steps.T @ y)
        return out

    def solve(self, design: Array, target: Array) -> tuple[float, Array]:
        """Weighed sum of squares left, and the answer b."""
        size = _sizes(design)
        scaled = design / size
        information = self.weighed(scaled, scaled)
        answer = np.linalg.pinv(information, rcond=1e-13, hermitian=True) @ self.weighed(scaled, target)
        off = target - scaled @ answer
        return float(max(self.weighed(off[:, None], off[:, None])[0, 0], 0.0)), answer / size

    def covariance(self, design: Array, known: Array | None = None) -> Array:
        """Of the answer, in units of s^2.

        Parameters
        ----------
        known : array, shape (columns,), optional
            One over the variance of what is known of each beforehand, in these units.
        """
        size = _sizes(design)
        if known is not None:
            # What is told by what is known alone would else be all that the inverse sees.
            size = np.sqrt(size**2 + known)
        information = self.weighed(design / size, design / size)
        if known is not None:
            information = information + np.diag(known / size**2)
        out = np.linalg.pinv(information, rcond=1e-13, hermitian=True)
        return np.asarray(out / np.outer(size, size), dtype=np.float64)

    def likeliest(self, design: Array, target: Array) -> Walk:
        """The same with the ratio of the largest restricted likelihood."""
        if not self.seen.size:
            return self
        rows = np.concatenate([design / _sizes(design), self.steps], axis=1)
        likelihood = RestrictedLikelihood(rows, target, design.shape[1], noise_known=False)
        # From a walk that no datum notices to one that follows each of them.
        unit = max(float(self.seen.max()), 1e-300)
        return replace(self, ratio=1.0 / likelihood.likeliest((-2.5, 9.5), unit, tolerance=1e-5))


def _sizes(design: Array) -> Array:
    size = np.linalg.norm(design, axis=0)
    return np.where(size > 0.0, size, 1.0)


def no_walk(count: int) -> Walk:
    """None at all, beside so many data."""
    return Walk(np.zeros((count, 0)), np.zeros(0))


def random_walk(time: Array, gain: Array, counted: Mask, nodes: int = 24) -> Walk:
    """A walk w(t) of which `gain` is seen; its mean over the counted instants is zero.

    Parameters
    ----------
    time : array, shape (n,)
    gain : array, shape (n, k)
        What w = 1 does to each of an instant's k data, which are then the rows n * k.
    counted : array of bool, shape (n,)
    nodes : int
        Instants, with as many data between any two of them, between which the walk is straight.
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
