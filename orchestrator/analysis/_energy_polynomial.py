"""Fit the paper's polynomial energy of the flux to inductances and swept flux jointly.

    H(x, y) = x^2 / 2 L_d + y^2 / 2 L_q + sum of alpha_mn x^m y^n,    x = psi_d - psi_M, y = psi_q, n even,

with alpha_30, alpha_12, alpha_40, alpha_22, alpha_04 (A. K. Jebai, P. Combes, F. Malrait, P. Martin, P. Rouchon,
"Energy-based modeling of electric motors", CDC 2014, doi:10.1109/CDC.2014.7040330) or another degree: that of the best
Bayesian information criterion among those whose H is convex over the measured currents. Newton's method gives the flux
at each current; a degree for which it fails is not used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from orchestrator.analysis._energy_fit import EnergyFit, neighbour_correlation
from orchestrator.analysis._flux_errors import directions, sizes, waves, whitening
from orchestrator.analysis._inductance_errors import GAIN_STD
from orchestrator.analysis._integration import PAIRS, TRIPLES, Inductances
from orchestrator.analysis._sweep import FluxPath
from orchestrator.numerics.frames import rotation
from orchestrator.numerics.types import Array
from protocols import NotMeasuredError

Term = tuple[int, int]
_State = tuple[Array, Array, Array, Array]

DEGREES = (2, 3, 4, 5, 6)
"""Degrees of the candidate polynomials."""


def terms_of(degree: int) -> tuple[Term, ...]:
    """Exponents (m, n) up to a degree, n even, by degree."""
    return tuple((k - n, n) for k in range(2, degree + 1) for n in range(0, k + 1, 2))


@dataclass(frozen=True)
class PolynomialFit:
    """The fitted polynomial.

    Attributes
    ----------
    terms : tuple of (int, int)
        Exponents (m, n) of x and y.
    coefficients, std : array, shape (k,)
        Coefficients of x^m y^n [A / Wb^(m + n - 1)]; the first two are 1/2L_d and 1/2L_q.
    covariance : array, shape (k, k)
    angle_rad : float
        Angle of the axis about which H is even, from the believed d axis.
    misfit_percent : float
        Residual of the inductances, rms, relative to their mean.
    misfit_wb : float
        Residual of the flux along the sweeps, rms; NaN without sweeps.
    criteria : dict
        Bayesian information criterion by degree, of the feasible degrees.
    """

    terms: tuple[Term, ...]
    coefficients: Array
    covariance: Array
    angle_rad: float
    misfit_percent: float
    misfit_wb: float
    criteria: dict[int, float]

    @property
    def degree(self) -> int:
        return max(m + n for m, n in self.terms)

    @property
    def std(self) -> Array:
        return np.sqrt(np.diag(self.covariance))

    def flux(self, at: Array) -> tuple[Array, Array]:
        """psi(i) - psi(0) and its standard deviation, shape (n, 2) each [Wb]; NaN where H cannot be inverted."""
        turn = rotation(self.angle_rad)
        model = _model(self.terms, self.coefficients, at @ turn)
        return model.psi @ turn.T, _spread(np.einsum("xa,nak->nxk", turn, model.psi_by), self.covariance)

    def inductance(self, at: Array) -> tuple[Array, Array]:
        """L_dd, L_dq, L_qq and their standard deviations, shape (n, 3) each [H]."""
        turn = rotation(self.angle_rad)
        model = _model(self.terms, self.coefficients, at @ turn)
        matrix = turn @ model.inductance @ turn.T
        by = np.einsum("xa,nabk,yb->nxyk", turn, model.inductance_by, turn)
        return _entries(matrix), _spread(_entries(by), self.covariance)


@dataclass(frozen=True)
class _Model:
    """Flux (n, 2) and inductance (n, 2, 2) at currents, and their derivatives by each coefficient (.., k)."""

    psi: Array
    inductance: Array
    psi_by: Array
    inductance_by: Array


def _entries(matrix: Array) -> Array:
    return np.stack([matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]], axis=1)


def _spread(rows: Array, covariance: Array) -> Array:
    variance: Array = np.einsum("nck,kl,ncl->nc", rows, covariance, rows)
    return np.sqrt(np.maximum(variance, 0.0))


def _powers(terms: Sequence[Term], psi: Array, order: int) -> Array:
    """Derivatives of one order of all terms, in falling order of x, shape (n, order + 1, k)."""
    out = np.zeros((len(psi), order + 1, len(terms)))
    x, y = _powers_of(psi, max(map(max, terms)))
    for t, (m, n) in enumerate(terms):
        for b in range(order + 1):
            a = order - b
            if a <= m and b <= n:
                out[:, b, t] = math.perm(m, a) * math.perm(n, b) * x[m - a] * y[n - b]
    return out


def _powers_of(psi: Array, highest: int) -> tuple[Array, Array]:
    """x^m and y^n for all exponents up to the highest, shape (highest + 1, n) each."""
    powers = np.ones((highest + 1, *psi.T.shape))
    for k in range(highest):
        np.multiply(powers[k], psi.T, out=powers[k + 1])
    return powers[:, 0], powers[:, 1]


class _Derivatives:
    """grad H and Hess H of one polynomial at many fluxes, for the steps of Newton's method."""

    def __init__(self, terms: Sequence[Term], coefficients: Array) -> None:
        self._highest = max(map(max, terms))
        side = self._highest + 1
        # Coefficients of x^i y^j in H_x, H_y, H_xx, H_xy, H_yy.
        self._of_powers = np.zeros((5, side, side))
        for (m, n), coefficient in zip(terms, coefficients.tolist(), strict=True):
            for table, (a, b) in zip(self._of_powers, ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2)), strict=True):
                if a <= m and b <= n:
                    table[m - a, n - b] += math.perm(m, a) * math.perm(n, b) * coefficient

    def gradient(self, psi: Array) -> Array:
        """H_x and H_y, shape (n, 2)."""
        return self._at(psi, slice(0, 2))

    def hessian(self, psi: Array) -> Array:
        """H_xx, H_xy, H_yy, shape (n, 3)."""
        return self._at(psi, slice(2, 5))

    def _at(self, psi: Array, which: slice) -> Array:
        x, y = _powers_of(psi, self._highest)
        out: Array = ((x.T @ self._of_powers[which]) * y.T).sum(axis=2).T
        return out


