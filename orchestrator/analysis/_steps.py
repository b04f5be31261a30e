"""Fit map, resistance, inverter error and lag to voltage steps by one least-squares problem.

    psi(i_k) = psi_0 + integral of (v(t - T_d) - R_s i - T e(i_abc) - v_0) dt,      psi = grad W(i)

W is a tensor spline, even in i_q about an axis that may be turned a little; psi_0 is free in each stretch of a few
swings, v_0 in each segment, so that nothing drifts. R_s, the inverter's shape e at its knots and the lag T_d show in
how far loops do not close: R_s by a loop's mean current, e by each phase's sign, a lag by what is plain at the edges.
All stand in one system, so their doubt is in the map's. How smooth W is the data say (`numerics.reml`).
(+-U between current limits: M. Hinkkanen et al., IEEE Trans. Ind. Appl. 53 (2017) 2120, doi:10.1109/TIA.2016.2644624.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from orchestrator.analysis._energy_fit import EnergyFit, energy_rows
from orchestrator.analysis._resistance import UNSTATED
from orchestrator.analysis._step_trace import StepTrace
from orchestrator.analysis._sweep import FluxPath
from orchestrator.numerics.reml import Solution, most_likely
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array

CELLS = (12, 12)


@dataclass(frozen=True)
class StepsFit:
    """Results from voltage steps.

    Attributes
    ----------
    energy : EnergyFit
    resistance_ohm, resistance_std_ohm : float
    lag_samples, lag_std_samples : float
        By how much later than declared the voltage acts.
    loss_v, loss_std_v : array, shape (k,)
        What each phase loses at the knots.
    left_wb : array, shape (2,)
        rms of what is left of the flux.
    misfit : array, shape (m, 2)
        The same, averaged over a quarter of a swing [Wb].
    paths : tuple of FluxPath
        The flux from each turn of the voltage to the next, all that is wrong with it taken out.
    determines_resistance : bool
        Whether the loops tell R_s apart from the inverter's loss; else both are as they were believed.
    """

    energy: EnergyFit
    resistance_ohm: float
    resistance_std_ohm: float
    lag_samples: float
    lag_std_samples: float
    loss_v: Array
    loss_std_v: Array
    left_wb: Array
    misfit: Array
    paths: tuple[FluxPath, ...]
    determines_resistance: bool = True


@dataclass(frozen=True)
class Beliefs:
    """Priors, as standard deviations about zero except for R_s.

    Attributes
    ----------
    resistance_ohm, resistance_std_ohm : float
    lag_samples : float
    loss_share, bias_share : float
        Of the steps' voltage: what an inverter keeps from a phase, and a constant error.
    angle_rad : float
        Of the axis of symmetry.
    """

    resistance_ohm: float
    resistance_std_ohm: float
    lag_samples: float = 3.0
    loss_share: float = 0.05
    bias_share: float = 0.02
    angle_rad: float = 0.1


def fit_steps(traces: Sequence[StepTrace], beliefs: Beliefs, angle_rad: float = 0.0, rounds: int = 4) -> StepsFit:
    """Fit all traces at once, the size of what is left of each axis with them.

    Parameters
    ----------
    angle_rad : float
        Of the axis of symmetry, from the believed d axis, to begin with.
    """
    system = _System.of(traces, beliefs, angle_rad)
    size = 1e-3 * float(np.ptp(system.target)) * np.ones(2)
    solution = system.solved(size)
    for _ in range(rounds):
        before, size = size, system.left(solution)
        # What a turn of the axis does is known only where the flux is.
        system = system.turned(solution)
        solution = system.solved(size)
        if np.allclose(size, before, rtol=0.01):
            break
    if not system.determines_resistance(solution):
        # What a model misses is alike at all points: so many of them tell no more than one.
        size = size * np.sqrt(system.target.size)
        return replace(system.finished(system.solved(size), size), determines_resistance=False)
    return system.finished(solution, size)


@dataclass(frozen=True)
class _System:
    """The equations of all traces: free modes of the energy, what else is unknown, and the energy's rough modes.

    Attributes
    ----------
    rows, target : array, shapes (2, n, k), (2, n)
        Of each axis, less their means over each stretch.
    own : slice
        Of the unknowns that are not the energy's: R_s, lag, angle, the inverter's knots, biases.
    """

    traces: Sequence[StepTrace]
    beliefs: Beliefs
    angle_rad: float
    spline: EvenSpline
    rows: Array
    target: Array
    own: slice

    @classmethod
    def of(cls, traces: Sequence[StepTrace], beliefs: Beliefs, angle_rad: float) -> _System:
        """The equations where the axis of symmetry stands; what its turning does is left out."""
        current = np.concatenate([trace.i for trace in traces])
        spline = _covering(current)
        shape = energy_rows(spline, current, angle_rad, 1) @ spline.modes[:, 2:]
        free = spline.smooth - 2
        own = _unknowns(traces)
        rows = np.concatenate([shape[:, :, :free], own, shape[:, :, free:]], axis=2)
        target = np.concatenate([trace.impulse for trace in traces])
        for there in _stretches(traces):
            rows[there] -= rows[there].mean(axis=0)
            target[there] -= target[there].mean(axis=0)
        unknowns = slice(free, free + own.shape[2])
        return cls(traces, beliefs, angle_rad, spline, np.moveaxis(rows, 1, 0), target.T, unknowns)

    @property
    def knots(self) -> int:
        return int(self.traces[0].losses.shape[1])

    def solved(self, size: Array) -> Solution:
        """What is most likely where so much is left of each axis, shape (2,)."""
        width = self.rows.shape[2]
        std = self._std()
        prior, expected = np.zeros((len(std), width)), np.zeros(len(std))
        expected[0], expected[2] = self.beliefs.resistance_ohm, -self.angle_rad
        prior[:, self.own] = np.diag(1.0 / std)
        rows = np.concatenate([*(self.rows / size[:, None, None]), prior])
        target = np.concatenate([*(self.target / size[:, None]), expected / std])
        return most_likely(rows, target, self.own.stop)

    def _std(self) -> Array:
        b, volts = self.beliefs, max(trace.volts for trace in self.traces)
        biases = np.full(2 * len(self.traces), b.bias_share * volts)
        losses = np.full(self.knots, b.loss_share * volts)
        return np.concatenate([[b.resistance_std_ohm, b.lag_samples, b.angle_rad], losses, biases])

    def determines_resistance(self, solution: Solution) -> bool:
        """Whether the loops tell R_s apart from what the inverter keeps, where a nameplate alone tells it otherwise.

        Loops through currents of both signs do. Currents of one sign do where a change of R_s by its believed error,
        as far as no other unknown can make up for it, moves the flux by more (rms) than the model leaves: what is
        smaller may be an error of the model. Steps to one level of one sign fix the sum R_s i + e alone.
        """
        believed = self.beliefs.resistance_std_ohm
        if believed < UNSTATED * abs(self.beliefs.resistance_ohm) or any(_goes_both_ways(t.i) for t in self.traces):
            return True
        std = float(np.linalg.norm(solution.root[self.own.start]))
        return (std**-2 - believed**-2) * believed**2 > self.target.size

    def residual(self, solution: Solution) -> Array:
        """Shape (2, n) [Wb]."""
        return np.asarray(self.target - self.rows @ solution.modes)

    def left(self, solution: Solution, resolved: float = 1e-5) -> Array:
        """rms of it, shape (2,); no less than a part of the flux, for no integral is better."""
        return np.asarray(np.maximum(self.residual(solution).std(axis=1), resolved * np.ptp(self.target, axis=1).max()))

    def turned(self, solution: Solution, sure: float = 4.0, least_rad: float = 0.002) -> _System:
        """The same with the axis where it was found, where that is beyond doubt, and with the slope of its turning."""
        place = self.own.start + 2
        angle = self.angle_rad + float(solution.modes[place])
        doubt = max(sure * float(np.linalg.norm(solution.root[place])), least_rad)
        system = self
        if abs(angle) > doubt and abs(angle - self.angle_rad) > 0.1 * doubt:
            system = _System.of(self.traces, self.beliefs, angle)
        fit, current = self._energy(solution, 1.0), np.concatenate([trace.i for trace in self.traces])
        slope = _turning(current, fit.flux(current)[0], fit.inductance(current)[0])
        for there in _stretches(self.traces):
            slope[there] -= slope[there].mean(axis=0)
        system.rows[:, :, place] = slope.T
        return system

    def _energy(self, solution: Solution, widened: float) -> EnergyFit:
        modes = self.spline.modes[:, 2:]
        own = np.r_[: self.own.start, self.own.stop : self.rows.shape[2]]
        root = modes @ solution.root[own] * widened
        return EnergyFit(
            spline=self.spline,
            angle_rad=self.angle_rad,
            coefficients=modes @ solution.modes[own],
            covariance=root @ root.T,
        )

    def finished(self, solution: Solution, size: Array) -> StepsFit:
        """The answer, widened where neighbours err alike: then there are fewer data than blocks."""
        left = self.residual(solution)
        stretch = np.concatenate([trace.stretch + 1_000_000 * k for k, trace in enumerate(self.traces)])
        same = stretch[1:] == stretch[:-1]
        alike = float((left[:, 1:] * left[:, :-1])[:, same].sum() / max(float((left**2).sum()), 1e-300))
        alike = min(max(alike, 0.0), 0.97)
        widened = float(np.sqrt((1.0 + alike) / (1.0 - alike)))
        own = solution.modes[self.own]
        std = widened * np.linalg.norm(solution.root[self.own], axis=1)
        # What was believed is no surer and no vaguer for what neighbours do.
        std = np.minimum(std, self._std())
        knots = slice(3, 3 + self.knots)
        quarter = max(1, round(0.25 * min(trace.swing for trace in self.traces)))
        count = left.shape[1] // quarter
        paths = tuple(self._paths(own, size * widened))
        return StepsFit(
            energy=self._energy(solution, widened),
            resistance_ohm=float(own[0]),
            resistance_std_ohm=float(std[0]),
            lag_samples=float(own[1]),
            lag_std_samples=float(std[1]),
            loss_v=own[knots],
            loss_std_v=std[knots],
            left_wb=size,
            # At most 120 of them, spread evenly: loops repeat themselves.
            paths=paths[:: max(1, -(-len(paths) // 120))],
            misfit=left[:, : count * quarter].reshape(2, count, quarter).mean(axis=2).T,
        )

    def _paths(self, own: Array, std: Array, shortest: int = 8) -> Iterator[FluxPath]:
        psi = (self.target - self.rows[:, :, self.own] @ own).T
        first = 0
        for trace in self.traces:
            inside = slice(first, first + len(trace.i))
            for swing in _swings(trace):
                if swing.stop - swing.start >= shortest:
                    yield FluxPath(trace.i[swing], psi[inside][swing], std)
            first = inside.stop


def _goes_both_ways(current: Array, share: float = 0.2) -> bool:
    """Whether a current, shape (n, 2), goes about as far in one direction as in the opposite one."""
    longest = current[int(np.argmax(np.linalg.norm(current, axis=1)))]
    along = current @ longest
    return bool(along.min() < -share * along.max())


def _swings(trace: StepTrace, share: float = 0.5) -> Iterator[slice]:
    """The rows of a trace between two turns of its voltage, the blocks left out in which it turns."""
    rate = np.diff(trace.impulse, axis=0)
    jump = np.abs(np.diff(rate, axis=0))
    turned = (jump > share * jump.max(axis=0, initial=1e-300)).any(axis=1)
    cut = np.concatenate([[False], turned, [False]]) | np.concatenate([np.diff(trace.stretch) != 0, [False]])
    edges = np.flatnonzero(cut)
    for before, after in pairwise([-1, *edges.tolist(), len(trace.i)]):
        yield slice(before + 1, after)


def _stretches(traces: Sequence[StepTrace]) -> Iterator[slice]:
    """The rows of each stretch of all traces, one after the other."""
    first = 0
    for trace in traces:
        edges = np.flatnonzero(np.diff(trace.stretch)) + 1
        for start, stop in pairwise([0, *edges.tolist(), len(trace.i)]):
            yield slice(first + start, first + stop)
        first += len(trace.i)


def _covering(current: Array, margin: float = 0.06) -> EvenSpline:
    low, high = current.min(axis=0), current.max(axis=0)
    more = margin * (high - low)
    return EvenSpline(
        float(low[0] - more[0]), float(high[0] + more[0]), float(np.abs(current[:, 1]).max() + more[1]), CELLS
    )


def _unknowns(traces: Sequence[StepTrace]) -> Array:
    """Columns of R_s, lag, angle (left out here), each knot and each segment's bias, shape (n, 2, columns)."""
    blocks = []
    for k, trace in enumerate(traces):
        own = np.zeros((len(trace.i), 2, 3 + trace.losses.shape[1] + 2 * len(traces)))
        own[:, :, 0] = trace.charge
        own[:, :, 1] = -trace.lag
        own[:, :, 3 : 3 + trace.losses.shape[1]] = np.moveaxis(trace.losses, 1, 2)
        bias = 3 + trace.losses.shape[1] + 2 * k
        own[:, 0, bias] = own[:, 1, bias + 1] = trace.time
        blocks.append(own)
    return np.concatenate(blocks)


def _turning(current: Array, psi: Array, inductance: Array) -> Array:
    """Derivative of the flux by the axis' angle, J psi - L J i, shape (n, 2)."""
    aside = np.column_stack([-current[:, 1], current[:, 0]])
    turned = np.column_stack([-psi[:, 1], psi[:, 0]])
    matrix = inductance[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    return np.asarray(turned - np.einsum("nij,nj->ni", matrix, aside))
