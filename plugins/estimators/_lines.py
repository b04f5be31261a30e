"""Straight lines of neighbouring currents among scattered points: the paths along which they were measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Direction, and the longest step along it in units of the usual distance between neighbours. The diagonals of a
# square grid are not lines of it.
_DIRECTIONS = (((1.0, 0.0), 3.0), ((0.0, 1.0), 3.0), ((0.5**0.5, 0.5**0.5), 1.2))
_CONE = 0.25  # how far a next point may lie off the line, relative to the step


def straight_lines(current: Array) -> list[NDArray[np.intp]]:
    """Indices of the points of each line of three or more along d, along q or along the diagonal, in order.

    Two points follow each other on a line where each is the other's nearest in that direction.

    Parameters
    ----------
    current : array, shape (n, 2)
    """
    from scipy.spatial import cKDTree

    itself_and_next = np.asarray(cKDTree(current).query(current, k=2)[0])
    usual = float(np.median(itself_and_next[:, 1]))
    lines = []
    for direction, longest in _DIRECTIONS:
        ahead = _nearest_ahead(current, np.array(direction), usual, longest * usual)
        behind = _nearest_ahead(current, -np.array(direction), usual, longest * usual)
        lines += _chains(ahead, behind)
    return lines


def _nearest_ahead(current: Array, direction: Array, usual: float, longest: float) -> NDArray[np.intp]:
    """Index of the nearest point in a narrow cone ahead of each point; -1 where there is none."""
    step = current[None, :, :] - current[:, None, :]
    along = step @ direction
    across = np.abs(step @ np.array([-direction[1], direction[0]]))
    # Where two paths cross, two points all but coincide: neither is the other's next.
    follows = (along > 0.3 * usual) & (along <= longest) & (across < _CONE * along)
    distance = np.where(follows, along + across, np.inf)
    nearest = np.argmin(distance, axis=1)
    return np.where(np.isfinite(distance[np.arange(len(current)), nearest]), nearest, -1)


def _chains(ahead: NDArray[np.intp], behind: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    mutual = np.array([n >= 0 and behind[n] == p for p, n in enumerate(ahead)], dtype=bool)
    after = np.where(mutual, ahead, -1)
    chains = []
    for start in np.setdiff1d(np.arange(len(after)), after[after >= 0]):
        chain = [int(start)]
        while after[chain[-1]] >= 0:
            chain.append(int(after[chain[-1]]))
        if len(chain) >= 3:
            chains.append(np.array(chain, dtype=np.intp))
    return chains