@np.errstate(over="ignore", invalid="ignore")  # a later check finds values that diverge
def _inverted(
    terms: Sequence[Term], coefficients: Array, current: Array, max_steps: int = 60, close: float = 1e-10
) -> Array:
    """psi with grad H(psi) = i, within `close` of the largest i, by damped Newton steps; NaN where there is none."""
    size = float(np.abs(current).max())
    unsaturated = 2.0 * coefficients[:2]
    derivatives = _Derivatives(terms, coefficients)
    psi = current / unsaturated
    off = current - derivatives.gradient(psi)
    for _ in range(max_steps):
        if np.abs(off).max() < close * size:
            break
        xx, xy, yy = derivatives.hessian(psi).T
        # Away from the solution H may be non-convex; the step is then that of the unsaturated motor.
        convex = (xx > 0.0) & (xx * yy > xy * xy)
        xx, xy, yy = np.where(convex, (xx, xy, yy), np.array([unsaturated[0], 0.0, unsaturated[1]])[:, None])
        step = np.stack([yy * off[:, 0] - xy * off[:, 1], xx * off[:, 1] - xy * off[:, 0]], axis=1)
        step /= (xx * yy - xy * xy)[:, None]
        share, far = np.ones((len(psi), 1)), np.linalg.norm(off, axis=1)
        new_off = current - derivatives.gradient(psi + step)
        for _ in range(8):
            worse = np.linalg.norm(new_off, axis=1) > far
            if not worse.any():
                break
            share[worse] *= 0.5
            new_off = current - derivatives.gradient(psi + share * step)
        psi, off = psi + share * step, new_off
    xx, xy, yy = derivatives.hessian(psi).T
    failed = ~(np.linalg.norm(off, axis=1) <= 1e-6 * size) | (xx * yy <= xy * xy) | (xx <= 0.0)
    psi[failed] = np.nan
    return psi


