"""One co-energy for all that was measured: psi = grad W(i), L = Hess W(i), so that both agree and are reciprocal.

W is a tensor spline, even in i_q in the rotor's frame, which may be turned by a small angle from the believed one.
Inductances with their slopes and the flux along swept paths are fitted together, each weighted by its own errors,
whose sizes are estimated as well. How smooth W is the data say: the roughness' weight is that of the largest
marginal likelihood (G. Wahba, "Spline Models for Observational Data", SIAM 1990, doi:10.1137/1.9781611970128,
section 4.8); the posterior covariance then holds the error of interpolating between points, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from orchestrator.analysis._integration import Inductances
from orchestrator.analysis._sweep import FluxPath
from orchestrator.analysis._tensor_spline import EvenSpline

Array = NDArray[np.float64]

_CELLS = 12
_THINNED = 4  # every so-manieth point of a path
_ALIKE = 20.0  # so many of these, of neighbouring paths too, err alike
_ROUNDS = 4  # of smoothness and sizes of the errors in turn
_PERFECT = 1e-4  # of the inductances: better than any measurement
_MARGIN = 0.06  # of the spline's rectangle round the currents, relative to their range


@dataclass(frozen=True)
class EnergyFit:
    """The co-energy found.

    Attributes
    ----------
    spline : EvenSpline
    angle_rad : float
        Of the axis about which W is even, from the believed d axis.
    coefficients : array, shape (k,)
    covariance : array, shape (k, k)
    scales : array, shape (3,)
        How much larger the scatter of inductances, of their slopes and of the flux is than their stated errors.
    stiffening_per_h : float
        What hysteresis added to the Hessian that the ripple saw [1/H]; taken out.
    correlation : float
        Of neighbouring inductances' residuals; near zero where nothing is left to be explained.
    """

    spline: EvenSpline
    angle_rad: float
    coefficients: Array
    covariance: Array
    scales: Array
    stiffening_per_h: float
    correlation: float

    def flux(self, at: Array) -> tuple[Array, Array]:
        """psi(i) - psi(0) and its standard deviation, shape (n, 2) each [Wb]."""
        rows = _rows(self.spline, at, self.angle_rad, 1) - _rows(self.spline, np.zeros((1, 2)), self.angle_rad, 1)
        return self._evaluated(rows)

    def inductance(self, at: Array) -> tuple[Array, Array]:
        """L_dd, L_dq, L_qq and their standard deviations, shape (n, 3) each [H]."""
        return self._evaluated(_rows(self.spline, at, self.angle_rad, 2))

    def _evaluated(self, rows: Array) -> tuple[Array, Array]:
        variance = np.einsum("nck,nck->nc", rows @ self.covariance, rows)
        return rows @ self.coefficients, np.sqrt(np.maximum(variance, 0.0))


def _rows(spline: EvenSpline, at: Array, angle: float, order: int) -> Array:
    """All derivatives of one order in the believed frame, those of more d first; shape (n, order + 1, size)."""
    c, s = np.cos(angle), np.sin(angle)
    turned = at @ np.array([[c, -s], [s, c]])
    own = np.stack([spline.rows(turned, order - k, k) for k in range(order + 1)], axis=1)
    mixing = np.zeros((order + 1, order + 1))
    for k in range(order + 1):
        # d/di_d = c d/dx - s d/dy and d/di_q = s d/dx + c d/dy, multiplied out
        form = np.array([1.0])
        for factor in [(c, -s)] * (order - k) + [(s, c)] * k:
            form = np.convolve(form, factor)
        mixing[k] = form
    out: Array = np.einsum("kj,njs->nks", mixing, own)
    return out


@dataclass(frozen=True)
class EnergyProblem:
    """What is to be fitted, and how; the rows are made once for all weights. Attributes as of `EnergyFit`."""

    spline: EvenSpline
    points: Inductances | None
    paths: tuple[FluxPath, ...]
    angle_rad: float = 0.0
    stiffening_per_h: float = 0.0
    scales: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @cached_property
    def _inductance_rows(self) -> Array:
        assert self.points is not None
        at = self.points.current
        return np.concatenate([_rows(self.spline, at, self.angle_rad, order) for order in (2, 3)], axis=1)

    @cached_property
    def _path_rows(self) -> list[Array]:
        rows = (_rows(self.spline, path.current[::_THINNED], self.angle_rad, 1) for path in self.paths)
        # Each path has its own constant, which its mean takes with it.
        return [one - one.mean(axis=0) for one in rows]

    def scaled(self, scales: tuple[float, float, float]) -> EnergyProblem:
        """The same with other weights; the rows stay."""
        other = replace(self, scales=scales)
        for name in ("_inductance_rows", "_path_rows"):
            if name in self.__dict__:
                other.__dict__[name] = self.__dict__[name]
        return other

    def inductances(self) -> tuple[Array, Array]:
        """Weighted rows (n, 7, size) and right-hand sides (n, 7) of the inductances and their slopes."""
        if self.points is None:
            return np.zeros((0, 7, self.spline.size)), np.zeros((0, 7))
        m, t = self._softened(self.points)
        target = np.column_stack(
            [m[:, 0, 0], m[:, 0, 1], m[:, 1, 1], t[:, 0, 0, 0], t[:, 0, 0, 1], t[:, 0, 1, 1], t[:, 1, 1, 1]]
        )
        grown = np.repeat(self.scales[:2], (3, 4))
        covariance = self.points.covariance * np.outer(grown, grown)
        # Slopes that were not told carry no information, not perfect information; and nothing is perfect.
        least = _PERFECT * float(np.abs(m).mean()) * np.repeat([1.0, 10.0 / float(np.ptp(self.points.current))], (3, 4))
        own = np.where(np.einsum("nii->ni", covariance) > 0.0, least**2, 1e12)
        root = np.linalg.cholesky(covariance + own[:, :, None] * np.eye(7))
        white = np.linalg.inv(root)
        return white @ self._inductance_rows, np.einsum("nij,nj->ni", white, target)

    def _softened(self, points: Inductances) -> tuple[Array, Array]:
        """L and dL/di along the map: (L^-1 - s)^-1, the third derivatives of the energy staying what they are."""
        grown = np.linalg.inv(np.eye(2) - self.stiffening_per_h * points.matrix)
        slope = np.einsum("nai,nbj,nck,nijk->nabc", grown, grown, grown, points.slope)
        return np.asarray(points.matrix @ grown), slope

    def fluxes(self) -> tuple[Array, Array]:
        """Weighted rows (n, 2, size) and right-hand sides (n, 2) of the flux along all paths."""
        if not self.paths:
            return np.zeros((0, 2, self.spline.size)), np.zeros((0, 2))
        rows, right = [], []
        for path, own in zip(self.paths, self._path_rows, strict=True):
            psi = path.psi[::_THINNED]
            floor = 1e-4 * float(np.ptp(psi, axis=0).max())
            std = self.scales[2] * np.sqrt(_ALIKE) * np.hypot(path.std, floor)
            rows.append(own / std[:, None])
            right.append((psi - psi.mean(axis=0)) / std)
        return np.concatenate(rows), np.concatenate(right)


@dataclass(frozen=True)
class Solution:
    """Least squares at one weight of the roughness.

    Attributes
    ----------
    coefficients : array, shape (k,)
    root : array, shape (k, k)
        Whose product with its transpose is the covariance.
    cost : float
        Minus twice the logarithm of the marginal likelihood, but for constants.
    """

    coefficients: Array
    root: Array
    cost: float


def smoothed(problem: EnergyProblem) -> Solution:
    """Least squares at the most likely smoothness."""
    from scipy.linalg import eigh
    from scipy.optimize import minimize_scalar

    blocks = [problem.inductances(), problem.fluxes()]
    rows = np.concatenate([a.reshape(-1, problem.spline.size) for a, _ in blocks])
    target = np.concatenate([b.ravel() for _, b in blocks])
    normal = rows.T @ rows
    unit = problem.spline.roughness * (np.trace(normal) / np.trace(problem.spline.roughness))
    # What no datum sees (the energy's constant, and the flux of the magnet) needs some value.
    faint = 1e-11 * np.trace(normal) / len(normal) * np.eye(len(normal))
    # In the basis that makes both diagonal every weight of the roughness is one division.
    share, basis = eigh(normal, normal + unit + faint)
    share = np.clip(share, 0.0, 1.0)
    right = basis.T @ (rows.T @ target)
    squares, rough = float(target @ target), len(normal) - problem.spline.smooth
    constant = -2.0 * float(np.linalg.slogdet(basis)[1])

    def cost(log_weight: float) -> float:
        whole = share + 10.0**log_weight * (1.0 - share) + 1e-300
        return float(
            squares - (right**2 / whole).sum() + np.log(whole).sum() - rough * np.log(10.0) * log_weight + constant
        )

    best = minimize_scalar(cost, bounds=(-10.0, 1.0), method="bounded", options={"xatol": 0.05})
    weight = 1.0 / (share + 10.0 ** float(best.x) * (1.0 - share) + 1e-300)
    return Solution(basis @ (weight * right), basis * np.sqrt(weight), float(best.fun))


def settled(problem: EnergyProblem) -> tuple[EnergyProblem, Solution]:
    """The sizes of the errors found from their own scatter, and the solution with them."""
    solution = smoothed(problem)
    for _ in range(_ROUNDS):
        problem = problem.scaled(_grown(problem, solution))
        solution = smoothed(problem)
    return problem, solution


def _grown(problem: EnergyProblem, solution: Solution) -> tuple[float, float, float]:
    """Scales that make each kind's residuals as large as their weights say."""
    rows, target = problem.inductances()
    kinds = [(rows[:, :3], target[:, :3]), (rows[:, 3:], target[:, 3:]), problem.fluxes()]
    scales = []
    for scale, (a, b) in zip(problem.scales, kinds, strict=True):
        used = float(((a @ solution.root) ** 2).sum())
        squares = float(((b - a @ solution.coefficients) ** 2).sum())
        growth = squares / max(b.size - used, 0.2 * b.size) if b.size else 1.0
        scales.append(max(scale * float(np.sqrt(growth)), 1.0))
    return scales[0], scales[1], scales[2]


