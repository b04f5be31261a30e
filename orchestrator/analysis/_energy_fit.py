"""Fit one co-energy to all measurements: psi = grad W(i), L = Hess W(i), so flux and inductances are consistent.

W is a tensor spline, even in i_q in the rotor's frame, at a small angle from the believed one.
Inductances with their slopes and the flux along swept paths are fitted together, each weighted by its own errors,
whose sizes are estimated as well; outlying points and paths get a lower weight. Restricted maximum likelihood gives the
smoothness of W (see `numerics.reml`), so the posterior covariance includes the error of interpolation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from orchestrator.analysis._flux_errors import WAVES, directions, sizes, waves, whitening
from orchestrator.analysis._inductance_errors import GAIN_STD, error_modes
from orchestrator.analysis._integration import Inductances
from orchestrator.analysis._sweep import FluxPath
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.reml import Solution, most_likely
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array

COARSE = (12, 12)
"""Intervals of the coarse spline, along d and over the whole range of q."""


@dataclass(frozen=True)
class EnergyFit:
    """The fitted co-energy.

    Attributes
    ----------
    spline : EvenSpline
    angle_rad : float
        Angle of the axis about which W is even, from the believed d axis.
    coefficients : array, shape (k,)
    covariance : array, shape (k, k)
    scales : array, shape (4,)
        Ratios of scatter to stated error: of inductances, of their slopes, and of the flux along and across the swept
        direction.
    stiffening_per_h : float
        Contribution of hysteresis to the ripple's Hessian [1/H]; removed from the energy.
    correlation : float
        Correlation of neighbouring inductances' residuals; near zero for an adequate model.
    inverter_step : float
        Relative effect of dead time on inductances where a phase current passes zero; removed from the energy.
    correction : array, shape (n, 7)
        Correction of the inductances and their slopes for a common gain and dead time.
    correction_std : array, shape (n, 7)
        Its standard deviation.
    trust : array, shape (n,)
        Weight of each point's information; less than one for outliers.
    """

    spline: EvenSpline
    angle_rad: float
    coefficients: Array
    covariance: Array
    scales: Array = field(default_factory=lambda: np.ones(4))
    stiffening_per_h: float = 0.0
    correlation: float = 0.0
    inverter_step: float = 0.0
    correction: Array = field(default_factory=lambda: np.zeros((0, 7)))
    correction_std: Array = field(default_factory=lambda: np.zeros((0, 7)))
    trust: Array = field(default_factory=lambda: np.ones(0))

    def flux(self, at: Array) -> tuple[Array, Array]:
        """psi(i) - psi(0) and its standard deviation, shape (n, 2) each [Wb]."""
        rows = energy_rows(self.spline, at, self.angle_rad, 1) - energy_rows(
            self.spline, np.zeros((1, 2)), self.angle_rad, 1
        )
        return self._evaluated(rows)

    def inductance(self, at: Array) -> tuple[Array, Array]:
        """L_dd, L_dq, L_qq and their standard deviations, shape (n, 3) each [H]."""
        return self._evaluated(energy_rows(self.spline, at, self.angle_rad, 2))

    def _evaluated(self, rows: Array) -> tuple[Array, Array]:
        variance = np.einsum("nck,nck->nc", rows @ self.covariance, rows)
        return rows @ self.coefficients, np.sqrt(np.maximum(variance, 0.0))


def energy_rows(spline: EvenSpline, at: Array, angle: float, order: int) -> Array:
    """All derivatives of one order in the believed frame, in falling order of d; shape (n, order + 1, size)."""
    c, s = np.cos(angle), np.sin(angle)
    at = to_dq(at, angle)
    derivatives = np.stack([spline.rows(at, order - k, k) for k in range(order + 1)], axis=1)
    mixing = np.zeros((order + 1, order + 1))
    for k in range(order + 1):
        # d/di_d = c d/dx - s d/dy and d/di_q = s d/dx + c d/dy, multiplied out
        form = np.array([1.0])
        for factor in [(c, -s)] * (order - k) + [(s, c)] * k:
            form = np.convolve(form, factor)
        mixing[k] = form
    out: Array = np.einsum("kj,njs->nks", mixing, derivatives)
    return out


@dataclass(frozen=True)
class Errors:
    """Assumed sizes of the measurement errors.

    Attributes
    ----------
    scales : (float, float, float, float)
        Scales of inductances, of their slopes, and of the flux along and across the swept direction, in stated errors.
    points, paths : array, shapes (n,), (p,), or None
        Factors that reduce the information of each; None: no reduction.
    inverter_step : float
        Relative effect of dead time on inductances where a phase current passes zero; 0: none.
    """

    scales: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    points: Array | None = None
    paths: Array | None = None
    inverter_step: float = 0.0


@dataclass(frozen=True)
class EnergyProblem:
    """The least-squares problem; its rows are computed once for all errors. Attributes as in `EnergyFit`."""

    spline: EvenSpline
    points: Inductances | None
    paths: tuple[FluxPath, ...]
    rotor_angle_rad: Array | float = 0.0
    angle_rad: float = 0.0
    stiffening_per_h: float = 0.0
    errors: Errors = Errors()

    @property
    def free(self) -> int:
        """Number of leading modes that are unpenalised or have their own prior."""
        # The energy's constant and the magnet's flux are unobservable.
        return self.spline.smooth - 2 + self.error_mode_count

    @cached_property
    def error_mode_count(self) -> int:
        """Number of measurement-error modes; they are the last of the free ones."""
        return 0 if self.points is None else self._error_modes.shape[2]

    @cached_property
    def modes(self) -> Array:
        """Coefficients of each mode's spline, shape (size, modes); zero for measurement-error modes."""
        energy_modes = self.spline.modes[:, 2:]
        return np.insert(energy_modes, [self.free - self.error_mode_count] * self.error_mode_count, 0.0, axis=1)

    @cached_property
    def _error_modes(self) -> Array:
        assert self.points is not None
        return error_modes(self.points, np.broadcast_to(self.rotor_angle_rad, len(self.points.current)))

    @cached_property
    def _inductance_rows(self) -> Array:
        assert self.points is not None
        at = self.points.current
        rows = np.concatenate([energy_rows(self.spline, at, self.angle_rad, order) for order in (2, 3)], axis=1)
        out = np.asarray(rows @ self.modes)
        out[:, :, self.free - self.error_mode_count : self.free] = self._error_modes
        return out

    @cached_property
    def _path_rows(self) -> Array:
        """Cosine waves of each mode's flux, along each path's direction and across, shape (p, 2, waves, modes)."""
        each = [
            np.einsum(
                "wm,mck,xc->xwk", waves(len(path.psi)), energy_rows(self.spline, path.current, self.angle_rad, 1), axis
            )
            for path, axis in zip(self.paths, directions(self.paths), strict=True)
        ]
        return np.stack(each) @ self.modes

    def varied(
        self, *, errors: Errors | None = None, angle_rad: float | None = None, stiffening_per_h: float | None = None
    ) -> EnergyProblem:
        """The problem with other errors, angle or stiffening; keeps the rows that do not change."""
        other = replace(
            self,
            errors=self.errors if errors is None else errors,
            angle_rad=self.angle_rad if angle_rad is None else angle_rad,
            stiffening_per_h=self.stiffening_per_h if stiffening_per_h is None else stiffening_per_h,
        )
        unchanged = ["error_mode_count", "modes", "_error_modes"]
        if other.angle_rad == self.angle_rad:
            unchanged += ["_inductance_rows", "_path_rows"]
        other.__dict__.update({name: self.__dict__[name] for name in unchanged if name in self.__dict__})
        return other

    def correction(self, solution: Solution) -> tuple[Array, Array]:
        """Fitted measurement errors of inductances and slopes, and their std, shape (n, 7) each."""
        if self.points is None:
            return np.zeros((0, 7)), np.zeros((0, 7))
        rows = slice(self.free - self.error_mode_count, self.free)
        modes, root = solution.coefficients[rows], solution.root[rows]
        return self._error_modes @ modes, np.linalg.norm(self._error_modes @ root, axis=-1)

    def inductances(self) -> tuple[Array, Array]:
        """Rows (n, 7, modes) and right-hand sides (n, 7) of the inductances and their slopes, in stated errors."""
        if self.points is None:
            return np.zeros((0, 7, self.modes.shape[1])), np.zeros((0, 7))
        # Without hysteresis (L^-1 - s)^-1, the third derivatives of the energy unchanged.
        softening = np.linalg.inv(np.eye(2) - self.stiffening_per_h * self.points.matrix)
        m = self.points.matrix @ softening
        t = np.einsum("nai,nbj,nck,nijk->nabc", softening, softening, softening, self.points.slope)
        target = np.column_stack(
            [m[:, 0, 0], m[:, 0, 1], m[:, 1, 1], t[:, 0, 0, 0], t[:, 0, 0, 1], t[:, 0, 1, 1], t[:, 1, 1, 1]]
        )
        grown = np.repeat(self.errors.scales[:2], (3, 4))
        covariance = self.points.covariance * np.outer(grown, grown)
        # Undetermined slopes carry no information instead of perfect information; no error is below 1e-4.
        floor = 1e-4 * float(np.abs(m).mean()) * np.repeat([1.0, 10.0 / float(np.ptp(self.points.current))], (3, 4))
        floor_variance = np.where(np.einsum("nii->ni", covariance) > 0.0, floor**2, 1e12)
        root = np.linalg.cholesky(covariance + floor_variance[:, :, None] * np.eye(7))
        white = np.linalg.inv(root)
        return white @ self._inductance_rows, np.einsum("nij,nj->ni", white, target)

    def fluxes(self) -> tuple[Array, Array]:
        """Rows (p, 2 waves, modes) and right-hand sides (p, 2 waves) of the flux along all paths.

        The error of an integral is a random walk: independent waves, the k-th falling as 1/k.
        """
        if not self.paths:
            return np.zeros((0, 2 * WAVES, self.modes.shape[1])), np.zeros((0, 2 * WAVES))
        axes = directions(self.paths)
        psi = np.stack([axis @ (waves(len(p.psi)) @ p.psi).T for p, axis in zip(self.paths, axes, strict=True)])
        size = sizes(self.paths) * np.array(self.errors.scales[2:])[:, None]
        count = len(self.paths)
        return (self._path_rows / size[..., None]).reshape(count, 2 * WAVES, -1), (psi / size).reshape(count, -1)

    def prior(self) -> tuple[Array, float]:
        """Prior rows of the measurement-error modes, and twice the logarithm of their sizes."""
        if self.points is None:
            return np.zeros((0, self.modes.shape[1])), 0.0
        # Absent effects get a small size, since the set of modes is fixed.
        size = np.append(GAIN_STD, np.full(self.error_mode_count - 1, max(self.errors.inverter_step, 1e-7)))
        return np.eye(self.modes.shape[1])[self.free - self.error_mode_count : self.free] / size[:, None], 2.0 * float(
            np.log(size).sum()
        )

    def blocks(self) -> list[tuple[Array, Array, Array]]:
        """Rows, right-hand sides and the roots of their weights: a block each of points and of paths."""
        out = []
        for (rows, target), weight in zip(
            (self.inductances(), self.fluxes()), (self.errors.points, self.errors.paths), strict=True
        ):
            out.append((rows, target, np.ones(len(rows)) if weight is None else np.sqrt(weight)))
        return out


