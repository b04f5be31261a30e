"""How far a fitted effect is to be trusted: whether its size is the same all through, and how far off it may be.

An effect that is only a stand-in for another drifts. Nothing is named or dropped here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orchestrator.diagnosis.fitting.candidates import Active
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.weak_form.segments import Piece
from orchestrator.numerics.types import Array
from protocols import ParameterRole, SegmentStage


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
    between = block_scatter(fit) ** 2 / fit.criteria.uncertainty.blocks
    spread = np.sqrt(np.diag(fit.covariance()) * max(fit.chi2_per_dof, 1.0) + between)
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
    H. White, Econometrica 48 (1980), doi:10.2307/1912934); on top of it the scatter between blocks, and what the
    effect's form leaves out: `form_doubt` of it, `ripple_doubt` as far as the ripple alone tells it.
    """
    rigid = [(a, n) for a in fit.model.active for n in _yielding(a)]
    loose = fitter.evaluate(fit.model, fit.frame, rigid)
    own, _ = loose.projected()
    inverse = np.linalg.inv(own + np.eye(len(own)))
    count = len(fit.model.free)
    segments = following(loose)
    pulls = np.array([e @ rows for _, e, rows in segments])
    sandwich = inverse @ (pulls.T @ pulls) @ inverse * len(pulls) / max(len(pulls) - len(own), 1)
    plain = np.diag(inverse) * max(fit.chi2_per_dof, 1.0)
    share = ripple_share([(piece, rows @ inverse[:, :count]) for piece, _, rows in segments])
    criteria = fit.criteria.uncertainty
    extent = np.array([_extent(a, n) for a, n in fit.model.free])
    doubt = np.hypot(criteria.form_doubt, criteria.ripple_doubt * share) * extent
    variance = np.maximum(plain, np.diag(sandwich))[:count] + block_scatter(fit) ** 2 / criteria.blocks + doubt**2
    return np.asarray(np.sqrt(variance))


def _yielding(active: Active) -> list[str]:
    """Refinements that are not free, but might lie on either side of where they are."""
    names = active.candidate.of_role(ParameterRole.REFINEMENT)
    return [n for n in names if n not in active.free and active.values[n] > active.candidate.named(n).low]


def following(fit: Fit) -> list[tuple[Piece, Array, Array]]:
    """Of each training segment: residual (rows,) and columns (rows, columns), R_s and the map following the columns."""
    width, count = fit.normal.shape[0], fit.columns[0].shape[1]
    cross = np.zeros((width, count))
    parts = list(zip(fit.prepared.pieces, fit.frame.pieces, fit.columns, fit.resistance, fit.residual, strict=True))
    parts = [part for part in parts if not part[0].held_out]
    for _, frame, d, r, _ in parts:
        cross[0] += r @ d
        cross[1:] += frame.white_basis.T @ d
    follow = np.linalg.solve(fit.normal, cross)
    return [(p, e, d - np.outer(r, follow[0]) - f.white_basis @ follow[1:]) for p, f, d, r, e in parts]


def ripple_share(rows: Sequence[tuple[Piece, Array]]) -> Array:
    """What the ripple tells of each column, over what it and the means at rest tell together; shape (columns,)."""
    ripple, rest = np.zeros(rows[0][1].shape[1]), np.zeros(rows[0][1].shape[1])
    for piece, columns in rows:
        known = np.sum(columns.reshape(-1, len(piece.windows.carriers), 2, columns.shape[1]) ** 2, axis=(0, 2))
        ripple += known[1:].sum(axis=0)
        if piece.stage is not SegmentStage.CLASSICAL:
            rest += known[0]
    return np.asarray(ripple / np.maximum(ripple + rest, np.finfo(np.float64).tiny))


def _extent(active: Active, name: str) -> float:
    """The coordinate of all that there is of a parameter; of a shape, which is never absent, of one e-fold."""
    p = active.candidate.named(name)
    return 1.0 / p.prior_width if p.role is ParameterRole.SHAPE else abs(active.coordinate(name))


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
    blocks = fit.criteria.uncertainty.blocks
    edges = np.searchsorted(weight, weight[-1] * (np.arange(1, blocks + 1) / blocks - 1e-12))
    at = np.unique(np.minimum(edges, len(weight) - 1))
    w = np.diff(np.concatenate([[0.0], weight[at]]))
    p = np.diff(np.concatenate([[0.0], pull[at]]))
    known = w > 0.0
    beyond = float(np.mean((p[known] / w[known]) ** 2 - 1.0 / w[known]))
    return math.sqrt(max(beyond, 0.0))
