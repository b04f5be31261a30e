"""Robust centre and scatter of multivariate data with up to nearly half of outliers.

The minimum covariance determinant: of all halves of the rows the one whose covariance has the least determinant, found
by concentration steps from random starts (FAST-MCD, Rousseeuw and Van Driessen 1999,
doi:10.1080/00401706.1999.10485670), scaled so that the median distance is a normal sample's, then reweighted once.
Distances are invariant under linear maps of the data. Those of clean rows are F distributed: from the raw half (Hardin
and Rocke 2005, doi:10.1198/106186005X77685), and after reweighting (Cerioli 2010, doi:10.1198/jasa.2009.tm09147).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array, Mask


@dataclass(frozen=True)
class Concentration:
    """Settings of the search for the half of least determinant.

    Attributes
    ----------
    starts, kept : int
        Random starts of two steps each, and the number of best ones to finish: 500 and 10 in the paper.
    max_rows : int
        Limit of rows for the starts, which use a random part of more; the best finish on all rows.
    max_steps : int
        Limit of steps.
    inlier : float
        Probability within which a row counts in the reweighting.
    seed : int
        Seed of the starts: the same data give the same result.
    """

    starts: int = 500
    kept: int = 10
    max_rows: int = 600
    max_steps: int = 100
    inlier: float = 0.975
    seed: int = 1999


@dataclass(frozen=True)
class Scatter:
    """Centre and covariance of the inlying rows.

    Attributes
    ----------
    middle : array, shape (p,)
    covariance : array, shape (p, p)
    counted : array of bool, shape (n,)
        The rows of the estimate.
    """

    middle: Array
    covariance: Array
    counted: Mask

    def squares(self, rows: Array) -> Array:
        """Squared distances of rows (m, p); for rows with NaN, the marginal distance of the others."""
        out = np.full(len(rows), np.nan)
        known = np.isfinite(rows)
        for pattern in np.unique(known, axis=0):
            if pattern.any():
                has_pattern = (known == pattern).all(axis=1)
                part = self.covariance[np.ix_(pattern, pattern)]
                out[has_pattern] = _squares(rows[has_pattern][:, pattern], self.middle[pattern], part)
        return out

    def parts(self, row: Array) -> Array:
        """A row's squared distance divided among its coordinates; zero where it is NaN.

        By the linear map that makes them uncorrelated and of unit variance while each stays as correlated with itself
        as can be (Garthwaite and Koch 2016, doi:10.1111/anzs.12144).
        """
        known = np.isfinite(row)
        spread = np.sqrt(np.diag(self.covariance)[known])
        correlation = self.covariance[np.ix_(known, known)] / np.outer(spread, spread)
        values, vectors = np.linalg.eigh(correlation)
        whitened = (vectors / np.sqrt(values)) @ (vectors.T @ ((row - self.middle)[known] / spread))
        out = np.zeros(len(row))
        out[known] = whitened**2
        return out

    def limits(self, level: float, coordinates: Array) -> Array:
        """Squared distance that a clean row with so many coordinates exceeds with this probability.

        The (1 - level) quantile of (w + 1)(w - 1) p / (w (w - p)) F(p, w - p), w being the number of rows counted.
        """
        from scipy.stats import f

        counted = int(self.counted.sum())
        p = np.asarray(coordinates, dtype=np.float64)
        scale = (counted + 1.0) * (counted - 1.0) * p / (counted * (counted - p))
        return np.asarray(scale * f.isf(level, p, counted - p), dtype=np.float64)


def robust_scatter(rows: Array, settings: Concentration | None = None) -> Scatter:
    """The reweighted minimum covariance determinant of rows (n, p) without gaps.

    Raises
    ------
    numpy.linalg.LinAlgError
        Where half of the rows lie in a plane of fewer dimensions, or are no more than these.
    """
    settings = settings or Concentration()
    count, size = rows.shape
    half = (count + size + 1) // 2
    if count <= 2 * size:
        raise np.linalg.LinAlgError(f"{count} rows are too few for {size} coordinates")
    unit = _units(rows)
    scaled = (rows - np.median(rows, axis=0)) / unit
    middle, covariance = _concentrated(scaled, half, settings)
    squares = _squares(scaled, middle, covariance)
    covariance = covariance * (np.median(squares) / _chi2_quantile(0.5, size))
    counted = _squares(scaled, middle, covariance) <= _raw_limit(1.0 - settings.inlier, count, size, half)
    middle, covariance = _moments(scaled[counted])
    covariance = covariance * _truncated(settings.inlier, size)
    back = np.median(rows, axis=0) + unit * middle
    return Scatter(back, covariance * np.outer(unit, unit), counted)


def _concentrated(rows: Array, half: int, settings: Concentration) -> tuple[Array, Array]:
    """Mean and covariance of the half of least determinant."""
    rng = np.random.default_rng(settings.seed)
    count, size = rows.shape
    part = rows
    if count > settings.max_rows:
        part = rows[rng.choice(count, settings.max_rows, replace=False)]
    part_half = max(size + 1, round(half * len(part) / count))
    found = _starts(part, part_half, settings.starts, rng)
    for _ in range(2):
        found = _step(part, found, part_half)
    best = np.argsort(_log_determinants(found[1]), kind="stable")[: settings.kept]
    found = (found[0][best], found[1][best])
    last = np.full(len(best), np.inf)
    for _ in range(settings.max_steps):
        found = _step(rows, found, half)
        now = _log_determinants(found[1])
        if not (now < last).any():
            break
        last = now
    smallest = int(np.argmin(_log_determinants(found[1])))
    middle, covariance = found[0][smallest], found[1][smallest]
    if not np.isfinite(_log_determinants(covariance)):
        raise np.linalg.LinAlgError("half of the rows lie in one plane")
    return middle, covariance


def _starts(rows: Array, half: int, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Means and covariances of as few random rows as have one, of a random half where these lie in a plane."""
    order = np.argsort(rng.random((count, len(rows))), axis=1)
    middles, covariances = _moments(rows[order[:, : rows.shape[1] + 1]])
    flat = ~np.isfinite(_log_determinants(covariances))
    middles[flat], covariances[flat] = _moments(rows[order[flat, :half]])
    return middles, covariances


