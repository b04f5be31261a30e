"""Uncertainty of fitted effects: noise, disagreement between segments, and error of the effect's form."""

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
"""Half width of a normal distribution's 95 % interval, in standard deviations."""
FORM_STD: float = 5e-4
"""Standard deviation of the error of any effect's form, relative to the effect.

A knee of a shape outside the model's family shifts an inverter's fitted voltage by 0.01 to 0.1 %: immaterial, but more
than the noise of half a million samples.
"""
SIZE_STD: float = 5e-3
"""Standard deviation of a stated size by its effect's form, relative to the size.

A size sums up a curve that has another shape in a plant. On a plant of other forms sizes of knees, with chi2 near one,
were off by 0.3 to 0.9 %, most of them too large; the curves themselves, and the map beside them, were not.
"""
RIPPLE_FORM_STD: float = 0.02
"""The same for an effect that only the ripple shows.

Constant currents are measured in several stages, which contradict each other where a form is wrong. The ripple has one
frequency, sampled about twenty times a period: a sampled form's error is of order R_s Ts / L, 0.5 to 1 %, and its
frequency dependence is extrapolated. On a plant with different forms, effects shown by the ripple were off by 2 % (rms;
one in twenty by more than 4 %), for any noise and with chi2 near one.
"""


def standardised_std(fitter: Fitter, fit: Fit) -> Array:
    """Standard deviation of each standardised free parameter, shape (free,).

    The larger of the fit's, inflated by chi2 per degree of freedom and with two-sided refinements free, and of the
    sandwich estimate with segments as clusters (H. White, Econometrica 48 (1980), doi:10.2307/1912934); the scatter
    between blocks, `form_std` and, of amplitudes, `SIZE_STD` are added in quadrature.
    """
    return np.asarray(np.sqrt(np.diag(standardised_covariance(fitter, fit))))


def standardised_covariance(fitter: Fitter, fit: Fit, *, with_block_scatter: bool = True) -> Array:
    """Covariance of the free coordinates with the widths of `standardised_std` and the fit's correlations."""
    rigid = [(a, n) for a in fit.model.active for n in _two_sided_refinements(a)]
    loose = fitter.evaluate(fit.model, fit.linearisation, rigid, known=fit)
    normal, _ = loose.projected()
    inverse = np.linalg.inv(normal + np.eye(len(normal)))
    count = len(fit.model.free)
    segments = projected_rows(loose)
    pulls = np.array([e @ rows for _, e, rows in segments])
    sandwich = inverse @ (pulls.T @ pulls) @ inverse * len(pulls) / max(len(pulls) - len(normal), 1)
    plain = np.diag(inverse) * max(fit.chi2_per_dof, 1.0)
    between = block_scatter(fit) ** 2 / BLOCKS if with_block_scatter else 0.0
    form_error = form_std(fit, [(piece, rows @ inverse[:, :count]) for piece, _, rows in segments])
    size_error = SIZE_STD * np.array([_extent(a, n) if n in a.candidate.amplitudes else 0.0 for a, n in fit.model.free])
    wide = np.sqrt(np.maximum(plain, np.diag(sandwich))[:count] + between + form_error**2 + size_error**2)
    narrow = np.sqrt(np.diag(inverse)[:count])
    return np.asarray(inverse[:count, :count] * np.outer(wide / narrow, wide / narrow))


def possibly_absent(fitter: Fitter, fit: Fit) -> list[str]:
    """Active effects for which every amplitude's 95 % interval contains neutral.

    The scatter between blocks is not in these intervals: an effect of another form has another size in each block, and
    is there all the same.
    """
    if not fit.model.free:
        return []
    variances, width = np.diag(standardised_covariance(fitter, fit, with_block_scatter=False)), INTERVAL_SIGMAS
    significant = {
        a.name
        for (a, n), variance in zip(fit.model.free, variances, strict=True)
        if n in a.candidate.amplitudes and a.standardised_value(n) ** 2 > width**2 * variance
    }
    return [name for name in fit.model.names if name not in significant]