def smoothed(problem: EnergyProblem) -> Solution:
    """Least squares at the most likely smoothness."""
    (points, observed, weights), (paths, flux, path_weights) = problem.blocks()
    paths, flux = paths * path_weights[:, None, None], flux * path_weights[:, None]
    if len(paths):
        along, whitener = slice(0, WAVES), whitening(problem.paths)
        paths[:, along], flux[:, along] = np.tensordot(whitener, paths[:, along], (1, 0)), whitener @ flux[:, along]
    prior, size = problem.prior()
    rows = np.concatenate(
        [(points * weights[:, None, None]).reshape(-1, points.shape[2]), paths.reshape(-1, points.shape[2]), prior]
    )
    target = np.concatenate([(observed * weights[:, None]).ravel(), flux.ravel(), np.zeros(len(prior))])
    solution = most_likely(rows, target, problem.free)
    return replace(solution, cost=solution.cost + size)


def evidence(problem: EnergyProblem, solution: Solution) -> float:
    """-2 log likelihood including the errors' sizes and outliers; comparable for the same data only."""
    total = solution.cost
    kinds = ((problem.errors.scales[:2], (3, 4)), (problem.errors.scales[2:], (WAVES, WAVES)))
    for (_, _, root), (scales, counts) in zip(problem.blocks(), kinds, strict=True):
        total += 2.0 * len(root) * float(np.log(scales) @ counts)
        # An outlier costs the logarithm of its residual, other data cost the square.
        total -= 2.0 * _limit(sum(counts)) * float(np.log(root).sum())
    return total


