"""Join flux paths in the current plane where they cross; the misfit at the crossings checks them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.analysis._sweep import FluxPath
from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Network:
    """Paths with constants that minimise the misfit at their crossings.

    Attributes
    ----------
    paths : tuple of FluxPath
        The largest connected set, offset by its constants (one common vector stays undetermined).
    members : tuple of int
        Indices of these among the given paths.
    misfit : array, shape (c, 2), or None
        Residual flux difference at each crossing [Wb]; None without redundant crossings.
    """

    paths: tuple[FluxPath, ...]
    members: tuple[int, ...]
    misfit: Array | None


@dataclass(frozen=True)
class Crossings:
    """Where paths cross.

    Attributes
    ----------
    pairs : tuple of (int, int)
        Indices of the two paths.
    difference, psi : array, shape (c, 2)
        Flux of the first path less that of the second, and their mean [Wb].
    """

    pairs: tuple[tuple[int, int], ...]
    difference: Array
    psi: Array


def join_paths(paths: list[FluxPath]) -> Network:
    """Fit one constant a path to the flux differences at all crossings, least squares."""
    crossings = crossings_of(paths)
    pairs, differences = crossings.pairs, crossings.difference
    members = _largest_component(len(paths), list(pairs))
    place = {m: k for k, m in enumerate(members)}
    used = [n for n, (a, _) in enumerate(pairs) if a in place]
    if not used:
        return Network((paths[members[0]],), tuple(members[:1]), None)
    design = np.zeros((len(used), len(members)))
    for row, n in enumerate(used):
        design[row, place[pairs[n][0]]], design[row, place[pairs[n][1]]] = -1.0, 1.0
    rise = differences[used]
    constants = np.linalg.lstsq(design, rise, rcond=None)[0]
    moved = tuple(FluxPath(paths[m].current, paths[m].psi + constants[k], paths[m].std) for m, k in place.items())
    overdetermined = len(used) >= len(members)
    return Network(moved, tuple(members), rise - design @ constants if overdetermined else None)


def crossings_of(paths: Sequence[FluxPath]) -> Crossings:
    """Crossings of any two paths with their flux differences; leaves the paths' constants unchanged."""
    pairs, difference, psi = [], [], []
    for a in range(len(paths)):
        for b in range(a + 1, len(paths)):
            fluxes = _flux_at_crossing(paths[a], paths[b])
            if fluxes is not None:
                pairs.append((a, b))
                difference.append(fluxes[0] - fluxes[1])
                psi.append(0.5 * (fluxes[0] + fluxes[1]))
    return Crossings(tuple(pairs), np.reshape(difference, (-1, 2)), np.reshape(psi, (-1, 2)))


def _flux_at_crossing(a: FluxPath, b: FluxPath) -> tuple[Array, Array] | None:
    """psi_a and psi_b where the two polylines meet; None where they do not."""
    p, q = a.current[:-1, None], b.current[None, :-1]
    r, s = np.diff(a.current, axis=0)[:, None], np.diff(b.current, axis=0)[None]
    cross = r[..., 0] * s[..., 1] - r[..., 1] * s[..., 0]
    steep = np.abs(cross) > 1e-3 * np.linalg.norm(r, axis=-1) * np.linalg.norm(s, axis=-1)
    safe = np.where(steep, cross, 1.0)
    gap = q - p
    t = (gap[..., 0] * s[..., 1] - gap[..., 1] * s[..., 0]) / safe
    u = (gap[..., 0] * r[..., 1] - gap[..., 1] * r[..., 0]) / safe
    # Paths that end on one another miss by the control error: tolerance of a hundredth of their length.
    slack_t, slack_u = (0.01 * np.linalg.norm(np.ptp(x.current, axis=0)) for x in (a, b))
    beyond_t = np.maximum(np.abs(t - 0.5) - 0.5, 0.0) * np.linalg.norm(r, axis=-1)
    beyond_u = np.maximum(np.abs(u - 0.5) - 0.5, 0.0) * np.linalg.norm(s, axis=-1)
    hit = steep & (beyond_t <= slack_t) & (beyond_u <= slack_u)
    if not hit.any():
        return None
    m, n = np.unravel_index(np.argmin(np.where(hit, beyond_t + beyond_u, np.inf)), hit.shape)
    psi_a = a.psi[m] + t[m, n] * (a.psi[m + 1] - a.psi[m])
    psi_b = b.psi[n] + u[m, n] * (b.psi[n + 1] - b.psi[n])
    return np.asarray(psi_a), np.asarray(psi_b)


def _largest_component(n: int, pairs: list[tuple[int, int]]) -> list[int]:
    group = list(range(n))
    for a, b in pairs:
        old, new = group[b], group[a]
        group = [new if g == old else g for g in group]
    best = max(set(group), key=group.count)
    return [k for k in range(n) if group[k] == best]
