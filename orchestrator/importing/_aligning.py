"""Align two loggers' clocks: the slope of a winding's current changes where the voltage has an edge.

    i[k+2] - 2 i[k+1] + i[k] = g (v[k+1] - v[k])

Correlation locates windows of the current in the whole voltage log. Windows of a periodic injection sequence match at
several places; block means then decide, as current and voltage means are proportional. The lags of single windows give
the clock drift, and the winding's equation gives fractions of a sample.
The clock offset includes the drive's delay, since the data do not separate the two.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._signals import CurrentSignal, VoltageSignal
from orchestrator.importing._source import Numbers
from orchestrator.importing._timing import held_means, resampled
from orchestrator.importing._vectors import vectors
from protocols import InputError

Complex = NDArray[np.complex128]
Track = tuple[Numbers, Numbers]
"""Stamps [s] of shape (n,), and vectors of shape (n, 2)."""


@dataclass(frozen=True)
class _Criteria:
    """Thresholds for accepting that two logs cover the same time."""

    shortest_step_s: float = 5e-5
    """Finer steps only amplify noise in the second difference; edges are further apart on any bench."""
    windows: int = 12
    """Number of current windows to locate in the voltage."""
    samples: int = 8192
    """Window length, long enough to contain a pattern that does not repeat."""
    min_margin: float = 20.0
    """Smallest log-likelihood margin of the offset over any other; noise produces far less."""
    min_explained: float = 0.3
    """Share of the second difference's energy that voltage edges have to explain; without edges it is noise."""
    alternative: float = 0.5
    """Fraction of the best offset's log-likelihood from which another offset is a candidate."""
    block: int = 256
    """Samples per block mean: several periods of an injection."""
    min_mean_residual: float = 1e-2
    """Share of the means that resistance alone does not explain: dead time and changing currents."""
    max_mean_ratio: float = 4.0
    """Ratio to the smallest residual of the means from which an offset is rejected."""
    max_drift: float = 3e-4
    """Largest relative clock drift: three times that of poor crystals."""


_CRITERIA = _Criteria()


@dataclass(frozen=True)
class _Clock:
    """Maps the voltage's time stamps t to the current's clock: t + offset_s + drift (t - start_s)."""

    offset_s: float
    drift: float
    start_s: float

    def of(self, voltage_s: Numbers) -> Numbers:
        return voltage_s + self.offset_s + self.drift * (voltage_s - self.start_s)

    def later(self, late_s: float, slope: float, at_s: float) -> _Clock:
        """Moved by late_s + slope (t - at_s), t on the current's clock."""
        moved_s = late_s + slope * (self.start_s + self.offset_s - at_s)
        return _Clock(self.offset_s + moved_s, (1.0 + self.drift) * (1.0 + slope) - 1.0, self.start_s)

    def back(self, current_s: Numbers) -> Numbers:
        return self.start_s + (current_s - self.offset_s - self.start_s) / (1.0 + self.drift)


def fitted_clock(
    path: Path,
    other: Path,
    mapping: ImportMapping,
    columns: tuple[Mapping[str, Numbers], Mapping[str, Numbers]],
    stamps: tuple[Numbers, Numbers],
) -> tuple[Numbers, str]:
    """The time stamps of the file `other` on the clock of `path`, and a remark for the report.

    Parameters
    ----------
    columns, stamps : pairs
        Those of `path` and of `other`. One has all columns of the current, the other all of the voltage.

    Raises
    ------
    InputError
        Where the columns are divided otherwise, or the edges determine no single offset.
    """
    current_is_there = set(mapping.current.columns.values()) <= columns[1].keys()
    which = (1, 0) if current_is_there else (0, 1)
    i_s, v_s = (stamps[k] for k in which)
    i = _vectors(other, mapping.current, mapping, columns[which[0]])
    v = _vectors(other, mapping.voltage, mapping, columns[which[1]])
    known = np.isfinite(i_s)
    i_s, i = i_s[known], i[known]
    step_s = max(_step(i_s), _step(v_s), _CRITERIA.shortest_step_s)
    clock, begins_s = _coarse_clock(other, (i_s, i), (v_s, v), step_s)
    ohm = mapping.motor.stator_resistance_ohm or 0.0
    for _ in range(3):
        clock = clock.later(*_delay((i_s, i), (clock.of(v_s), v), begins_s, ohm, step_s))
    late_s, slope, _ = _delay((i_s, i), (clock.of(v_s), v), begins_s, ohm, step_s)
    if abs(late_s) + 0.5 * abs(slope) * float(np.ptp(i_s)) > 0.5 * step_s:
        raise InputError(
            str(other), "align", "no offset and drift between the clocks fits the voltage's edges throughout"
        )
    remark = (
        f"{other}: aligned to {path.name} by voltage edges: offset {clock.offset_s:.6g} s, "
        f"drift {1e6 * clock.drift:.1f} ppm (includes any delay of the drive)"
    )
    return (clock.back(stamps[1]) if current_is_there else clock.of(stamps[1])), remark


