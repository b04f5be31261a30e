"""Least squares beside a random walk: how far it wanders between the data, the data say. Knows no physics.

    y = X b + Z d + e,      d ~ N(0, s^2 t),      e ~ N(0, s^2)

s is profiled, t is that of the largest restricted likelihood (H. D. Patterson, R. Thompson, "Recovery of inter-block
information when block sizes are unequal", Biometrika 58 (1971) 545-554, doi:10.1093/biomet/58.3.545).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array

_NODES = 24  # of a walk, straight between them
_DECADES = (-3.0, 10.0)  # of t times what the best seen step of the walk does


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

    def covariance(self, design: Array) -> Array:
        """Of the answer, in units of s^2."""
        size = _sizes(design)
        out = np.linalg.pinv(self.weighed(design / size, design / size), rcond=1e-13, hermitian=True)
        return np.asarray(out / np.outer(size, size), dtype=np.float64)

    def likeliest(self, design: Array, target: Array) -> Walk:
        """The same with the ratio of the largest restricted likelihood."""
        from scipy.optimize import minimize_scalar

        if not self.seen.size:
            return self
        scaled = design / _sizes(design)
        unit = max(float(self.seen.max()), 1e-300)
        free = max(len(target) - design.shape[1], 1)

        def at(decade: float) -> Walk:
            return replace(self, ratio=10.0**decade / unit)

        def cost(decade: float) -> float:
            walk = at(decade)
            squares = walk.solve(scaled, target)[0]
            told = np.linalg.slogdet(walk.weighed(scaled, scaled))[1]
            own = np.log1p(walk.ratio * walk.seen).sum()
            return float(free * np.log(max(squares, 1e-300)) + told + own)

        places = np.linspace(*_DECADES, 27)
        near = float(min(places, key=cost))
        return at(float(minimize_scalar(cost, bounds=(near - 0.5, near + 0.5), method="bounded").x))


def _sizes(design: Array) -> Array:
    size = np.linalg.norm(design, axis=0)
    return np.where(size > 0.0, size, 1.0)


def no_walk(count: int) -> Walk:
    """None at all, beside so many data."""
    return Walk(np.zeros((count, 0)), np.zeros(0))


def random_walk(time: Array, gain: Array, counted: NDArray[np.bool_]) -> Walk:
    """A walk w(t) of which `gain` is seen; its mean over the counted instants is zero.

    Parameters
    ----------
    time : array, shape (n,)
    gain : array, shape (n, k)
        What w = 1 does to each of an instant's k data, which are then the rows n * k.
    counted : array of bool, shape (n,)
    """
    span = float(np.ptp(time))
    if span <= 0.0:
        return no_walk(gain.size)
    nodes = np.unique(np.quantile(time, np.linspace(0.0, 1.0, _NODES)))
    since = (nodes - nodes[0]) / span
    walk = np.sqrt(np.diff(since)) * np.tri(len(nodes), len(nodes) - 1, -1)
    values = np.stack([np.interp(time, nodes, step) for step in walk.T], axis=1)
    values -= values[counted].mean(axis=0)
    steps = (gain[:, :, None] * values[:, None, :]).reshape(gain.size, -1)
    seen, turn = np.linalg.eigh(steps.T @ steps)
    return Walk(steps @ turn, np.maximum(seen, 0.0))
