"""Steps between neighbouring injection points over which an inductance changes too much."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.surface import triangulate
from orchestrator.numerics.types import Array
from protocols import Point


def steep_steps(
    current: Array, inductance: Array, *, steepest: float, narrowest_wb: float, where: str
) -> list[tuple[float, Point]]:
    """Steps along d, along q and along the hull over which an inductance changes too much, the steepest first.

    Parameters
    ----------
    current : array, shape (n, 2)
        Commanded currents [A]: points of a line have exactly one coordinate in common.
    inductance : array, shape (n, 2, 2)
        L = dpsi/di there [H].
    steepest : float
        Largest acceptable ratio of L_dd, or of L_qq, between a step's two ends.
    narrowest_wb : float
        Steps with less flux are accepted: the ripple itself spans them.
    where : str
        The recording, for the error.

    Returns
    -------
    list of (ratio, (i_d, i_q))
        Ratio of the inductances, and the middle of the step [A].

    Raises
    ------
    NotMeasuredError
        Where the points do not span an area of currents.
    """
    hull = np.asarray(triangulate(current, where).convex_hull, dtype=np.intp)
    start, end = np.unique(np.sort(np.concatenate([*_lines(current), hull]), axis=1), axis=0).T
    diagonal = np.abs(np.einsum("nii->ni", inductance))  # a faulty point may have any sign
    ratio = np.exp(np.abs(np.log(diagonal[end] / diagonal[start])).max(axis=1))
    step = current[end] - current[start]
    flux_step_wb = np.linalg.norm(0.5 * (diagonal[start] + diagonal[end]) * step, axis=1)
    steep = np.flatnonzero((ratio > steepest) & (flux_step_wb > narrowest_wb))
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
