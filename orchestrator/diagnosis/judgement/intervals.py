"""How far a fitted effect may be off: its noise, what its segments disagree by, and what its form leaves out."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.types import Array
from protocols import ParameterRole, SegmentStage

INTERVAL_SIGMAS: float = 1.96
"""Standard deviations on either side of 95 % of a normal distribution."""
FORM_STD: float = 5e-4
"""Standard deviation of what any effect's form leaves out, as a part of the effect.

A knee of another shape than any in the family shifts an inverter's fitted voltage by some 0.01 to 0.1 %, which is
less than a user cares for and more than the noise of half a million samples.
"""
RIPPLE_FORM_STD: float = 0.02
"""The same where the ripple shows the effect and nothing at rest does.

What currents at rest show is measured by several stages; where the form is wrong they contradict each other, and
the segments' disagreement says so. The ripple has no second witness: it is one frequency, sampled some twenty
times a period. What a sampled form leaves out there is of order R_s Ts / L, half a percent to one, and the form's
course over frequency is carried on from that one to all others. Against a plant with forms of its own, effects
that the ripple shows come out 2 % off (rms, one in twenty by more than 4 %), however little the noise and however
near chi2 is to one.
"""


def standardised_std(fitter: Fitter, fit: Fit) -> Array:
    """Standard deviation of each free coordinate, shape (free,).

    The larger of the fit's own, inflated by chi2 per degree of freedom and with those flexible forms free that go
    either way, and of what the segments' disagreement makes of it (the sandwich estimate with segments as clusters,
    H. White, Econometrica 48 (1980), doi:10.2307/1912934); on top of it the scatter between blocks, and what the
    effect's form leaves out: `form_std` of it, `ripple_doubt` as far as the ripple alone tells it.
    """
    return np.asarray(np.sqrt(np.diag(_coordinate_covariance(fitter, fit))))


def _coordinate_covariance(fitter: Fitter, fit: Fit) -> Array:
    """Of all free coordinates: as wide as `standardised_std` says, and as alike as the fit has them."""
    rigid = [(a, n) for a in fit.model.active for n in _two_sided_refinements(a)]
    loose = fitter.evaluate(fit.model, fit.frame, rigid, known=fit)
    normal, _ = loose.projected()
    inverse = np.linalg.inv(normal + np.eye(len(normal)))
    count = len(fit.model.free)
    segments = projected_rows(loose)
    pulls = np.array([e @ rows for _, e, rows in segments])
    sandwich = inverse @ (pulls.T @ pulls) @ inverse * len(pulls) / max(len(pulls) - len(normal), 1)
    plain = np.diag(inverse) * max(fit.chi2_per_dof, 1.0)
    between = block_scatter(fit) ** 2 / BLOCKS
    form_error = form_std(fit, [(piece, rows @ inverse[:, :count]) for piece, _, rows in segments])
    wide = np.sqrt(np.maximum(plain, np.diag(sandwich))[:count] + between + form_error**2)
    narrow = np.sqrt(np.diag(inverse)[:count])
    return np.asarray(inverse[:count, :count] * np.outer(wide / narrow, wide / narrow))


def possibly_absent(fitter: Fitter, fit: Fit) -> list[str]:
    """Active effects of which each amplitude's 95 % interval holds nothing at all."""
    if not fit.model.free:
        return []
    variances, width = np.diag(_coordinate_covariance(fitter, fit)), INTERVAL_SIGMAS
    sure = {
        a.name
        for (a, n), variance in zip(fit.model.free, variances, strict=True)
        if n in a.candidate.amplitudes and a.standardised_value(n) ** 2 > width**2 * variance
    }
    return [name for name in fit.model.names if name not in sure]


def is_none_significant(fitter: Fitter, fit: Fit) -> bool:
    """Whether all amplitudes together may be nothing, at 95 %.

    Effects that stand in for each other may each be absent, and not all: A. Wald, Trans. Am. Math. Soc. 54 (1943),
    doi:10.1090/S0002-9947-1943-0012401-3.
    """
    from scipy.stats import chi2, norm

    amplitudes = [k for k, (a, n) in enumerate(fit.model.free) if n in a.candidate.amplitudes]
    if not amplitudes:
        return True
    x = np.array([a.standardised_value(n) for a, n in fit.model.free])[amplitudes]
    covariance = _coordinate_covariance(fitter, fit)[np.ix_(amplitudes, amplitudes)]
    least = chi2.isf(2.0 * norm.sf(INTERVAL_SIGMAS), len(amplitudes))
    return float(x @ np.linalg.solve(covariance, x)) <= float(least)


def form_std(fit: Fit, rows: Sequence[tuple[SegmentData, Array]]) -> Array:
    """What the effects' forms leave out, as a standard deviation of each free coordinate, shape (free,).

    Parameters
    ----------
    rows : sequence of (SegmentData, array)
        Of each training segment what it tells of each coordinate, shape (rows, free).
    """
    extent = np.array([_extent(a, n) for a, n in fit.model.free])
    return np.asarray(np.hypot(FORM_STD, RIPPLE_FORM_STD * ripple_share(rows)) * extent)


def _two_sided_refinements(active: EffectTerm) -> list[str]:
    """Refinements that are not free, but might lie on either side of where they are."""
    names = active.candidate.of_role(ParameterRole.REFINEMENT)
    return [n for n in names if n not in active.free and active.values[n] > active.candidate.named(n).low]


def projected_rows(fit: Fit) -> list[tuple[SegmentData, Array, Array]]:
    """Of each training segment: residual (rows,) and columns (rows, columns), R_s and the map following the columns."""
    width, count = fit.normal.shape[0], len(fit.parameters)
    cross = np.zeros((width, count))
    parts = list(zip(fit.prepared.pieces, fit.frame.pieces, fit.columns, fit.resistance, fit.residual, strict=True))
    parts = [part for part in parts if not part[0].held_out]
    for _, frame, d, r, _ in parts:
        cross[0] += r @ d
        cross[1:] += frame.white_basis.T @ d
    follow = np.linalg.solve(fit.normal, cross)
    return [(p, e, d - np.outer(r, follow[0]) - f.white_basis @ follow[1:]) for p, f, d, r, e in parts]


def ripple_share(rows: Sequence[tuple[SegmentData, Array]]) -> Array:
    """What the ripple tells of each column, over what it and the means at rest tell together; shape (columns,)."""
    ripple, rest = np.zeros(rows[0][1].shape[1]), np.zeros(rows[0][1].shape[1])
    for piece, columns in rows:
        known = np.sum(columns.reshape(-1, len(piece.windows.modes), 2, columns.shape[1]) ** 2, axis=(0, 2))
        ripple += known[1:].sum(axis=0)
        if piece.stage not in (SegmentStage.CLASSICAL, SegmentStage.STEPS):
            rest += known[0]
    return np.asarray(ripple / np.maximum(ripple + rest, np.finfo(np.float64).tiny))


def _extent(active: EffectTerm, name: str) -> float:
    """The coordinate of all that there is of a parameter; of a shape, which is never absent, of one e-fold."""
    p = active.candidate.named(name)
    return 1.0 / p.prior_width if p.role is ParameterRole.SHAPE else abs(active.standardised_value(name))


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