def _limit(count: int, usual: float = 0.99) -> float:
    """Outlier threshold: the quantile of chi-squared with this many degrees of freedom."""
    from scipy.special import chdtri

    return float(chdtri(count, 1.0 - usual))


def settled(problem: EnergyProblem, rounds: int = 6, change: float = 0.01) -> tuple[EnergyProblem, Solution]:
    """Iterated error sizes from the residuals' scatter, to a relative `change`, and the solution with them."""
    solution = smoothed(problem)
    for _ in range(rounds):
        previous = np.array(problem.errors.scales)
        problem = problem.varied(errors=_errors_by_scatter(problem, solution))
        solution = smoothed(problem)
        if np.allclose(problem.errors.scales, previous, rtol=change, atol=0.0):
            break
    return problem, solution


def _errors_by_scatter(problem: EnergyProblem, solution: Solution, prior_count: float = 20.0) -> Errors:
    """Errors that match the scatter of each kind's residuals; the prior counts as `prior_count` data, outliers less."""
    weights: list[Array] = []
    growth: list[float] = []
    for (rows, target, root), kinds in zip(
        problem.blocks(), ((slice(0, 3), slice(3, 7)), (slice(0, WAVES), slice(WAVES, None))), strict=True
    ):
        if not len(rows):
            weights.append(np.ones(0))
            growth += [1.0] * len(kinds)
            continue
        off = target - rows @ solution.coefficients
        leverage = np.square(rows @ solution.root).sum(axis=2)
        for kind in kinds:
            squares = float(np.square(off[:, kind] * root[:, None]).sum())
            count = float(off[:, kind].size)
            free = max(count - float((leverage[:, kind] * root[:, None] ** 2).sum()), 0.2 * count)
            growth.append((prior_count + squares) / (prior_count + free))
        size = np.square(off).sum(axis=1)
        weights.append(np.minimum(1.0, _limit(off.shape[1]) / np.maximum(size, 1e-300)))
    a, b, c, d = (max(float(s * np.sqrt(g)), 1.0) for s, g in zip(problem.errors.scales, growth, strict=True))
    return replace(problem.errors, scales=(a, b, c, d), points=weights[0], paths=weights[1])