def _step(rows: Array, found: tuple[Array, Array], half: int) -> tuple[Array, Array]:
    """Means and covariances of the nearest half of each: their determinants are never larger."""
    middles, covariances = found[0].copy(), found[1].copy()
    whole = np.isfinite(_log_determinants(covariances))
    squares = _squares(rows, middles[whole], covariances[whole])
    nearest = np.argpartition(squares, half - 1, axis=-1)[:, :half]
    middles[whole], covariances[whole] = _moments(rows[nearest])
    return middles, covariances


def _moments(rows: Array) -> tuple[Array, Array]:
    """Means (..., p) and covariances (..., p, p) of rows (..., n, p)."""
    middle = rows.mean(axis=-2)
    off = rows - middle[..., None, :]
    return middle, np.swapaxes(off, -1, -2) @ off / (rows.shape[-2] - 1)


def _log_determinants(covariances: Array) -> Array:
    """Log determinants of rows scaled near one; -inf for rows in a plane, inf where extreme rows hide that."""
    values = np.linalg.eigvalsh(covariances)
    rounding = np.finfo(np.float64).eps ** 0.75
    whole = values[..., 0] > rounding * values[..., -1]
    beyond = np.where(values[..., -1] > 1.0 / np.sqrt(rounding), np.inf, -np.inf)
    return np.where(whole, np.log(np.where(whole[..., None], values, 1.0)).sum(axis=-1), beyond)


def _squares(rows: Array, middles: Array, covariances: Array) -> Array:
    """Squared distances (..., n) of rows (n, p) from middles (..., p)."""
    off = rows - middles[..., None, :]
    solved = np.linalg.solve(covariances, np.swapaxes(off, -1, -2))
    return np.asarray(np.einsum("...ij,...ji->...i", off, solved), dtype=np.float64)


def _units(rows: Array) -> Array:
    """A scale of each coordinate against rounding."""
    spread = np.median(np.abs(rows - np.median(rows, axis=0)), axis=0)
    spread = np.where(spread > 0.0, spread, np.std(rows, axis=0))
    return np.where(spread > 0.0, spread, 1.0)


def _chi2_quantile(probability: float, size: int) -> float:
    from scipy.stats import chi2

    return float(chi2.ppf(probability, size))


def _raw_limit(level: float, count: int, size: int, half: int) -> float:
    """Squared distance from the raw half that a clean row exceeds with this probability.

    p m / (m - p + 1) F(p, m - p + 1); the degrees of freedom m of the half's covariance are those of Croux and
    Haesbroeck (1999, doi:10.1006/jmva.1999.1839) for large samples; Hardin and Rocke's interpolation for small ones.
    """
    from scipy.stats import chi2, f

    share = half / count
    edge = chi2.ppf(share, size)
    second, fourth = -0.5 * chi2.cdf(edge, size + 2), -0.5 * chi2.cdf(edge, size + 4)
    scale = -0.5 * share / second
    b1 = scale * -2.0 * fourth / share
    b2 = 0.5 + scale / share * (fourth - edge / size * (second + 0.5 * share))
    v1 = share * b1**2 * ((1.0 - share) * (scale * edge / size - 1.0) ** 2 - 1.0)
    v1 -= 2.0 * fourth * scale**2 * (3.0 * (b1 - size * b2) ** 2 + (size + 2.0) * b2 * (2.0 * b1 - size * b2))
    v2 = count * (b1 * (b1 - size * b2) * share) ** 2 * scale**2
    freedom = 2.0 * v2 / (scale**2 * v1) * np.exp(0.725 - 0.00663 * size - 0.0780 * np.log(count))
    return float(size * freedom / (freedom - size + 1.0) * f.isf(level, size, freedom - size + 1.0))


def _truncated(share: float, size: int) -> float:
    """Correction of a covariance of the nearest `share` of a normal sample (Croux and Haesbroeck 1999)."""
    from scipy.stats import chi2

    return float(share / chi2.cdf(chi2.ppf(share, size), size + 2))