def _model(terms: Sequence[Term], coefficients: Array, current: Array) -> _Model:
    """Everything at given currents; d psi/d alpha = -L d(grad H)/d alpha with the current held."""
    psi = _inverted(terms, coefficients, current)
    second = _powers(terms, psi, 2)
    hessian = (second @ coefficients)[:, PAIRS]
    matrix = np.full_like(hessian, np.nan)
    valid = np.isfinite(psi).all(axis=1)
    matrix[valid] = np.linalg.inv(hessian[valid])
    psi_by = -matrix @ _powers(terms, psi, 1)
    third = (_powers(terms, psi, 3) @ coefficients)[:, TRIPLES]
    hessian_by = second[:, PAIRS] + third @ psi_by[:, None]
    # L (d Hess H) L, the coefficients before the rows and columns
    inductance_by = matrix[:, None] @ np.moveaxis(hessian_by, 3, 1) @ matrix[:, None]
    return _Model(psi, matrix, psi_by, -np.moveaxis(inductance_by, 1, 3))


def fit_polynomial(
    points: Inductances | None, paths: Sequence[FluxPath], energy: EnergyFit, where: str
) -> PolynomialFit:
    """Fit the polynomial; a spline energy of the same data gives the start, the axis and the effect of hysteresis.

    Parameters
    ----------
    points : Inductances or None
    paths : sequence of FluxPath
    energy : EnergyFit
    where : str
        Name of the recording, for errors.

    Raises
    ------
    NotMeasuredError
        Where no polynomial is convex over the measured currents.
    """
    data = _Data.of(points, paths, energy)
    candidates = [fit for degree in DEGREES if (fit := _fitted(data, terms_of(degree), energy)) is not None]
    if not candidates:
        raise NotMeasuredError(where, "segments", "no polynomial energy is convex over the measured currents")
    criteria = {fit.degree: criterion for fit, criterion in candidates}
    best = min(candidates, key=lambda candidate: candidate[1])
    significant = np.abs(best[0].coefficients) > 2.0 * best[0].std
    # The paper's terms up to degree four always stay, so that fits are comparable; others stay above two sigma.
    terms = tuple(t for t, clear in zip(best[0].terms, significant, strict=True) if clear or sum(t) <= 4)
    fewer = _fitted(data, terms, energy) if len(terms) < len(significant) else None
    if fewer is not None and fewer[1] < best[1]:
        best = fewer
    return replace(best[0], criteria=criteria)