def finished(problem: EnergyProblem, solution: Solution) -> EnergyFit:
    """The fit; correlated residuals of neighbours widen its covariance, as the data are effectively fewer."""
    correlation, count = 0.0, 0
    if problem.points is not None:
        count = len(problem.points.current)
        rows, target, weights = problem.blocks()[0]
        off = (target[:, :3] - rows[:, :3] @ solution.coefficients) * weights[:, None]
        correlation = neighbour_correlation(problem.points.current, off)
    significant = np.clip(correlation - 2.0 / np.sqrt(max(3 * count, 1)), 0.0, 0.95)
    modes = problem.modes
    root = modes @ solution.root
    weight = problem.errors.points
    widened = float(np.sqrt((1.0 + significant) / (1.0 - significant)))
    correction, correction_std = problem.correction(solution)
    return EnergyFit(
        spline=problem.spline,
        angle_rad=problem.angle_rad,
        coefficients=modes @ solution.coefficients,
        covariance=root @ root.T * widened**2,
        scales=np.array(problem.errors.scales),
        stiffening_per_h=problem.stiffening_per_h,
        correlation=correlation,
        inverter_step=problem.errors.inverter_step,
        correction=correction,
        correction_std=widened * correction_std,
        trust=np.ones(count) if weight is None else weight,
    )


def neighbour_correlation(current: Array, off: Array) -> float:
    """Correlation of the residuals of nearest neighbours, which a model's misfit causes."""
    from scipy.spatial import cKDTree

    if len(current) < 3:
        return 0.0
    nearest = np.asarray(cKDTree(current).query(current, k=2)[1])[:, 1]
    return float((off * off[nearest]).sum() / max(float((off**2).sum()), 1e-300))


def pose(
    points: Inductances | None,
    paths: Sequence[FluxPath],
    rotor_angle_rad: Array | float = 0.0,
    cells: tuple[int, int] = COARSE,
) -> EnergyProblem:
    """The least-squares problem of these data, with a spline that covers them."""
    current = np.concatenate([*([] if points is None else [points.current]), *(path.current for path in paths)])
    low, high = current.min(axis=0), current.max(axis=0)
    # A margin keeps the ends of the spline away from the measured currents.
    margin = 0.06 * (high - low)
    reach = float(np.abs(current[:, 1]).max() + margin[1])
    spline = EvenSpline(float(low[0] - margin[0]), float(high[0] + margin[0]), reach, cells)
    return EnergyProblem(spline, points, tuple(paths), rotor_angle_rad)
