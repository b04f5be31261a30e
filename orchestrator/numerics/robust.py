"""Robust medians, spreads, shifts and slopes with their intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Thinning:
    """Limit of sample sizes for estimators that use all pairs.

    Attributes
    ----------
    max_values : int
        Size to which a sample is reduced, by quantiles for shifts and by medians of neighbours for slopes.
    """

    max_values: int = 1200


@dataclass(frozen=True)
class Estimate:
    """A number, its 95 % interval, and the probability of one so far from zero by chance alone (two-sided)."""

    value: float
    low: float
    high: float
    chance: float


def spread(values: Array) -> float:
    """1.4826 times the median distance from the median: a normal sample's standard deviation."""
    return float(np.median(np.abs(values - np.median(values))) / _quartile())


def shift(values: Array, others: Array, thinning: Thinning | None = None) -> Estimate:
    """Shift of values (n,) against others (m,): the median of all differences, with Moses' interval.

    Hodges and Lehmann 1963, doi:10.1214/aoms/1177704172; the chance is Mann and Whitney's.
    """
    from scipy.stats import mannwhitneyu

    limit = (thinning or Thinning()).max_values
    chance = float(mannwhitneyu(values, others, method="asymptotic").pvalue)
    n, m = len(values), len(others)
    differences = np.sort(np.subtract.outer(_quantiles(values, limit), _quantiles(others, limit)).ravel())
    # The rank among n m differences, as a share of the differences formed.
    edge = 0.5 * n * m - _two_sigma() * np.sqrt(n * m * (n + m + 1) / 12.0)
    return Estimate(float(np.median(differences)), *_ends(differences, edge / (n * m)), chance)


def paired_shift(differences: Array, thinning: Thinning | None = None) -> Estimate:
    """The middle of differences (n,): the median of the means of all pairs, with Tukey's interval.

    Hodges and Lehmann 1963, doi:10.1214/aoms/1177704172; the chance is Wilcoxon's.
    """
    from scipy.stats import wilcoxon

    n = len(differences)
    chance = float(wilcoxon(differences).pvalue) if np.any(differences) else 1.0
    part = _quantiles(differences, (thinning or Thinning()).max_values)
    first, second = np.triu_indices(len(part))
    means = np.sort(0.5 * (part[first] + part[second]))
    pairs = 0.5 * n * (n + 1)
    edge = 0.5 * pairs - _two_sigma() * np.sqrt(n * (n + 1) * (2 * n + 1) / 24.0)
    return Estimate(float(np.median(means)), *_ends(means, edge / pairs), chance)


def slope(x: Array, y: Array, thinning: Thinning | None = None) -> Estimate:
    """Rise of y per unit of x: the median of the slopes of all pairs, with its interval.

    Theil 1950 and Sen 1968, doi:10.1080/01621459.1968.10480934; the chance is Kendall's. Of many values the medians of
    neighbours in x are taken.
    """
    from scipy.stats import kendalltau, theilslopes

    chance = float(kendalltau(x, y).pvalue)
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    limit = (thinning or Thinning()).max_values
    if len(x) > limit:
        groups = np.array_split(np.arange(len(x)), limit)
        x, y = (np.array([np.median(z[g]) for g in groups]) for z in (x, y))
    result = theilslopes(y, x, alpha=0.95)
    return Estimate(float(result.slope), float(result.low_slope), float(result.high_slope), chance)


def holm(chances: Array) -> Array:
    """Probabilities adjusted for multiple tests (Holm 1979, https://www.jstor.org/stable/4615733); NaN are skipped."""
    out = np.full(len(chances), np.nan)
    known = np.flatnonzero(np.isfinite(chances))
    order = known[np.argsort(chances[known])]
    adjusted = chances[order] * np.arange(len(order), 0, -1)
    out[order] = np.minimum(np.maximum.accumulate(adjusted), 1.0)
    return out


def _ends(ordered: Array, share: float) -> tuple[float, float]:
    """The values that leave out this share of an ordered sample at both ends; its extremes where that is none."""
    rank = min(max(int(np.floor(share * len(ordered))), 0), (len(ordered) - 1) // 2)
    return float(ordered[rank]), float(ordered[-1 - rank])


def _quantiles(values: Array, count: int) -> Array:
    """The values, or so many of their quantiles."""
    if len(values) <= count:
        return values
    return np.quantile(values, (np.arange(count) + 0.5) / count)


def _two_sigma() -> float:
    from scipy.stats import norm

    return float(norm.ppf(0.975))


def _quartile() -> float:
    from scipy.stats import norm

    return float(norm.ppf(0.75))