def _vectors(
    other: Path, signal: CurrentSignal | VoltageSignal, mapping: ImportMapping, columns: Mapping[str, Numbers]
) -> Numbers:
    if not set(signal.columns.values()) <= columns.keys() or (signal.angle is not None and signal.angle.column):
        raise InputError(
            str(other), "align", "edges need all columns of the current in one file, all of the voltage in the other"
        )
    rows = columns[next(iter(signal.columns.values()))].size
    dc_v = np.full(rows, mapping.drive.dc_bus_voltage_v)
    return np.nan_to_num(vectors(signal, columns, 0.0, mapping.motor.pole_pairs, dc_v))


def _coarse_clock(other: Path, current: Track, voltage: Track, step_s: float) -> tuple[_Clock, Numbers]:
    """The clock from a joint search over all windows, refined by window; and the windows' start times [s]."""
    (i_s, i), (v_s, v) = current, voltage
    i_even = _complex(resampled(i_s, i, 1.0 / step_s))
    grid = v_s[0] + step_s * np.arange(int((v_s[-1] - v_s[0]) / step_s) + 1)
    v_even = _complex(held_means(v_s, v, grid))
    curvature, voltage_steps = np.diff(i_even, 2), np.diff(v_even)
    samples = min(_CRITERIA.samples, curvature.size)
    starts = _most_active_windows(curvature, samples)
    residuals = [_unexplained(voltage_steps, curvature[start : start + samples]) for start in starts]
    reaches = [1 + int(_CRITERIA.max_drift * abs(start - np.median(starts))) for start in starts]
    stamped = i_s[0] + step_s * np.arange(i_even.size)
    pauses = np.diff(i_s, prepend=-np.inf)[np.minimum(np.searchsorted(i_s, stamped), i_s.size - 1)] > 1.5 * step_s
    i_even[1:][pauses[1:]] = np.nan
    lag, margin = _most_likely_lag(residuals, starts, reaches, samples, i_even, v_even)
    if margin < _CRITERIA.min_margin:
        raise InputError(str(other), "align", "the voltage's edges fit the current at more than one offset, or at none")
    positions, lags, explained = [], [], []
    for start, residual, reach in zip(starts, residuals, reaches, strict=True):
        expected = start + lag + samples - 1
        low = max(expected - reach - 2, 1)
        nearby = residual[low : expected + reach + 3]
        if nearby.size:
            place = low + int(np.argmin(nearby))
            positions.append(float(start))
            lags.append(_vertex(residual, place) - (samples - 1) - start)
            explained.append(1.0 - float(residual[place]))
    used = np.array(explained) > 0.5 * max(explained)
    starts_used = np.array(positions)[used]
    slope, at_zero = _line(starts_used, np.array(lags)[used])
    offset_s = i_s[0] - v_s[0] - (1.0 - slope) * at_zero * step_s
    return _Clock(offset_s, -slope, v_s[0]), i_s[0] + step_s * starts_used


