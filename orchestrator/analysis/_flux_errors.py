"""Error model of a flux integrated along a path: a random walk, partly common to paths of one direction.

Along a path it is a sum of independent waves cos(k pi s), the k-th falling as 1/k. Along the swept direction the errors
of parallel paths are correlated, since heat changes R_s in each sweep in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orchestrator.analysis._sweep import FluxPath
from orchestrator.numerics.types import Array

WAVES = 6
"""Number of waves per path: the sixth is as small as the white part of the error."""


def sizes(paths: Sequence[FluxPath], white: float = 0.2, perfect: float = 1e-4) -> Array:
    """Standard deviations of the waves of each path's error, along its direction and across, shape (p, 2, waves).

    Parameters
    ----------
    paths : sequence of FluxPath
    white : float
        Share of the first wave that does not fall with the wave's number.
    perfect : float
        Error that every path has, as a share of its flux: no integral is better.
    """
    floor = perfect * max(float(np.ptp(path.psi, axis=0).max()) for path in paths)
    stated = np.array([path.std for path in paths]) ** 2 + floor**2
    std = np.sqrt(np.einsum("pxc,pc->px", directions(paths) ** 2, stated))
    return np.asarray(std[:, :, None] * np.hypot(1.0 / np.arange(1, WAVES + 1), white))


def directions(paths: Sequence[FluxPath]) -> Array:
    """Unit vectors along and across the way that each path is swept, shape (p, 2, 2)."""
    steps = np.array([path.current[-1] - path.current[0] for path in paths])
    along = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    return np.stack([along, along[:, ::-1] * np.array([-1.0, 1.0])], axis=1)


def waves(count: int) -> Array:
    """Matrix from values along a path to the amplitudes of cos(k pi s), k = 1, 2, .., shape (waves, count)."""
    place = (np.arange(count) + 0.5) / count
    return np.asarray(2.0 / count * np.cos(np.pi * np.outer(np.arange(1, WAVES + 1), place)))


def whitening(paths: Sequence[FluxPath]) -> Array:
    """Whitening matrix for the errors of paths that are swept in one direction, shape (p, p).

    Their common variance equals each path's own.
    """
    out = np.zeros((len(paths), len(paths)))
    direction = directions(paths)[:, 0]
    is_parallel = np.abs(direction @ direction.T) > 0.99
    for group in np.unique(is_parallel, axis=0):
        members = np.flatnonzero(group)
        mean = np.full((len(members), len(members)), 1.0 / len(members))
        out[np.ix_(members, members)] = np.eye(len(members)) - mean + mean / np.sqrt(1.0 + len(members))
    return out
