"""Voltage errors from swept currents alone: at equal currents, all branches of a sweep have equal flux.

Along a sweep psi is a function of the current, so at the same current all branches must agree:

    integral of (v - R_s(t) i - T e(i_abc) - v_0) dt  =  the same on every branch.

R_s is piecewise linear in time between the sweeps' starts, plus a term proportional to the integral of i^2 within a
sweep. That term's factor comes from the rise of R_s from sweep to sweep: within a sweep the term looks like an
inductance. e is one odd function for all phases, linear between knots and constant beyond the last; v_0 is one vector
per sweep. The model is linear and fitted to all sweeps at once. Hysteresis loops have another shape than all of these
terms. Any part of e proportional to i is attributed to R_s by convention.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.analysis._phase_loss import PhaseLoss
from orchestrator.analysis._sweep import SweepTrace, branch_table
from orchestrator.numerics.types import Array

KNOTS: Array = np.array([0.004, 0.01, 0.02, 0.03, 0.045, 0.07, 0.12, 0.25])
"""Knots of e in units of the largest current: dead time acts below some per cent of it."""


@dataclass(frozen=True)
class VoltageLosses:
    """Voltage errors estimated from the loops.

    Attributes
    ----------
    knots_a, error_v : array, shape (k,)
        Voltage error of each phase at these phase currents [V].
    node_s, node_ohm : array, shape (m,)
        R_s at times since the start of the experiment.
    bias_v : dict
        v_0 in the dq frame by segment, shape (2,).
    resistance_per_heat : float
        Slope of R_s over the integral of the squared current [ohm/A^2s]; zero where it is not significant.
    """

    knots_a: Array
    error_v: Array
    node_s: Array
    node_ohm: Array
    bias_v: dict[str, Array]
    resistance_per_heat: float = 0.0

    @property
    def phase(self) -> PhaseLoss:
        """Voltage error of the inverter per phase."""
        return PhaseLoss(self.knots_a, self.error_v)

    def flux(self, trace: SweepTrace) -> Array:
        """Flux: integral of the voltage less all errors, shape (n, 2) [Wb]."""
        resistive = np.einsum("nmx,m->nx", _resistive(trace, self.node_s), self.node_ohm)
        lost = np.einsum("nkx,k->nx", trace.steps, self.error_v)
        warm = self.resistance_per_heat * _resistive_heat(trace)
        psi: Array = trace.impulse - resistive - warm - lost - np.outer(trace.time, self.bias_v[trace.where])
        return psi


def close_loops(traces: list[SweepTrace], knots_a: Array) -> VoltageLosses:
    """Fit R_s(t), e and v_0 so that the branches of every sweep agree at equal currents, least squares.

    Parameters
    ----------
    traces : list of SweepTrace
        Traced with the same `knots_a`, in order of time.

    Raises
    ------
    NotMeasuredError
        Where a current is not swept to and fro.
    """
    losses = _closed(traces, knots_a)
    slope = _heat_slope(traces, losses)
    if slope:
        cooled = [replace(trace, impulse=trace.impulse - slope * _resistive_heat(trace)) for trace in traces]
        losses = replace(_closed(cooled, knots_a), resistance_per_heat=slope)
    return losses


def _closed(traces: list[SweepTrace], knots_a: Array, correlated_levels: float = 10.0) -> VoltageLosses:
    """Voltage losses with R_s linear from sweep to sweep; errors are correlated over some neighbouring levels."""
    starts = np.array([trace.start_s for trace in traces])
    node_s = np.append(starts, starts[-1] + traces[-1].time[-1])
    nodes, knots = len(node_s), len(knots_a)
    shared = nodes + knots
    per_sweep = 4  # v_0, and two inductances for the control error of the other axis' current
    rows, right = [], []
    for n, trace in enumerate(traces):
        equations, target = _branch_difference_equations(trace, node_s)
        design = np.zeros((len(target), shared + per_sweep * len(traces)))
        design[:, :shared] = equations[:, :shared]
        design[:, shared + per_sweep * n : shared + per_sweep * (n + 1)] = equations[:, shared:]
        rows.append(design)
        right.append(target)
    every, target = np.concatenate(rows), np.concatenate(right)
    answer = _least_squares(every, target)
    # The smallest currents are passed too fast: the error at large ones scales the penalty on second differences.
    typical_v = float(np.abs(answer[nodes:shared][knots // 2 :]).max(initial=0.0))
    residual_wb = float(np.sqrt(np.mean((target - every @ answer) ** 2)))
    if typical_v > 0.0:
        curvature = np.zeros((knots, every.shape[1]))
        curvature[:, nodes:shared] = _second_differences(knots_a) * (correlated_levels**0.5 * residual_wb / typical_v)
        answer = _least_squares(np.concatenate([every, curvature]), np.append(target, np.zeros(knots)))
    return VoltageLosses(
        knots_a=knots_a,
        error_v=answer[nodes:shared],
        node_s=node_s,
        node_ohm=answer[:nodes],
        bias_v={trace.where: answer[shared + per_sweep * n :][:2] for n, trace in enumerate(traces)},
    )


def _least_squares(design: Array, target: Array) -> Array:
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    # Undetermined coefficients (knots that no phase current passes) stay zero.
    out: Array = np.linalg.lstsq(design / size, target, rcond=1e-7)[0] / size
    return out


def _second_differences(knots_a: Array) -> Array:
    """Deviation of each value from the straight line between its neighbours, shape (k, k)."""
    place = np.concatenate([[0.0], knots_a, [2.0 * knots_a[-1]]])
    out = np.eye(len(knots_a))
    for k in range(len(knots_a)):
        low, middle, high = place[k : k + 3]
        share = (middle - low) / (high - low)
        if k > 0:
            out[k, k - 1] -= 1.0 - share
        # Beyond the last knot the shape is constant.
        out[k, min(k + 1, len(knots_a) - 1)] -= share
    return out


def _heat(trace: SweepTrace) -> Array:
    """Integral of the squared current [A^2 s], shape (n,)."""
    squares = (trace.i**2).sum(axis=1)
    return np.asarray(np.cumsum(squares) * (trace.time[-1] / len(squares)))


def _resistive_heat(trace: SweepTrace) -> Array:
    """Integral of i (heat - its linear trend) dt, shape (n, 2)."""
    heat = _heat(trace)
    uneven = heat - np.interp(trace.time, trace.time[[0, -1]], heat[[0, -1]])
    return np.cumsum(uneven[:, None] * np.diff(trace.charge, axis=0, prepend=np.zeros((1, 2))), axis=0)


def _heat_slope(traces: list[SweepTrace], losses: VoltageLosses, min_sweeps: int = 6, min_sigmas: float = 4.0) -> float:
    """Slope of R_s over the heat, from its nodes: dR = rise i^2 dt - (R - R_0) dt / tau, least squares."""
    # Zero with fewer sweeps than twice the unknowns, and below `min_sigmas` standard deviations.
    if len(traces) < min_sweeps:
        return 0.0
    intervals_s = np.diff(losses.node_s)
    heat = np.array([_heat(trace)[-1] / trace.time[-1] for trace in traces]) * intervals_s
    middle = 0.5 * (losses.node_ohm[1:] + losses.node_ohm[:-1])
    design = np.stack([heat, intervals_s, middle * intervals_s], axis=1)
    size = np.linalg.norm(design, axis=0)
    answer, squares, rank, _ = np.linalg.lstsq(design / size, np.diff(losses.node_ohm), rcond=1e-10)
    if rank < 3:
        return 0.0
    variance = float(squares[0]) / (len(traces) - 3) * np.linalg.inv((design / size).T @ (design / size))[0, 0]
    return float(answer[0] / size[0]) if answer[0] > min_sigmas * np.sqrt(variance) else 0.0


def _resistive(trace: SweepTrace, node_s: Array) -> Array:
    """Integral of the current, weighted by each node's share in R_s(t), shape (n, nodes, 2)."""
    time = trace.start_s + trace.time
    shares = np.stack([np.interp(time, node_s, share) for share in np.eye(len(node_s))], axis=1)
    steps = np.diff(trace.charge, axis=0, prepend=np.zeros((1, 2)))
    return np.cumsum(shares[:, :, None] * steps[:, None, :], axis=0)