def _line(x: Numbers, y: Numbers) -> tuple[float, float]:
    """Slope and y(0) of a robust line (Theil-Sen estimator); zero slope with fewer than three points."""
    from scipy.stats import theilslopes

    if x.size < 3:
        return 0.0, float(np.median(y))
    found = theilslopes(y, x)
    return float(found[0]), float(found[1])


def _delay(current: Track, voltage: Track, begins_s: Numbers, ohm: float, step_s: float) -> tuple[float, float, float]:
    """Residual delay of the voltage [s], its slope, and their reference time [s], from the given windows."""
    (i_s, i), (v_s, v) = current, voltage
    delays = []
    for begin in begins_s:
        grid = np.arange(begin, min(begin + _CRITERIA.samples * step_s, i_s[-1]), step_s)
        first, end = np.searchsorted(v_s, [grid[0] - 3.0 * step_s, grid[-1] + 3.0 * step_s])
        if grid.size > 2 and end - first > 2:
            samples = _complex(np.column_stack([np.interp(grid, i_s, x) for x in i.T]))
            delay_s = _subsample_delay(samples, grid, v_s[first:end], v[first:end], ohm, step_s)
            delays.append((0.5 * (grid[0] + grid[-1]), delay_s))
    if not delays:
        return 0.0, 0.0, 0.0
    times, late_s = np.array(delays).T
    middle = float(np.mean(times))
    slope, at_middle = _line(times - middle, late_s)
    return at_middle, slope, middle


def _subsample_delay(i: Complex, grid: Numbers, v_s: Numbers, v: Numbers, ohm: float, step_s: float) -> float:
    """Sub-sample delay of the voltage [s] that best explains the current's increments."""
    # Each trial shift integrates the volt-seconds again, since a sample's mean hides the position of an edge in it. The
    # resistance is the nameplate's: on a rotating current, a free one is indistinguishable from a delay.
    steps, mean_i = np.diff(i), 0.5 * (i[:-1] + i[1:])

    def cost(late_s: float) -> float:
        u = _complex(held_means(v_s + late_s, v, grid)) - ohm * mean_i
        # Conjugates express the symmetric inductance matrix of a salient machine.
        columns = np.stack([a - a.mean() for a in (u, u.conj(), 1j * u.conj())])
        gram, projection = (columns @ columns.conj().T).real, (columns @ (steps - steps.mean()).conj()).real
        return -float(np.linalg.lstsq(gram, projection, rcond=1e-12)[0] @ projection)

    middle = 0.0
    for width in (1.0, 0.25, 0.05):
        tried = middle + width * np.linspace(-1.0, 1.0, 9)
        costs = np.array([cost(x * step_s) for x in tried])
        place = _vertex(costs, int(np.argmin(costs)))
        middle = float(tried[0] + place * (tried[1] - tried[0]))
    return middle * step_s


