"""A segment as float64 signals with its windows and the scatter of its readings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from orchestrator.analysis import count_reversals
from orchestrator.diagnosis.criteria import Criteria, WeakFormCriteria
from orchestrator.diagnosis.weak_form.sensor_scatter import (
    Scatter,
    repeats,
    scatter_beside_answer,
    scatter_between,
    scatter_of,
)
from orchestrator.diagnosis.weak_form.windows import Windows, periodic_windows, plain_windows
from orchestrator.numerics.frames import from_phases, from_two_phases, to_dq, to_phases
from orchestrator.numerics.kernels import delayed_means
from orchestrator.numerics.types import Array
from protocols import (
    Capture,
    Manifest,
    ModulatorTimer,
    RealArray,
    RecordingReader,
    Remark,
    Segment,
    SegmentStage,
    Signals,
)
from protocols.fleet_priors import FleetPriors

MIN_TEST_FUNCTIONS_PER_TRAPEZOID: int = 8
"""Minimum number of test functions in a trapezoid of a sweep; in a short trapezoid they are shortened."""
MIN_SAMPLES_PER_TEST_FUNCTION: int = 8
"""Minimum number of samples between the centres of two test functions of a trapezoid."""
TEST_FUNCTIONS_PER_VOLTAGE_STEP: float = 4.0
"""Test functions between two voltage steps: a lag is visible in the first, R_s in the others."""
MIN_SAMPLES_PER_STEP_TEST_FUNCTION: float = 2.0
"""Samples between two test functions of voltage steps; with fewer, neighbours carry the same information."""
TEST_FUNCTIONS_PER_TURN: int = 8
"""Test functions per turn of an injected direction: the flux along it has two periods, with two per half period."""
MIN_PERIODS_PER_TEST_FUNCTION: int = 4
"""Injection periods between two test functions; with fewer, the Fourier modes of a period are not separable."""
MIN_SAMPLES_PER_PERIOD: int = 4
"""Samples in an injection period; with fewer, its edges cannot be resolved."""
MAX_BINS_PER_PERIOD: int = 40
"""Bins of an injection period; modes up to the fifth need no more."""
MIN_SEGMENT_SAMPLES: int = 17
"""Readings below which a segment is not used: a test function extends over eight on either side."""
INITIAL_READINGS: int = 5
"""Readings averaged for the current before a segment."""
MIN_SWING_RATIO_OF_DIAGONAL: float = 0.5
"""Ratio of the smaller to the larger axis' current swing from which a sweep counts as one of both axes."""
MIN_AVERAGED_SAMPLES: int = 200
"""Minimum number of averaged samples of a segment."""
Axis = Literal["d", "q", "dq"]
AXES: tuple[Axis, ...] = ("d", "q", "dq")
_ZERO_TOLERANCE = 1e-6
"""Largest current and voltage of an unread axis relative to the other's; rotated single precision leaves 1e-7."""


@dataclass(frozen=True)
class SegmentData:
    """One segment.

    Attributes
    ----------
    segment : Segment
    held_out : bool
        Whether it is excluded from all fits, for validation.
    signals : Signals
        Measured and commanded signals; `resistance_ohm` is 1, a factor on R_s.
        In slow stages each sample is the mean of `averaged` readings, at the middle of their times.
    windows : Windows
    scatter : Scatter
        Scatter of the current readings.
    averaged : int
    before_ab : array, shape (2,)
        Mean of the first readings without ripple: the current before the segment [A].
    current_ab : array, shape (readings, 2)
        Unaveraged current readings [A].
    command_ab : array, shape (readings, 2)
        Unaveraged voltage commands [V].
    delay_samples : float
        Delay of the voltage behind its command.
    """

    segment: Segment
    held_out: bool
    signals: Signals
    windows: Windows
    scatter: Scatter
    averaged: int
    before_ab: Array
    current_ab: Array
    command_ab: Array
    delay_samples: float

    @property
    def stage(self) -> SegmentStage:
        return self.segment.stage


