"""Where points of an injection lie too far apart: an inductance differs much between two that follow each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.surface import triangulate
from orchestrator.numerics.types import Array
from protocols import Point


def steep_steps(
    current: Array, inductance: Array, *, steepest: float, narrowest_wb: float, where: str
) -> list[tuple[float, Point]]:
    """Steps along d, along q and around the rim in which an inductance changes too much, the steepest first.

    Parameters
    ----------
    current : array, shape (n, 2)
        What was asked for [A]: points of a line have one coordinate in common, exactly.
    inductance : array, shape (n, 2, 2)
        L = dpsi/di there [H].
    steepest : float
        Ratio of L_dd, or of L_qq, at a step's two ends that is not yet too much.
    narrowest_wb : float
        A step that takes less flux is left as it is: the ripple itself reaches across.
    where : str
        The recording, for the error.

    Returns
    -------
    list of (ratio, (i_d, i_q))
        By how much they differ, and the middle of the step [A].

    Raises
    ------
    NotMeasuredError
        Where the points do not span an area of currents.
    """
    start, end = np.unique(np.sort(np.concatenate([*_lines(current), _rim(current, where)]), axis=1), axis=0).T
    diagonal = np.abs(np.einsum("nii->ni", inductance))  # a point gone wrong may have any sign
    ratio = np.exp(np.abs(np.log(diagonal[end] / diagonal[start])).max(axis=1))
    step = current[end] - current[start]
    taken_wb = np.linalg.norm(0.5 * (diagonal[start] + diagonal[end]) * step, axis=1)
    steep = np.flatnonzero((ratio > steepest) & (taken_wb > narrowest_wb))
    middle = 0.5 * (current[start] + current[end])
    return [(float(ratio[n]), (float(middle[n, 0]), float(middle[n, 1]))) for n in steep[np.argsort(-ratio[steep])]]


def _lines(current: Array) -> list[NDArray[np.intp]]:
    """Pairs of neighbours that share a coordinate, shape (e, 2): along d, and along q."""
    pairs = []
    for axis in range(2):
        order = np.lexsort((current[:, axis], current[:, 1 - axis]))
        shared = current[order[1:], 1 - axis] == current[order[:-1], 1 - axis]
        pairs.append(np.stack([order[:-1], order[1:]], axis=1)[shared])
    return pairs


def _rim(current: Array, where: str) -> NDArray[np.intp]:
    """Pairs of neighbours on the hull, shape (e, 2): outside of it nothing is delivered."""
    return np.asarray(triangulate(current, where).convex_hull, dtype=np.intp)