@dataclass(frozen=True)
class _Data:
    """The data in the frame of the axis of symmetry: inductances and waves of flux, with their weights."""

    current: Array
    inductance: Array
    white: Array
    """Inverse roots of the inductances' covariances, (n, 3, 3)."""
    paths: tuple[FluxPath, ...]
    region: Array
    """Currents at which H has to be convex."""

    @staticmethod
    def of(points: Inductances | None, paths: Sequence[FluxPath], energy: EnergyFit) -> _Data:
        turn = rotation(energy.angle_rad)
        rotated = tuple(FluxPath(p.current @ turn, p.psi @ turn, np.sqrt(turn.T**2 @ p.std**2)) for p in paths)
        currents = np.concatenate([*([] if points is None else [points.current @ turn]), *(p.current for p in rotated)])
        region = currents[:: max(1, len(currents) // 400)]  # 400 points suffice to check convexity
        if points is None:
            return _Data(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 3, 3)), rotated, region)
        measured = points.matrix - energy.correction[:, PAIRS]
        softened = np.linalg.inv(np.linalg.inv(measured) - energy.stiffening_per_h * np.eye(2))
        matrix = turn.T @ softened @ turn
        mixing = _entries(np.einsum("ax,nxyk,yb->nabk", turn.T, _units(len(matrix)), turn))
        covariance = mixing @ points.covariance[:, :3, :3] @ mixing.transpose(0, 2, 1)
        # Polynomials describe iron to a thousandth at best.
        floor = (1e-3 * float(np.einsum("nii->n", matrix).mean()) / 2.0) ** 2
        root = np.linalg.cholesky(covariance + floor * np.eye(3))
        white = np.linalg.inv(root) * np.sqrt(energy.trust)[:, None, None]
        return _Data(points.current @ turn, _entries(matrix), white, rotated, region)

    @cached_property
    def _waves(self) -> list[Array]:
        return [waves(len(path.psi)) for path in self.paths]

    @cached_property
    def _directions(self) -> Array:
        return directions(self.paths)

    @cached_property
    def _size(self) -> Array:
        return sizes(self.paths)

    @cached_property
    def _whitener(self) -> Array:
        return whitening(self.paths)

    def residual(self, terms: Sequence[Term], coefficients: Array) -> _State | None:
        """Residuals and their rows of inductances (n, 3) and flux (p, 2 waves); None where H cannot be inverted."""
        model = _model(terms, coefficients, np.concatenate([self.current, *(p.current for p in self.paths)]))
        if not np.isfinite(model.psi).all():
            return None
        n, k = len(self.current), len(terms)
        off = np.einsum("nij,nj->ni", self.white, self.inductance - _entries(model.inductance[:n]))
        rows = self.white @ _entries(model.inductance_by[:n])
        if not self.paths:
            return off, rows, np.zeros((0, 1)), np.zeros((0, 1, k))
        size, whitener = self._size, self._whitener
        residuals, by, start = [], [], n
        for path, take, direction in zip(self.paths, self._waves, self._directions, strict=True):
            rows_of_path = slice(start, start := start + len(path.psi))
            residuals.append(direction @ (take @ (path.psi - model.psi[rows_of_path])).T)
            by.append(np.tensordot(direction, np.tensordot(take, model.psi_by[rows_of_path], (1, 0)), (1, 1)))
        flux = np.stack(residuals) / size
        effect = np.stack(by) / size[..., None]
        for values in (flux, effect):
            values[:, 0] = np.tensordot(whitener, values[:, 0], (1, 0))
        return off, rows, flux.reshape(len(self.paths), -1), effect.reshape(len(self.paths), -1, k)


def _units(count: int) -> Array:
    """Symmetric matrices with one entry each, (count, 2, 2, 3)."""
    one = np.zeros((2, 2, 3))
    one[0, 0, 0] = one[0, 1, 1] = one[1, 0, 1] = one[1, 1, 2] = 1.0
    return np.broadcast_to(one, (count, 2, 2, 3))


def _fitted(data: _Data, terms: tuple[Term, ...], energy: EnergyFit) -> tuple[PolynomialFit, float] | None:
    """Gauss-Newton fit from a regression on the spline energy's flux, and its information criterion."""
    coefficients = _start(data, terms, energy)
    state = data.residual(terms, coefficients)
    weights = (1.0, 1.0)
    for _ in range(4):  # the sizes of the errors converge by then
        if state is None:
            return None
        coefficients, state = _descended(data, terms, coefficients, state, weights)
        weights = _scales(state, len(terms))
    if state is None or not np.isfinite(_inverted(terms, coefficients, data.region)).all():
        return None
    rows, off = _weighted(state, weights)
    size = np.linalg.norm(rows, axis=0)
    covariance = np.linalg.pinv((rows / size).T @ (rows / size), hermitian=True) / np.outer(size, size)
    criterion = float(off @ off) + len(terms) * float(np.log(len(off)))
    criterion += 2.0 * float(state[0].size * np.log(weights[0]) + state[2].size * np.log(weights[1]))
    return _described(data, terms, coefficients, covariance, energy), criterion