@dataclass(frozen=True)
class PreparedRecording:
    """A recording as the diagnosis uses it."""

    manifest: Manifest
    pieces: tuple[SegmentData, ...]
    remarks: tuple[Remark, ...]
    criteria: Criteria
    fleet: FleetPriors | None = None
    """Priors from other motors of this type."""
    quantiser: ModulatorTimer | None = None
    """The timer whose rounding the segments' voltages include."""
    ripples: bool = False
    """Whether current ripple within a carrier period matters for the resistive drop."""

    @property
    def rows(self) -> tuple[int, ...]:
        """Number of equations of each segment."""
        return tuple(piece.windows.rows for piece in self.pieces)

    @property
    def current_range(self) -> tuple[float, float, float]:
        """Lowest and highest i_d and highest |i_q| in the believed frame, without gates-off segments [A]."""
        low, high, q = 0.0, 0.0, 0.0
        for piece in self.pieces:
            if piece.stage is SegmentStage.GATES_OFF:
                continue
            i_d, i_q = to_dq(piece.signals.i_ab, piece.segment.rotor_angle_rad).T
            low, high = min(low, float(i_d.min())), max(high, float(i_d.max()))
            q = max(q, float(np.abs(i_q).max()))
        return low, high, q


def read_segment(
    recording: RecordingReader, segment: Segment, samples: int | None, criteria: WeakFormCriteria
) -> SegmentData | None:
    """The signals and windows of a segment; None where it is too short for one."""
    drive = recording.manifest.drive
    capture = recording.load(segment)
    fs = drive.sampling_frequency_hz
    i_ab = np.ascontiguousarray(capture.i_ab[:samples], dtype=np.float64)
    current_ab, command_ab = i_ab, np.ascontiguousarray(capture.v_ab[:samples], dtype=np.float64)
    delay = drive.voltage_delay_samples or 0.0
    v_ab = mean_between(command_ab, 1, delay)
    v_dc = np.asarray(capture.v_dc[:samples], dtype=np.float64)
    if len(i_ab) < MIN_SEGMENT_SAMPLES:
        return None
    ripple = segment.stage is SegmentStage.INJECTION
    scatter = _scatter(segment, fs, i_ab, v_ab)
    # An injected ripple moves the current at once; the drive had settled at its mean.
    before, start = (i_ab if ripple else i_ab[:INITIAL_READINGS]).mean(axis=0), segment.start_s
    width = _width(segment.stage, i_ab, 0.0 if ripple else math.sqrt(float(np.trace(scatter.covariance))), criteria)
    if width > 1:
        i_ab, v_dc = block_means(i_ab, width), block_means(v_dc[:, None], width)[:, 0]
        v_ab = mean_between(command_ab, width, delay)
        start, fs = start + 0.5 * (width - 1) / fs, fs / width
    windows = windows_of(segment, fs, i_ab, v_ab, criteria)
    if windows is None:
        return None
    windows = replace(windows, unread=unread_axis(segment, current_ab, command_ab))
    n = len(i_ab)
    pwm = segment.settings.get("pwm_frequency_hz") or drive.pwm_frequency_hz or drive.sampling_frequency_hz
    signals = Signals(
        start_s=start,
        sampling_frequency_hz=fs,
        pwm_frequency_hz=float(pwm),
        i_ab=i_ab,
        v_ab=v_ab,
        v_late_ab=late_beside(command_ab, delay) if width == 1 else None,
        v_dc=v_dc,
        theta_rad=np.full(n, float(segment.rotor_angle_rad)),
        resistance_ohm=np.ones(n),
        i_m_ab=i_ab,
        heat_j=np.zeros(n),
        motor=recording.manifest.motor,
        drive=drive,
        bridge_on=segment.stage is not SegmentStage.GATES_OFF,
        largest_command_abc=largest_command(command_ab, width) if width > 1 else None,
        **logged_fields(capture, n, width),
    )
    diagonal = segment.stage is SegmentStage.CLASSICAL and swept_axis(segment, i_ab) == "dq"
    return SegmentData(segment, diagonal, signals, windows, scatter, width, before, current_ab, command_ab, delay)


def _scatter(segment: Segment, fs: float, i_ab: Array, v_ab: Array) -> Scatter:
    """Scatter of a segment's readings, from differences that its voltage does not cause."""
    if segment.stage is SegmentStage.STEPS:
        return scatter_between(i_ab, v_ab)
    period = injection_period(segment, fs, v_ab) if segment.stage is SegmentStage.INJECTION else None
    if period is not None and not repeats(v_ab, period):
        return scatter_beside_answer(i_ab, v_ab)
    return scatter_of(i_ab, period, steady=segment.stage in (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE))