def finished(problem: EnergyProblem, solution: Solution) -> EnergyFit:
    """The fit, its covariance widened where neighbours err alike: then there are fewer data than points."""
    correlation = _neighbour_correlation(problem, solution)
    count = 3 * len(problem.points.current) if problem.points is not None else 1
    sure = np.clip(correlation - 2.0 / np.sqrt(count), 0.0, 0.95)
    return EnergyFit(
        spline=problem.spline,
        angle_rad=problem.angle_rad,
        coefficients=solution.coefficients,
        covariance=solution.root @ solution.root.T * ((1.0 + sure) / (1.0 - sure)),
        scales=np.array(problem.scales),
        stiffening_per_h=problem.stiffening_per_h,
        correlation=correlation,
    )


def _neighbour_correlation(problem: EnergyProblem, solution: Solution) -> float:
    from scipy.spatial import cKDTree

    if problem.points is None or len(problem.points.current) < 3:
        return 0.0
    rows, target = problem.inductances()
    off = target[:, :3] - rows[:, :3] @ solution.coefficients
    nearest = np.asarray(cKDTree(problem.points.current).query(problem.points.current, k=2)[1])[:, 1]
    return float((off * off[nearest]).sum() / max(float((off**2).sum()), 1e-300))


def pose(points: Inductances | None, paths: Sequence[FluxPath]) -> EnergyProblem:
    """The problem of fitting these, with a spline that covers them."""
    current = np.concatenate([*([] if points is None else [points.current]), *(path.current for path in paths)])
    low, high = current.min(axis=0), current.max(axis=0)
    margin = _MARGIN * (high - low)
    reach = float(np.abs(current[:, 1]).max() + margin[1])
    spline = EvenSpline(float(low[0] - margin[0]), float(high[0] + margin[0]), reach, (_CELLS, _CELLS))
    return EnergyProblem(spline, points, tuple(paths))