def _descended(
    data: _Data,
    terms: tuple[Term, ...],
    coefficients: Array,
    state: _State,
    weights: tuple[float, float],
    max_steps: int = 25,
    min_reduction: float = 1e-6,
) -> tuple[Array, _State]:
    """Gauss-Newton iteration with step halving, until the sum of squares hardly falls."""
    for _ in range(max_steps):
        rows, off = _weighted(state, weights)
        size, squares = np.linalg.norm(rows, axis=0), float(off @ off)
        step = np.linalg.lstsq(rows / size, off, rcond=1e-13)[0] / size
        for share in 0.5 ** np.arange(8):
            trial = coefficients + share * step
            trial_state = data.residual(terms, trial) if (trial[:2] > 0.0).all() else None
            if trial_state is not None and float(np.square(_weighted(trial_state, weights)[1]).sum()) < squares:
                coefficients, state = trial, trial_state
                break
        else:
            break
        if squares - float(np.square(_weighted(state, weights)[1]).sum()) < min_reduction * squares:
            break
    return coefficients, state


def _start(data: _Data, terms: tuple[Term, ...], energy: EnergyFit) -> Array:
    """Regression of i = grad H(psi), which is linear in the coefficients for known psi."""
    at = data.region
    turn = rotation(energy.angle_rad)
    psi = energy.flux(at @ turn.T)[0] @ turn
    rows = _powers(terms, psi, 1).reshape(-1, len(terms))
    size = np.linalg.norm(rows, axis=0)
    return np.asarray(np.linalg.lstsq(rows / size, at.ravel(), rcond=1e-10)[0] / size)


def _weighted(state: _State, weights: tuple[float, float]) -> tuple[Array, Array]:
    off, rows, flux, by = state
    k = rows.shape[2]
    return (
        np.concatenate([rows.reshape(-1, k) / weights[0], by.reshape(-1, k) / weights[1]]),
        np.concatenate([off.ravel() / weights[0], flux.ravel() / weights[1]]),
    )


def _scales(state: _State, terms: int) -> tuple[float, float]:
    """Ratios of the residuals to their stated errors, by kind."""
    out = []
    for off in (state[0], state[2]):
        free = max(off.size - terms / 2.0, 0.2 * off.size, 1.0)
        out.append(max(float(np.sqrt((off**2).sum() / free)), 1.0))
    return out[0], out[1]


def _described(
    data: _Data, terms: tuple[Term, ...], coefficients: Array, covariance: Array, energy: EnergyFit
) -> PolynomialFit:
    misfit = flux_misfit = float("nan")
    correlation = 0.0
    if len(data.current):
        model = _model(terms, coefficients, data.current)
        off = data.inductance - _entries(model.inductance)
        mean = float(data.inductance[:, [0, 2]].mean())
        misfit = 100.0 * float(np.sqrt((off**2).mean())) / mean
        correlation = neighbour_correlation(data.current, np.einsum("nij,nj->ni", data.white, off))
    if data.paths:
        residuals = []
        for path in data.paths:
            off_wb = path.psi - _model(terms, coefficients, path.current).psi
            residuals.append(off_wb - off_wb.mean(axis=0))
        flux_misfit = float(np.sqrt((np.concatenate(residuals) ** 2).sum(axis=1).mean()))
    significant = np.clip(correlation - 2.0 / np.sqrt(max(3 * len(data.current), 4)), 0.0, 0.95)
    # A gain common to all inductances is a gain of the flux.
    gain = GAIN_STD * coefficients * np.array([m + n - 1.0 for m, n in terms])
    widened = covariance * ((1.0 + significant) / (1.0 - significant)) + np.outer(gain, gain)
    return PolynomialFit(terms, coefficients, widened, energy.angle_rad, misfit, flux_misfit, {})