def _width(stage: SegmentStage, i_ab: Array, noise_a: float, criteria: WeakFormCriteria) -> int:
    """Number of readings of a slow stage to average, such that the current hardly changes between means."""
    slow = stage in (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE)
    max_width = criteria.most_averaged_at_rest if slow else criteria.most_averaged_in_sweeps
    max_width = min(max_width, len(i_ab) // MIN_AVERAGED_SAMPLES)
    if max_width < 2 or stage in (SegmentStage.INJECTION, SegmentStage.STEPS):
        return 1
    # Means of 32 readings suppress noise; the quantile ignores a jump at the start of a capture.
    length = len(i_ab) // 32 * 32
    means = i_ab[:length].reshape(-1, 32, 2).mean(axis=1)
    usual = float(np.quantile(np.abs(np.diff(means, axis=0)).max(axis=1), 0.95)) / 32.0
    allowed = max(criteria.averaged_step * float(np.abs(means).max()), criteria.averaged_noise * noise_a)
    return int(min(max_width, max(1.0, allowed / max(usual, 1e-12))))


def mean_between(command_ab: Array, width: int, delay_samples: float) -> Array:
    """The voltage that acts between the middles of means of `width` readings, shape (readings // width, 2).

    With a width of one, the mean voltage over [t_k, t_k+1) when each command is delayed by so many samples.

    dpsi/dt = v - R i holds for means as for samples: the mean currents of successive blocks differ by the voltage's
    integral, where each v_k of 2 width - 1 intervals is weighted by the share of readings that it moves.
    """
    if width == 1 and delay_samples == 0.0:
        return command_ab
    late_by = math.floor(delay_samples)
    commands = np.ascontiguousarray(command_ab, dtype=np.float64)
    return np.asarray(delayed_means(commands, width, late_by, delay_samples - late_by), dtype=np.float64)


def largest_command(command_ab: Array, width: int) -> Array:
    """Part of each block of readings before which phase a, b, c had the largest command, (readings // width, 3)."""
    before = np.argmax(to_phases(command_ab), axis=1)
    before[1:] = before[:-1].copy()
    return block_means(np.eye(3)[before], width)


def block_means(x: Array, width: int) -> Array:
    """Means of blocks of `width` rows; an incomplete last block is dropped."""
    blocks = len(x) // width
    return np.asarray(x[: blocks * width].reshape(blocks, width, -1).mean(axis=1), dtype=np.float64)


def swept_axis(segment: Segment, i_ab: RealArray) -> Axis:
    """The axis along which a sweep moves the current: from its metadata, else from the currents."""
    stated = segment.settings.get("swept_axis")
    for axis in AXES:
        if stated == axis:
            return axis
    swing_d, swing_q = np.ptp(to_dq(i_ab, segment.rotor_angle_rad), axis=0)
    if min(swing_d, swing_q) > MIN_SWING_RATIO_OF_DIAGONAL * max(swing_d, swing_q):
        return "dq"
    return "d" if swing_d > swing_q else "q"


def unread_axis(segment: Segment, i_ab: RealArray, v_ab: RealArray) -> int | None:
    """The axis (0: d, 1: q) whose current and voltage are zeros throughout, so written instead of measured; or None."""
    size = np.array([np.abs(to_dq(x, segment.rotor_angle_rad)).max(axis=0) for x in (i_ab, v_ab)])
    nothing = np.flatnonzero((size <= _ZERO_TOLERANCE * size.max(axis=1, keepdims=True)).all(axis=0))
    return int(nothing[0]) if len(nothing) == 1 else None


def windows_of(
    segment: Segment, fs: float, i_ab: RealArray, v_ab: RealArray, criteria: WeakFormCriteria
) -> Windows | None:
    """The windows that suit a segment's stage; None where it is too short for one.

    One test function for a dwell, overlapping ones for a sweep and within each voltage step, and for injection test
    functions times the Fourier modes of a period.
    """
    intervals = len(i_ab) - 1
    if segment.stage in (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE):
        return plain_windows(intervals, intervals / 2)
    if segment.stage is SegmentStage.STEPS:
        swing = intervals / (count_reversals(np.asarray(v_ab, dtype=np.float64)) + 1)
        return plain_windows(
            intervals, max(swing / TEST_FUNCTIONS_PER_VOLTAGE_STEP, MIN_SAMPLES_PER_STEP_TEST_FUNCTION)
        )
    period = injection_period(segment, fs, v_ab) if segment.stage is SegmentStage.INJECTION else None
    if period is None:
        shorter = max(intervals / MIN_TEST_FUNCTIONS_PER_TRAPEZOID, MIN_SAMPLES_PER_TEST_FUNCTION)
        return plain_windows(intervals, min(criteria.hat_s * fs, shorter))
    turn_s = 1.0 / float(segment.settings.get("rotation_hz") or 1.0)
    step = min(turn_s / TEST_FUNCTIONS_PER_TURN * fs, intervals / 4)
    return periodic_windows(intervals, max(step, MIN_PERIODS_PER_TEST_FUNCTION * period), period, MAX_BINS_PER_PERIOD)


def injection_period(segment: Segment, fs: float, v_ab: RealArray) -> float | None:
    """Samples in an injection period: from the set point, else from the spacing of the voltage's strongest lines."""
    requested = segment.settings.get("frequency_hz")
    highest = fs / MIN_SAMPLES_PER_PERIOD
    if isinstance(requested, int | float) and 0 < requested < highest:
        return fs / float(requested)
    n = len(v_ab)
    vectors = v_ab[:, 0] + 1j * v_ab[:, 1]
    spectrum = np.abs(np.fft.fft((vectors - vectors.mean()) * np.hanning(n)))
    ahead = int(np.argmax(spectrum[1 : n // 2])) + 1
    behind = int(np.argmax(spectrum[: n // 2 : -1])) + 1
    frequency = 0.5 * (ahead + behind) * fs / n
    # A line within a Hann window's width of zero belongs to the mean.
    return fs / frequency if 4.0 * fs / n < frequency < highest else None


def late_beside(v_ab: Array, samples: float) -> Array | None:
    """The delayed voltage at t_k+1 minus its mean since t_k; None where it is constant between samples."""
    late_by = math.floor(samples)
    if samples == late_by:
        return None
    return np.ascontiguousarray((samples - late_by) * (_late(v_ab, late_by) - _late(v_ab, late_by + 1)))


def _late(v_ab: Array, rows: int) -> Array:
    return v_ab[np.maximum(np.arange(len(v_ab)) - rows, 0)]


_ROWS_COMPARED = 2000
"""Rows compared to find the readings from which a vector was computed."""
_LOG_ROUNDING = 1e-3
"""Relative deviation of a vector from its readings that the rounding of a log explains."""
_SINGLE_PRECISION_ROUNDING = 1e-6
"""Relative deviation that single precision explains."""


def logged_fields(capture: Capture, rows: int, width: int) -> dict[str, Any]:
    """The optional fields of `Signals`.

    Parameters
    ----------
    rows : int
        Number of rows of the signals.
    width : int
        Readings averaged in each row.
    """
    found: dict[str, Any] = {}
    if capture.i_abc is not None:
        found["i_abc"] = _means(capture.i_abc, rows, width)
        found["clarke_of_three"] = clarke_of_three(capture.i_ab, capture.i_abc)
    if capture.temperature_c is not None:
        found["temperature_c"] = _means(capture.temperature_c, rows, width)
    return found


def clarke_of_three(i_ab: RealArray, i_abc: RealArray) -> bool | None:
    """Whether vectors (n, 2) were computed from three readings (n, 3), or from a and b alone; None: from neither.

    A third current that was computed from the other two is no reading: the result is False.
    """
    rows = slice(None, None, max(1, len(i_ab) // _ROWS_COMPARED))
    vector, phases = i_ab[rows], i_abc[rows]
    off_three = float(np.abs(vector - from_phases(phases)).max())
    off_two = float(np.abs(vector - from_two_phases(phases[:, 0], phases[:, 1])).max())
    size = float(np.abs(vector).max())
    if _SINGLE_PRECISION_ROUNDING * size < off_two and off_three < 0.1 * off_two:
        return True
    return False if off_two <= _LOG_ROUNDING * size else None


def since_the_start(signals: Sequence[Signals]) -> list[Signals]:
    """Signals in temporal order, each with the first logged temperature."""
    first = next((float(s.temperature_c[0]) for s in signals if s.temperature_c is not None), None)
    return list(signals) if first is None else [replace(s, start_temperature_c=first) for s in signals]


def _means(readings: RealArray, rows: int, width: int) -> RealArray:
    """Means of `width` readings each, `rows` in all."""
    used = readings[: rows * width]
    return used if width == 1 else used.reshape(rows, width, -1).mean(axis=1).reshape((rows, *readings.shape[1:]))