def is_none_significant(fitter: Fitter, fit: Fit) -> bool:
    """Whether all amplitudes may be neutral at once, at 95 %.

    Of confounded effects each may be absent, but not all: A. Wald, Trans. Am. Math. Soc. 54 (1943),
    doi:10.1090/S0002-9947-1943-0012401-3.
    """
    from scipy.stats import chi2, norm

    amplitudes = [k for k, (a, n) in enumerate(fit.model.free) if n in a.candidate.amplitudes]
    if not amplitudes:
        return True
    x = np.array([a.standardised_value(n) for a, n in fit.model.free])[amplitudes]
    covariance = standardised_covariance(fitter, fit)[np.ix_(amplitudes, amplitudes)]
    threshold = chi2.isf(2.0 * norm.sf(INTERVAL_SIGMAS), len(amplitudes))
    return float(x @ np.linalg.solve(covariance, x)) <= float(threshold)


def form_std(fit: Fit, rows: Sequence[tuple[SegmentData, Array]]) -> Array:
    """Error of the effects' forms as a standard deviation of each free coordinate, shape (free,).

    Parameters
    ----------
    rows : sequence of (SegmentData, array)
        For each training segment its projected columns, shape (rows, free).
    """
    extent = np.array([_extent(a, n) for a, n in fit.model.free])
    # No form is known less than before the recording: a line's frequency has a prior far narrower than a form's error.
    relative = np.hypot(FORM_STD, RIPPLE_FORM_STD * ripple_share(rows))
    return np.asarray(np.minimum(relative * extent, 1.0), dtype=np.float64)


def _two_sided_refinements(active: EffectTerm) -> list[str]:
    """Fixed refinements above their lower bound, which may be wrong in both directions."""
    names = active.candidate.of_role(ParameterRole.REFINEMENT)
    return [n for n in names if n not in active.free and active.values[n] > active.candidate.named(n).low]


def projected_rows(fit: Fit) -> list[tuple[SegmentData, Array, Array]]:
    """For each training segment: residual (rows,) and columns (rows, columns), with R_s and the map eliminated."""
    parts = list(fit.training())
    follow = np.linalg.solve(fit.normal, sum(linear.T @ d for linear, d, _ in parts))
    pieces = [piece for piece in fit.prepared.pieces if not piece.held_out]
    return [(piece, e, d - linear @ follow) for piece, (linear, d, e) in zip(pieces, parts, strict=True)]


def ripple_share(rows: Sequence[tuple[SegmentData, Array]]) -> Array:
    """Information of the ripple on each column over that of ripple and means together, shape (columns,)."""
    ripple, rest = np.zeros(rows[0][1].shape[1]), np.zeros(rows[0][1].shape[1])
    for piece, columns in rows:
        known = np.sum(columns.reshape(-1, len(piece.windows.modes), 2, columns.shape[1]) ** 2, axis=(0, 2))
        ripple += known[1:].sum(axis=0)
        if piece.stage not in (SegmentStage.CLASSICAL, SegmentStage.STEPS):
            rest += known[0]
    return np.asarray(ripple / np.maximum(ripple + rest, np.finfo(np.float64).tiny))


def _extent(active: EffectTerm, name: str) -> float:
    """Size of a parameter as a standardised value; for a shape, which is never absent, that of one e-fold."""
    p = active.candidate.named(name)
    return 1.0 / p.prior_width if p.role is ParameterRole.SHAPE else abs(active.standardised_value(name))


BLOCKS: int = 8
"""Blocks of the recording between which amplitudes are compared."""


def block_scatter_ratio(fit: Fit) -> dict[str, float]:
    """Scatter of each active effect's amplitude between blocks of the recording, relative to the amplitude.

    The recording is cut, in temporal order, into blocks with equal information on the amplitude, which is re-estimated
    in each with all else fixed. The scatter beyond noise is divided by the amplitude; the largest ratio counts.
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
    """Each active effect's largest amplitude in standard deviations, including the scatter between blocks."""
    between = block_scatter(fit) ** 2 / BLOCKS
    spread = np.sqrt(np.diag(fit.covariance()) * max(fit.chi2_per_dof, 1.0) + between)
    sizes: dict[str, float] = {}
    for k, (active, name) in enumerate(fit.model.free):
        if name in active.candidate.amplitudes:
            size = abs(active.standardised_value(name)) / float(spread[k])
            sizes[active.name] = max(sizes.get(active.name, 0.0), size)
    return sizes


def block_scatter(fit: Fit) -> Array:
    """rms change of each free coordinate between blocks beyond noise, shape (free,)."""
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
    # Weighted by information: the last block may have nearly none, so that its own estimate is arbitrary.
    beyond = float(np.sum(p[known] ** 2 / w[known] - 1.0) / w.sum())
    return math.sqrt(max(beyond, 0.0))
