"""Flux along one swept current path, by integrating the voltage over time; one capture at a time.

    psi(t) = psi(0) + integral of (v - R_s i - e) dt

(Combes, Malrait, Martin, Rouchon, eq. "timeIntegration"). A voltage error e that depends on the current (an error of
R_s, dead time, device drops) adds with opposite signs on rising and falling branches, so their mean is free of it as
far as both are swept at the same rate. `_voltage_losses` determines e from many sweeps; without it, the error measured
while the current rests is subtracted. `_crossings` joins paths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.analysis._steady_currents import Dwell, mean_over_dwell, rests
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.types import Array
from protocols import Capture, NotMeasuredError


@dataclass(frozen=True)
class FluxPath:
    """Flux along a path in the current plane, up to one constant vector.

    Attributes
    ----------
    current, psi : array, shape (m, 2)
        dq frame [A], [Wb].
    std : array, shape (2,)
        Standard deviation of psi, from the scatter of the branches.
    """

    current: Array
    psi: Array
    std: Array


@dataclass(frozen=True)
class Sweep:
    """Evaluation of one capture of trapezoids.

    Attributes
    ----------
    path : FluxPath
        Mean of rising and falling branches.
    loop_wb : array, shape (2,)
        Largest half distance of rising and falling branch: hysteresis, or a voltage error.
    dwells : tuple of Dwell
        Stretches of constant current.
    """

    path: FluxPath
    loop_wb: Array
    dwells: tuple[Dwell, ...]


@dataclass(frozen=True)
class SweepTrace:
    """One capture of a sweep, averaged over short blocks, dq frame.

    Attributes
    ----------
    where : str
        Name of the segment.
    start_s : float
        Since the start of the experiment.
    i, charge, impulse : array, shape (n, 2)
        Current [A], its integral [As] and the voltage's [Vs].
    steps : array, shape (n, k, 2)
        Voltage integral per volt of inverter error at each knot [s]; k may be zero.
    time : array, shape (n,)
        Since the capture's start [s].
    travel : array, shape (n,)
        Current along `axis`, the swept direction [A].
    axis : array, shape (2,)
    block : int
        Samples.
    period : float
        Blocks.
    dwells : tuple of Dwell
        Stretches of constant current, without the settling after each change.
    angle_rad : float
    """

    where: str
    start_s: float
    i: Array
    charge: Array
    impulse: Array
    steps: Array
    time: Array
    travel: Array
    axis: Array
    block: int
    period: float
    dwells: tuple[Dwell, ...]
    angle_rad: float


def find_dwells(capture: Capture, angle_rad: float, delay: float = 0.0) -> tuple[Dwell, ...]:
    """Stretches of constant current in a sweep, without the settling after each change."""
    return trace_sweep(capture, angle_rad, delay=delay).dwells


def sweep_of(trace: SweepTrace, psi: Array) -> Sweep:
    """Mean path and loop of the flux that was integrated over a trace, shape (n, 2).

    Raises
    ------
    NotMeasuredError
        Where the current is not swept to and fro.
    """
    rising, table = branch_table(trace, np.column_stack([trace.i, psi]))
    steps = np.diff(table, axis=1)
    up, down = _mean(steps[rising]), _mean(steps[~rising])
    # Where only one direction was swept, its steps stand for the mean.
    steps_mean = np.where(np.isnan(up), down, np.where(np.isnan(down), up, 0.5 * (up + down)))
    path = _summed(steps_mean)
    path[:, :2] += _mean(table)[:, :2].mean(axis=0) - path[:, :2].mean(axis=0)
    loop = 0.5 * _summed(np.nan_to_num(up - down))[:, 2:]
    off = np.concatenate([steps[rising] - up, steps[~rising] - down])[:, :, 2:]
    scatter = np.stack([_summed(np.nan_to_num(x)) for x in off])
    repeated = len(table) - 2
    var = (scatter**2).mean(axis=1).sum(axis=0) / repeated if repeated > 0 else (loop**2).mean(axis=0)
    widest = np.abs(loop).max(axis=0)
    # Branches differ in rate: the mean's error is up to 0.4 of the loop's half width.
    std = np.hypot(np.sqrt(var / len(table)), 0.4 * widest)
    return Sweep(FluxPath(path[:, :2], path[:, 2:], std), widest, trace.dwells)


def branch_table(trace: SweepTrace, columns: Array) -> tuple[NDArray[np.bool_], Array]:
    """Columns of a trace at evenly spaced currents of each branch, (branches, levels, k); which branches rise."""
    branches = _branches(trace, columns)
    levels = _levels(branches, trace.where)
    table = np.stack([_interpolated(branch, levels) for branch in branches])
    return np.array([b[-1, 0] > b[0, 0] for b in branches]), table


def _mean(x: Array) -> Array:
    """Mean over the first axis, ignoring NaN; NaN where there is nothing else."""
    valid = ~np.isnan(x)
    count = valid.sum(axis=0)
    out: Array = np.where(count > 0, np.where(valid, x, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
    return out


def _summed(steps: Array) -> Array:
    """Running sum from zero, less its mean."""
    total = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
    out: Array = total - total.mean(axis=0)
    return out


def trace_sweep(
    capture: Capture,
    angle_rad: float,
    *,
    delay: float = 0.0,
    knots_a: Array | None = None,
    where: str = "capture",
    blocks: int = 4000,
) -> SweepTrace:
    """A capture of trapezoids, or of any current swept to and fro, averaged to about `blocks` blocks, with integrals.

    Parameters
    ----------
    capture : Capture
    angle_rad : float
        Believed electrical angle of the d axis.
    delay : float
        n, where v[k] acts from t_k + n Ts.
    knots_a : array, shape (k,), optional
        Knots of the inverter's error over the phase current [A], for its unit integrals.
    where : str
        Name of the segment, for errors.
    blocks : int
    """
    # numba is imported on use, which keeps the import of this module fast
    from orchestrator.analysis._block_means import block_means

    step = 1.0 / capture.sampling_frequency_hz
    block = max(1, len(capture) // blocks)
    n = len(capture) // block
    stator = block_means(capture.i_ab, capture.v_ab, sampling_s=step, delay=delay, block=block)
    means = [to_dq(x, angle_rad) for x in stator]
    spread = np.linalg.eigh(np.cov(means[0].T))[1][:, -1]
    axis = spread * np.sign(spread[np.argmax(np.abs(spread))])
    travel = means[0] @ axis
    period = n / max(1, int(np.argmax(np.abs(np.fft.rfft(travel - travel.mean())))))
    # Dwells without their first third, in which the control still settles.
    flats = ((a + (b - a) // 3, b) for a, b in rests(travel, period))
    return SweepTrace(
        where=where,
        start_s=capture.start_s,
        i=means[0],
        charge=means[1],
        impulse=means[2],
        steps=_steps(capture, angle_rad, knots_a, block, n),
        time=(np.arange(n, dtype=np.float64) + 0.5) * (block * step),
        travel=travel,
        axis=axis,
        block=block,
        period=period,
        dwells=tuple(mean_over_dwell(capture, a * block, b * block, delay) for a, b in flats),
        angle_rad=angle_rad,
    )


def _steps(capture: Capture, angle: float, knots_a: Array | None, block: int, blocks: int) -> Array:
    if knots_a is None:
        return np.zeros((blocks, 0, 2))
    # numba is imported on use, which keeps the import of this module fast
    from orchestrator.analysis._phase_loss_kernels import shape_integrals

    stator = shape_integrals(capture.i_ab, knots_a, 1.0 / capture.sampling_frequency_hz, block, blocks)
    return to_dq(stator.reshape(-1, 2), angle).reshape(stator.shape)


def flux_from_dwells(trace: SweepTrace, resistance: float | None) -> Array:
    """Flux: integral of the voltage less the voltage measured while the current rests, shape (n, 2) [Wb].

    Raises
    ------
    NotMeasuredError
        Where no resistance is given and the dwells do not determine it.
    """
    dwells, where = trace.dwells, trace.where
    if not dwells:
        if resistance is None:
            raise NotMeasuredError(where, "R_s", "the current never rests here, and no resistance was measured")
        flux = trace.impulse - resistance * trace.charge
        # Without dwells the drift follows from zero net flux over a whole number of periods.
        return flux - np.outer(trace.time, (flux[-1] - flux[0]) / (trace.time[-1] - trace.time[0]))
    i = to_dq(np.array([d.i_ab for d in dwells]), trace.angle_rad)
    v = to_dq(np.array([d.v_ab for d in dwells]), trace.angle_rad)
    s = i @ trace.axis
    spread = np.ptp(s) > 0.2 * np.ptp(trace.travel)
    if resistance is None:
        if not spread:
            raise NotMeasuredError(where, "R_s", "the current rests at one level only, and no resistance was measured")
        resistance = float(np.polyfit(s, v @ trace.axis, 1)[0])
    offset_v = v - resistance * i
    design = np.stack([np.ones_like(s), s], axis=1) if spread else np.ones((len(s), 1))
    weight = np.sqrt([d.seconds for d in dwells])[:, None]
    slope = np.zeros((2, 2))
    slope[: design.shape[1]] = np.linalg.lstsq(design * weight, offset_v * weight, rcond=None)[0]
    travelled = trace.charge @ trace.axis
    drop: Array = resistance * trace.charge + np.outer(trace.time, slope[0]) + np.outer(travelled, slope[1])
    return trace.impulse - drop


def _branches(trace: SweepTrace, columns: Array) -> list[Array]:
    """Runs between dwells, in order of time; a row is (travel, *columns)."""
    rows = np.column_stack([trace.travel, columns])
    flats = list(rests(trace.travel, trace.period))
    marks = [_arrival(trace), *(k for flat in flats for k in flat), len(rows)]
    runs = []
    for n, (a, b) in enumerate(zip(marks[::2], marks[1::2], strict=True)):
        # A dwell is one point, its mean: the end of one run and the start of the next.
        head = [rows[slice(*flats[n - 1])].mean(axis=0)] if n > 0 else []
        tail = [rows[slice(*flats[n])].mean(axis=0)] if n < len(flats) else []
        runs.append(np.array([*head, *rows[a:b], *tail]).reshape(-1, rows.shape[1]))
    # A triangle reverses without a dwell, though it may begin and end with one.
    runs = [half for run in runs for half in (_halves(run) if not flats or _reverses(run) else [run])]
    span = np.ptp(trace.travel)
    return [run for run in runs if len(run) > 2 and abs(run[-1, 0] - run[0, 0]) > 0.1 * span]


def _reverses(run: Array) -> bool:
    """Whether a run covers a wider range than from its start to its end."""
    return len(run) > 2 and bool(np.ptp(run[:, 0]) > 1.3 * abs(run[-1, 0] - run[0, 0]))


def _arrival(trace: SweepTrace) -> int:
    """First block on the path; earlier ones were captured on the way to its start."""
    across = trace.i @ np.array([-trace.axis[1], trace.axis[0]])
    first_quarter = max(4, round(trace.period / 4))
    aside = np.abs(across - np.median(across)) > 0.02 * np.ptp(trace.travel)
    fast = np.abs(np.gradient(trace.travel)) > 2.0 * np.quantile(np.abs(np.gradient(trace.travel)), 0.95)
    off = np.flatnonzero((aside | fast)[:first_quarter])
    return 2 * (int(off[-1]) + 1) if len(off) else 0


def _halves(run: Array) -> list[Array]:
    """A run cut at its reversals: the extreme of each stretch on one side of the middle."""
    off = run[:, 0] - 0.5 * (run[:, 0].min() + run[:, 0].max())
    side = np.where(np.abs(off) > 0.1 * np.ptp(off), np.sign(off), 0.0)
    aside = np.flatnonzero(side)
    stays = np.split(aside, np.flatnonzero(np.diff(side[aside])) + 1)
    reversals = [int(stay[np.argmax(np.abs(off[stay]))]) for stay in stays if len(stay)]
    return [half for half in np.split(run, reversals) if len(half) > 2]


def _levels(branches: list[Array], where: str, count: int = 61) -> Array:
    """Evenly spaced levels of the travel within the range of both directions [A]."""
    # A branch ends at its dwells; overshoot beyond them is swept only once.
    ends = [[sorted((b[0, 0], b[-1, 0])) for b in branches if (b[-1, 0] > b[0, 0]) == rises] for rises in (True, False)]
    if not all(ends):
        raise NotMeasuredError(where, "i_alpha, i_beta", "the current is not swept to and fro")
    low = max(min(low for low, _ in pairs) for pairs in ends)
    high = min(max(high for _, high in pairs) for pairs in ends)
    return np.linspace(low, high, count)


def _interpolated(branch: Array, levels: Array) -> Array:
    """Columns of one branch at given travels, shape (m, k), NaN beyond its ends."""
    # Noise makes the travel non-monotonic; sorting averages it.
    ordered = branch[np.argsort(branch[:, 0], kind="stable")]
    out = np.stack([np.interp(levels, ordered[:, 0], ordered[:, k]) for k in range(1, ordered.shape[1])], axis=1)
    slack = 1e-3 * np.ptp(levels)
    out[(levels < ordered[0, 0] - slack) | (levels > ordered[-1, 0] + slack)] = np.nan
    return out