def _branch_difference_equations(trace: SweepTrace, node_s: Array) -> tuple[Array, Array]:
    """Each branch less the branches' mean: matrix of (R nodes, knots, v_0, L across), right-hand side."""
    resistive = _resistive(trace, node_s)
    nodes, knots, n = resistive.shape[1], trace.steps.shape[1], len(trace.time)
    columns = [trace.impulse, resistive.reshape(n, -1), trace.steps.reshape(n, -1), trace.time[:, None], trace.i]
    table = branch_table(trace, np.column_stack(columns))[1]
    missing: NDArray[np.bool_] = np.asarray(np.isnan(table).any(axis=2))
    valid = (~missing)[:, :, None]
    count = np.maximum(valid.sum(axis=0), 1)
    delta = np.where(valid, table - np.where(valid, table, 0.0).sum(axis=0) / count, 0.0).reshape(-1, table.shape[2])
    delta = delta[~missing.ravel()]
    paired = delta[:, 2 : 2 + 2 * (nodes + knots)].reshape(len(delta), nodes + knots, 2)
    out = np.zeros((len(delta), 2, nodes + knots + 4))
    out[:, :, : nodes + knots] = paired.transpose(0, 2, 1)
    time, i = delta[:, -3], delta[:, -2:]
    across = i @ np.array([-trace.axis[1], trace.axis[0]])
    for x in range(2):
        out[:, x, nodes + knots + x] = time
        out[:, x, nodes + knots + 2 + x] = across
    return out.reshape(2 * len(delta), -1), delta[:, :2].ravel()
