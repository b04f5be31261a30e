"""Straight lines of neighbouring currents among scattered points: the paths along which they were measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array


def straight_lines(
    current: Array, *, longest: float = 3.0, diagonal: float = 1.2, cone: float = 0.45
) -> list[NDArray[np.intp]]:
    """Ordered indices of the points on each line of three or more along d, along q or along the diagonal.

    Two points are neighbours on a line where each is the other's nearest in that direction.

    Parameters
    ----------
    current : array, shape (n, 2)
    longest, diagonal : float
        Longest step along an axis and along the diagonal, in units of the usual distance between neighbours: the
        diagonals of a square grid are not lines of it.
    cone : float
        Largest offset of the next point across the line, relative to the step.
    """
    from scipy.spatial import cKDTree

    itself_and_next = np.asarray(cKDTree(current).query(current, k=2)[0])
    usual = float(np.median(itself_and_next[:, 1]))
    # Points nearly coincide where paths cross or one was repeated: one of them serves all lines.
    doubles = cKDTree(current).query_pairs(0.3 * usual, output_type="ndarray")
    single = np.setdiff1d(np.arange(len(current)), doubles.max(axis=1, initial=-1))
    kept = current[single]
    lines = []
    for direction, reach in (((1.0, 0.0), longest), ((0.0, 1.0), longest), ((0.5**0.5, 0.5**0.5), diagonal)):
        ahead = _nearest_ahead(kept, np.array(direction), reach * usual, cone)
        behind = _nearest_ahead(kept, -np.array(direction), reach * usual, cone)
        lines += [single[chain] for chain in _chains(ahead, behind)]
    return lines


def _nearest_ahead(current: Array, direction: Array, longest: float, cone: float) -> NDArray[np.intp]:
    """Index of the nearest point in a narrow cone ahead of each point; -1 where there is none."""
    step = current[None, :, :] - current[:, None, :]
    along = step @ direction
    across = np.abs(step @ np.array([-direction[1], direction[0]]))
    follows = (along > 0.0) & (along <= longest) & (across < cone * along)
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
