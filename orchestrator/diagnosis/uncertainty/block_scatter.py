"""Whether a fitted effect is the same all through the recording: what is only a stand-in for another drifts."""

from __future__ import annotations

import math

import numpy as np

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.numerics.types import Array

BLOCKS: int = 8
"""Blocks of the recording between which amplitudes are compared."""


def block_scatter_ratio(fit: Fit) -> dict[str, float]:
    """How much each active effect's amplitude scatters between blocks of the recording, relative to itself.

    The recording is cut, in order of time, into blocks that know equally much about the amplitude; in each the
    amplitude is estimated anew with all else held. What the blocks want to add, beyond what noise alone makes them
    want, is compared with the amplitude (the largest of them where an effect has several).
    """
    scatter = block_scatter(fit)
    ratios: dict[str, float] = {}
    k = 0
    for active in fit.model.active:
        worst, largest = 0.0, max(abs(active.standardised_value(n)) for n in active.candidate.amplitudes)
        for name in active.free:
            if name in active.candidate.amplitudes and largest > 0.0:
                worst = max(worst, scatter[k] / largest)
            k += 1
        ratios[active.name] = float(worst)
    return ratios


def certainty(fit: Fit) -> dict[str, float]:
    """Each active effect's largest amplitude in standard deviations, disagreement between blocks included."""
    between = block_scatter(fit) ** 2 / BLOCKS
    spread = np.sqrt(np.diag(fit.covariance()) * max(fit.chi2_per_dof, 1.0) + between)
    sizes: dict[str, float] = {}
    for k, (active, name) in enumerate(fit.model.free):
        if name in active.candidate.amplitudes:
            size = abs(active.standardised_value(name)) / float(spread[k])
            sizes[active.name] = max(sizes.get(active.name, 0.0), size)
    return sizes


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
    blocks = BLOCKS
    edges = np.searchsorted(weight, weight[-1] * (np.arange(1, blocks + 1) / blocks - 1e-12))
    at = np.unique(np.minimum(edges, len(weight) - 1))
    w = np.diff(np.concatenate([[0.0], weight[at]]))
    p = np.diff(np.concatenate([[0.0], pull[at]]))
    known = w > 0.0
    beyond = float(np.mean((p[known] / w[known]) ** 2 - 1.0 / w[known]))
    return math.sqrt(max(beyond, 0.0))
