"""Whether an effect's size is the same all through the recording; an effect that is only a stand-in drifts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis._fit import Fitter
from orchestrator.diagnosis._fitted import Fit
from orchestrator.diagnosis._library import Active
from protocols import ParameterRole

Array = NDArray[np.float64]

BLOCKS = 8


def inconstancy(fit: Fit) -> dict[str, float]:
    """How much each active effect's amplitude scatters between blocks of the recording, relative to itself.

    The recording is cut, in order of time, into blocks that know equally much about the amplitude; in each the
    amplitude is estimated anew with all else held. What the blocks want to add, beyond what noise alone makes them
    want, is compared with the amplitude (the largest of them where an effect has several).
    """
    scatter = block_scatter(fit)
    found: dict[str, float] = {}
    k = 0
    for active in fit.model.active:
        worst, largest = 0.0, max(abs(active.coordinate(n)) for n in active.candidate.amplitudes)
        for name in active.free:
            if name in active.candidate.amplitudes and largest > 0.0:
                worst = max(worst, scatter[k] / largest)
            k += 1
        found[active.name] = float(worst)
    return found


def certainty(fit: Fit) -> dict[str, float]:
    """Each active effect's largest amplitude in standard deviations, disagreement between blocks included."""
    spread = np.sqrt(np.diag(fit.covariance()) * max(fit.chi2_per_dof, 1.0) + block_scatter(fit) ** 2 / BLOCKS)
    found: dict[str, float] = {}
    for k, (active, name) in enumerate(fit.model.free):
        if name in active.candidate.amplitudes:
            size = abs(active.coordinate(name)) / float(spread[k])
            found[active.name] = max(found.get(active.name, 0.0), size)
    return found


def coordinate_spread(fitter: Fitter, fit: Fit) -> Array:
    """Standard deviation of each free coordinate, shape (free,).

    The larger of the fit's own, inflated by chi2 per degree of freedom and with those flexible forms free that go
    either way, and of what the segments' disagreement makes of it (the sandwich estimate with segments as clusters,
    H. White, Econometrica 48 (1980), doi:10.2307/1912934); and the scatter between blocks on top.
    """
    rigid = [(a, n) for a in fit.model.active for n in _yielding(a)]
    loose = fitter.evaluate(fit.model, fit.frame, rigid)
    own, _ = loose.projected()
    inverse = np.linalg.inv(own + np.eye(len(own)))
    pulls = _pulls(loose)
    sandwich = inverse @ (pulls.T @ pulls) @ inverse * len(pulls) / max(len(pulls) - len(own), 1)
    count = len(fit.model.free)
    plain = np.diag(inverse) * max(fit.chi2_per_dof, 1.0)
    variance = np.maximum(plain, np.diag(sandwich))[:count] + block_scatter(fit) ** 2 / BLOCKS
    return np.asarray(np.sqrt(variance))


def _yielding(active: Active) -> list[str]:
    """Refinements that are not free, but might lie on either side of where they are."""
    names = active.candidate.of_role(ParameterRole.REFINEMENT)
    return [n for n in names if n not in active.free and active.values[n] > active.candidate.named(n).low]


def _pulls(fit: Fit) -> Array:
    """What each training segment pulls at each column, R_s and the map following; shape (segments, columns)."""
    width, count = fit.normal.shape[0], fit.columns[0].shape[1]
    cross = np.zeros((width, count))
    parts = list(zip(fit.prepared.pieces, fit.frame.pieces, fit.columns, fit.resistance, fit.residual, strict=True))
    parts = [part for part in parts if not part[0].held_out]
    for _, frame, d, r, _ in parts:
        cross[0] += r @ d
        cross[1:] += frame.white_basis.T @ d
    follow = np.linalg.solve(fit.normal, cross)
    return np.array([e @ d - (e @ r) * follow[0] - (e @ f.white_basis) @ follow[1:] for _, f, d, r, e in parts])


def foretold(without: Fit, full: Fit) -> bool:
    """Whether an effect that the fitted part asks for makes the held-out part fit better too."""
    before, after = (f.chi2_of(lambda p: p.held_out) for f in (without, full))
    return before is None or after is None or after < before


def block_scatter(fit: Fit) -> Array:
    """rms of what the blocks want to add to each free coordinate, beyond noise; shape (free,)."""
    return np.array([_scatter(fit, k) for k in range(len(fit.model.free))])


def _scatter(fit: Fit, column: int) -> float:
    weights, pulls = [], []
    for piece, d, e in zip(fit.prepared.pieces, fit.columns, fit.residual, strict=True):
        if not piece.held_out:
            weights.append(float(d[:, column] @ d[:, column]))
            pulls.append(float(d[:, column] @ e))
    weight, pull = np.cumsum(weights), np.cumsum(pulls)
    if weight[-1] <= 0.0:
        return 0.0
    edges = np.searchsorted(weight, weight[-1] * (np.arange(1, BLOCKS + 1) / BLOCKS - 1e-12))
    at = np.unique(np.minimum(edges, len(weight) - 1))
    w = np.diff(np.concatenate([[0.0], weight[at]]))
    p = np.diff(np.concatenate([[0.0], pull[at]]))
    known = w > 0.0
    beyond = float(np.mean((p[known] / w[known]) ** 2 - 1.0 / w[known]))
    return math.sqrt(max(beyond, 0.0))