def _most_active_windows(curvature: Complex, samples: int) -> NDArray[np.intp]:
    """Starts of the windows with the largest second-difference energy, in order of time."""
    starts = np.unique(np.append(np.arange(0, curvature.size - samples, samples // 2), curvature.size - samples))
    power = np.concatenate([[0.0], np.cumsum(np.abs(curvature) ** 2)])
    best = np.argsort(power[starts] - power[starts + samples])[: _CRITERIA.windows]
    return np.sort(starts[best])


def _unexplained(voltage_steps: Complex, window: Complex) -> Numbers:
    """Share of the window's second difference that edges leave unexplained at each lag, over their overlap."""
    from scipy.signal import correlate

    product = np.maximum(correlate(voltage_steps, window, method="fft").real, 0.0)
    ends = np.arange(1, voltage_steps.size + window.size)
    step_energy = _within(voltage_steps, ends - window.size, ends)
    window_energy = _within(window, window.size - ends, voltage_steps.size + window.size - ends)
    floor = 1e-6 * float(np.vdot(window, window).real) * max(float(np.max(step_energy)), 1e-300)
    residual = 1.0 - product**2 / np.maximum(step_energy * window_energy, floor)
    return np.maximum(residual, 1e-9)


def _within(x: Complex, begins: NDArray[np.intp], ends: NDArray[np.intp]) -> Numbers:
    """Energy of x in each range [begin, end), clipped to x."""
    energy = np.concatenate([[0.0], np.cumsum(np.abs(x) ** 2)])
    return np.asarray(energy[np.clip(ends, 0, x.size)] - energy[np.clip(begins, 0, x.size)])


def _most_likely_lag(
    residuals: Sequence[Numbers],
    starts: NDArray[np.intp],
    reaches: Sequence[int],
    samples: int,
    current: Complex,
    voltage: Complex,
) -> tuple[int, float]:
    """The most likely lag by all windows and the means, and its log-likelihood margin over the next."""
    # Likelihoods count per overlapping sample, so the begin and end of a log have no influence.
    from scipy.ndimage import minimum_filter1d
    from scipy.signal import find_peaks

    curvature_count, step_count = current.size - 2, voltage.size - 1
    log_residual, overlap = np.zeros((2, step_count + curvature_count + 2 * samples))
    ends = np.arange(1, step_count + samples)
    covered = np.minimum(ends, step_count) - np.maximum(ends - samples, 0)
    for residual, start, reach in zip(residuals, starts, reaches, strict=True):
        span = slice(curvature_count - start, curvature_count - start + residual.size)
        # The filter allows the drift that clocks accumulate up to this window.
        log_residual[span] += 0.5 * covered * np.log(minimum_filter1d(residual, 2 * reach + 1, mode="nearest"))
        overlap[span] += covered
    mean = np.where(overlap > 0.5 * overlap.max(), log_residual / np.maximum(overlap, 1.0), 0.0)
    best, distance = float(mean.min()), 3 + max(reaches)
    if max(1.0 - float(np.min(residual)) for residual in residuals) < _CRITERIA.min_explained:
        return 0, 0.0
    height = -_CRITERIA.alternative * best
    places, _ = find_peaks(np.concatenate([[0.0], -mean, [0.0]]), height=height, distance=distance)
    lags = [int(place) - 1 - curvature_count - (samples - 1) for place in places]
    mean_residuals = np.array([_unexplained_by_means(current, voltage, lag) for lag in lags])
    depths = np.where(mean_residuals <= _CRITERIA.max_mean_ratio * mean_residuals.min(), mean[places - 1], 0.0)
    first = int(np.argmin(depths))
    others = np.append(np.delete(depths, first), _CRITERIA.alternative * best)
    return lags[first], float(others.min() - depths[first]) * float(overlap[places[first] - 1])


def _unexplained_by_means(current: Complex, voltage: Complex, lag: int) -> float:
    """Share of the block means that no resistance explains at a lag; NaN marks a pause."""
    first, end = max(0, -lag), min(current.size, voltage.size - lag)
    rows = max(end - first, 0) // _CRITERIA.block * _CRITERIA.block
    i, v = (x[:rows].reshape(-1, _CRITERIA.block).mean(axis=1) for x in (current[first:], voltage[first + lag :]))
    valid = np.isfinite(i)
    if np.count_nonzero(valid) < 3:
        return 1.0
    i, v = i[valid], v[valid]
    power = float(np.vdot(i, i).real * np.vdot(v, v).real)
    product = max(float(np.vdot(i, v).real), 0.0)
    return max(1.0 - product**2 / max(power, 1e-300), _CRITERIA.min_mean_residual)


def _vertex(values: Numbers, place: int) -> float:
    """Vertex of the parabola through a minimum and its two neighbours."""
    if not 0 < place < values.size - 1:
        return float(place)
    left, lowest, right = values[place - 1 : place + 2]
    curvature = left - 2.0 * lowest + right
    return place + float(np.clip(0.5 * (left - right) / curvature, -0.5, 0.5)) if curvature > 0.0 else float(place)


def _step(time_s: Numbers) -> float:
    return float(np.median(np.diff(time_s)))


def _complex(x: Numbers) -> Complex:
    return np.asarray(x[:, 0] + 1j * x[:, 1])
