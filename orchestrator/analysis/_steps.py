"""Fit map, resistance, inverter error and lag to voltage steps by one least-squares problem.

    psi(i_k) = psi_0 + integral of (v(t - T_d) - R_s i - T e(i_abc) - v_0) dt,      psi = grad W(i)

W is a tensor spline, even in i_q about an axis at a small fitted angle; psi_0 is free in each stretch of a few swings,
v_0 in each segment, which removes drift. R_s, the inverter's error e at its knots and the lag T_d are determined by the
closure errors of loops: R_s by a loop's mean current, e by each phase's sign, T_d by the error at the voltage edges.
All are unknowns of one system, so the map's covariance includes theirs. The data give W's smoothness (`numerics.reml`).
(+-U between current limits: M. Hinkkanen et al., IEEE Trans. Ind. Appl. 53 (2017) 2120, doi:10.1109/TIA.2016.2644624.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from orchestrator.analysis._energy_fit import EnergyFit, energy_rows
from orchestrator.analysis._resistance import DEFAULT_RESISTANCE_STD_RATIO
from orchestrator.analysis._step_trace import StepTrace
from orchestrator.analysis._sweep import FluxPath
from orchestrator.numerics.reml import Solution, most_likely
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array

CELLS = (12, 12)
"""Intervals of the spline along d and q."""


@dataclass(frozen=True)
class StepsFit:
    """Results from voltage steps.

    Attributes
    ----------
    energy : EnergyFit
    resistance_ohm, resistance_std_ohm : float
    lag_samples, lag_std_samples : float
        Delay of the voltage beyond the declared one.
    loss_v, loss_std_v : array, shape (k,)
        Inverter voltage error of each phase at the knots.
    residual_wb : array, shape (2,)
        rms of the flux residual.
    misfit : array, shape (m, 2)
        The flux residual averaged over quarters of a swing [Wb].
    paths : tuple of FluxPath
        The flux from each reversal of the voltage to the next, corrected for all fitted errors.
    determines_resistance : bool
        Whether the loops separate R_s from the inverter's voltage error; otherwise both keep their priors.
    """

    energy: EnergyFit
    resistance_ohm: float
    resistance_std_ohm: float
    lag_samples: float
    lag_std_samples: float
    loss_v: Array
    loss_std_v: Array
    residual_wb: Array
    misfit: Array
    paths: tuple[FluxPath, ...]
    determines_resistance: bool = True


@dataclass(frozen=True)
class Priors:
    """Priors, as standard deviations about zero except for R_s.

    Attributes
    ----------
    resistance_ohm, resistance_std_ohm : float
    lag_samples : float
    loss_share, bias_share : float
        Inverter voltage error of a phase, and a constant error, each relative to the steps' voltage.
    angle_rad : float
        Angle of the axis of symmetry from the believed d axis.
    """

    resistance_ohm: float
    resistance_std_ohm: float
    lag_samples: float = 3.0
    loss_share: float = 0.05
    bias_share: float = 0.02
    angle_rad: float = 0.1


def fit_steps(traces: Sequence[StepTrace], priors: Priors, angle_rad: float = 0.0, rounds: int = 4) -> StepsFit:
    """Fit all traces at once, and the rms residual of each axis with them.

    Parameters
    ----------
    angle_rad : float
        Start value of the axis of symmetry's angle from the believed d axis.
    """
    system = _System.of(traces, priors, angle_rad)
    size = 1e-3 * float(np.ptp(system.target)) * np.ones(2)
    solution = system.solved(size)
    for _ in range(rounds):
        before, size = size, system.residual_rms(solution)
        # The derivative by the axis angle needs the flux of the previous round.
        system = system.turned(solution)
        solution = system.solved(size)
        if np.allclose(size, before, rtol=0.01):
            break
    if not system.determines_resistance(solution):
        # Model errors are fully correlated over the points: all of them count as one.
        size = size * np.sqrt(system.target.size)
        return replace(system.finished(system.solved(size), size), determines_resistance=False)
    return system.finished(solution, size)


@dataclass(frozen=True)
class _System:
    """The equations of all traces. Columns: free modes of the energy, the other unknowns, rough modes of the energy.

    Attributes
    ----------
    rows, target : array, shapes (2, n, k), (2, n)
        Equations of each axis, less their means over each stretch.
    other_columns : slice
        Columns of the unknowns that are not the energy's: R_s, lag, angle, the inverter's knots, biases.
    """

    traces: Sequence[StepTrace]
    priors: Priors
    angle_rad: float
    spline: EvenSpline
    rows: Array
    target: Array
    other_columns: slice

    @classmethod
    def of(cls, traces: Sequence[StepTrace], priors: Priors, angle_rad: float) -> _System:
        """The equations at this axis angle, with a zero column for its derivative."""
        current = np.concatenate([trace.i for trace in traces])
        spline = _covering(current)
        shape = energy_rows(spline, current, angle_rad, 1) @ spline.modes[:, 2:]
        free = spline.smooth - 2
        others = _other_columns(traces)
        rows = np.concatenate([shape[:, :, :free], others, shape[:, :, free:]], axis=2)
        target = np.concatenate([trace.impulse for trace in traces])
        for rows_of_stretch in _stretches(traces):
            rows[rows_of_stretch] -= rows[rows_of_stretch].mean(axis=0)
            target[rows_of_stretch] -= target[rows_of_stretch].mean(axis=0)
        unknowns = slice(free, free + others.shape[2])
        return cls(traces, priors, angle_rad, spline, np.moveaxis(rows, 1, 0), target.T, unknowns)

    @property
    def knots(self) -> int:
        return int(self.traces[0].losses.shape[1])

    def solved(self, size: Array) -> Solution:
        """Most likely solution for these rms residuals of the axes, shape (2,) [Wb]."""
        width = self.rows.shape[2]
        std = self._std()
        prior, expected = np.zeros((len(std), width)), np.zeros(len(std))
        expected[0], expected[2] = self.priors.resistance_ohm, -self.angle_rad
        prior[:, self.other_columns] = np.diag(1.0 / std)
        rows = np.concatenate([*(self.rows / size[:, None, None]), prior])
        target = np.concatenate([*(self.target / size[:, None]), expected / std])
        return most_likely(rows, target, self.other_columns.stop)

    def _std(self) -> Array:
        b, volts = self.priors, max(trace.volts for trace in self.traces)
        biases = np.full(2 * len(self.traces), b.bias_share * volts)
        losses = np.full(self.knots, b.loss_share * volts)
        return np.concatenate([[b.resistance_std_ohm, b.lag_samples, b.angle_rad], losses, biases])

    def determines_resistance(self, solution: Solution) -> bool:
        """Whether the loops separate R_s from the inverter's error, or R_s was measured before.

        Loops through currents of both signs do. With currents of one sign, a change of R_s by its prior std, less what
        other unknowns can compensate, has to move the flux by more than the rms residual, which may be model error.
        Steps to one level of one sign determine only the sum R_s i + e.
        """
        prior_std = self.priors.resistance_std_ohm
        is_measured = prior_std < DEFAULT_RESISTANCE_STD_RATIO * abs(self.priors.resistance_ohm)
        if is_measured or any(_has_both_signs(t.i) for t in self.traces):
            return True
        std = float(np.linalg.norm(solution.root[self.other_columns.start]))
        return (std**-2 - prior_std**-2) * prior_std**2 > self.target.size

    def residual(self, solution: Solution) -> Array:
        """Flux residual, shape (2, n) [Wb]."""
        return np.asarray(self.target - self.rows @ solution.coefficients)

    def residual_rms(self, solution: Solution, resolved: float = 1e-5) -> Array:
        """rms residual, shape (2,) [Wb]; at least `resolved` of the flux, the best accuracy of an integral."""
        return np.asarray(np.maximum(self.residual(solution).std(axis=1), resolved * np.ptp(self.target, axis=1).max()))

    def turned(self, solution: Solution, min_sigmas: float = 4.0, min_rad: float = 0.002) -> _System:
        """The system at the fitted axis angle, where that is significant, with the derivative by that angle."""
        column = self.other_columns.start + 2
        angle = self.angle_rad + float(solution.coefficients[column])
        threshold = max(min_sigmas * float(np.linalg.norm(solution.root[column])), min_rad)
        system = self
        if abs(angle) > threshold and abs(angle - self.angle_rad) > 0.1 * threshold:
            system = _System.of(self.traces, self.priors, angle)
        fit, current = self._energy(solution, 1.0), np.concatenate([trace.i for trace in self.traces])
        derivative = _angle_derivative(current, fit.flux(current)[0], fit.inductance(current)[0])
        for rows_of_stretch in _stretches(self.traces):
            derivative[rows_of_stretch] -= derivative[rows_of_stretch].mean(axis=0)
        system.rows[:, :, column] = derivative.T
        return system

    def _energy(self, solution: Solution, widened: float) -> EnergyFit:
        modes = self.spline.modes[:, 2:]
        energy_columns = np.r_[: self.other_columns.start, self.other_columns.stop : self.rows.shape[2]]
        root = modes @ solution.root[energy_columns] * widened
        return EnergyFit(
            spline=self.spline,
            angle_rad=self.angle_rad,
            coefficients=modes @ solution.coefficients[energy_columns],
            covariance=root @ root.T,
        )

    def finished(self, solution: Solution, size: Array) -> StepsFit:
        """The result; correlated residuals of neighbouring blocks widen its covariance."""
        residual = self.residual(solution)
        stretch = np.concatenate([trace.stretch + 1_000_000 * k for k, trace in enumerate(self.traces)])
        same = stretch[1:] == stretch[:-1]
        products = (residual[:, 1:] * residual[:, :-1])[:, same]
        correlation = min(max(float(products.sum()) / max(float((residual**2).sum()), 1e-300), 0.0), 0.97)
        widened = float(np.sqrt((1.0 + correlation) / (1.0 - correlation)))
        values = solution.coefficients[self.other_columns]
        std = widened * np.linalg.norm(solution.root[self.other_columns], axis=1)
        # A posterior is never wider than its prior.
        std = np.minimum(std, self._std())
        knots = slice(3, 3 + self.knots)
        quarter = max(1, round(0.25 * min(trace.swing for trace in self.traces)))
        count = residual.shape[1] // quarter
        paths = tuple(self._paths(values, size * widened))
        return StepsFit(
            energy=self._energy(solution, widened),
            resistance_ohm=float(values[0]),
            resistance_std_ohm=float(std[0]),
            lag_samples=float(values[1]),
            lag_std_samples=float(std[1]),
            loss_v=values[knots],
            loss_std_v=std[knots],
            residual_wb=size,
            # At most 120 of them, evenly spread: loops repeat.
            paths=paths[:: max(1, -(-len(paths) // 120))],
            misfit=residual[:, : count * quarter].reshape(2, count, quarter).mean(axis=2).T,
        )

    def _paths(self, values: Array, std: Array, shortest: int = 8) -> Iterator[FluxPath]:
        psi = (self.target - self.rows[:, :, self.other_columns] @ values).T
        first = 0
        for trace in self.traces:
            inside = slice(first, first + len(trace.i))
            for swing in _swings(trace):
                if swing.stop - swing.start >= shortest:
                    yield FluxPath(trace.i[swing], psi[inside][swing], std)
            first = inside.stop


def _has_both_signs(current: Array, share: float = 0.2) -> bool:
    """Whether a current, shape (n, 2), reaches `share` of its longest vector in the opposite direction."""
    longest = current[int(np.argmax(np.linalg.norm(current, axis=1)))]
    along = current @ longest
    return bool(along.min() < -share * along.max())


def _swings(trace: StepTrace, share: float = 0.5) -> Iterator[slice]:
    """Rows of a trace between two reversals of its voltage, without the blocks of the reversals."""
    rate = np.diff(trace.impulse, axis=0)
    jump = np.abs(np.diff(rate, axis=0))
    is_reversal = (jump > share * jump.max(axis=0, initial=1e-300)).any(axis=1)
    cut = np.concatenate([[False], is_reversal, [False]]) | np.concatenate([np.diff(trace.stretch) != 0, [False]])
    edges = np.flatnonzero(cut)
    for start, stop in pairwise([-1, *edges.tolist(), len(trace.i)]):
        yield slice(start + 1, stop)


def _stretches(traces: Sequence[StepTrace]) -> Iterator[slice]:
    """Rows of each stretch, over all traces in order."""
    first = 0
    for trace in traces:
        edges = np.flatnonzero(np.diff(trace.stretch)) + 1
        for start, stop in pairwise([0, *edges.tolist(), len(trace.i)]):
            yield slice(first + start, first + stop)
        first += len(trace.i)


def _covering(current: Array, margin: float = 0.06) -> EvenSpline:
    low, high = current.min(axis=0), current.max(axis=0)
    extra = margin * (high - low)
    return EvenSpline(
        float(low[0] - extra[0]), float(high[0] + extra[0]), float(np.abs(current[:, 1]).max() + extra[1]), CELLS
    )


def _other_columns(traces: Sequence[StepTrace]) -> Array:
    """Columns of R_s, lag, angle (zero here), each knot and each segment's bias, shape (n, 2, columns)."""
    blocks = []
    for k, trace in enumerate(traces):
        other_columns = np.zeros((len(trace.i), 2, 3 + trace.losses.shape[1] + 2 * len(traces)))
        other_columns[:, :, 0] = trace.charge
        other_columns[:, :, 1] = -trace.lag
        other_columns[:, :, 3 : 3 + trace.losses.shape[1]] = np.moveaxis(trace.losses, 1, 2)
        bias = 3 + trace.losses.shape[1] + 2 * k
        other_columns[:, 0, bias] = other_columns[:, 1, bias + 1] = trace.time
        blocks.append(other_columns)
    return np.concatenate(blocks)


def _angle_derivative(current: Array, psi: Array, inductance: Array) -> Array:
    """Derivative of the flux by the axis angle, J psi - L J i, shape (n, 2)."""
    rotated_i = np.column_stack([-current[:, 1], current[:, 0]])
    rotated_psi = np.column_stack([-psi[:, 1], psi[:, 0]])
    matrix = inductance[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    return np.asarray(rotated_psi - np.einsum("nij,nj->ni", matrix, rotated_i))
