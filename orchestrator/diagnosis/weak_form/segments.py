"""A recording, read once: each usable segment as float64 signals with its windows. Judges nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from orchestrator.analysis import turns_of
from orchestrator.diagnosis.criteria import Criteria, WeakFormCriteria
from orchestrator.diagnosis.weak_form.logged import logged_fields, since_the_start
from orchestrator.diagnosis.weak_form.loss_history import (
    LOSS_STEP_S,
    SegmentHeat,
    heat_of_unread,
    loss_history,
    segment_heat,
    step_of,
)
from orchestrator.diagnosis.weak_form.reach import lies_among
from orchestrator.diagnosis.weak_form.sensor_scatter import (
    Scatter,
    repeats,
    scatter_beside_answer,
    scatter_between,
    scatter_of,
)
from orchestrator.diagnosis.weak_form.windows import Windows, periodic_windows, plain_windows
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.kernels import delayed_means
from orchestrator.numerics.types import Array
from protocols import (
    LossHistory,
    Manifest,
    ModulatorTimer,
    NotMeasuredError,
    RealArray,
    RecordingReader,
    Remark,
    Segment,
    SegmentStage,
    Signals,
)
from protocols.fleet_priors import FleetPriors

LEAST_TEST_FUNCTIONS_PER_TRAPEZOID: int = 8
"""Test functions in a trapezoid of a sweep; in one shorter than ten milliseconds they are shortened."""
LEAST_SAMPLES_PER_TEST_FUNCTION: int = 8
"""Samples between the centres of two test functions of a trapezoid."""
TEST_FUNCTIONS_PER_VOLTAGE_STEP: float = 4.0
"""Test functions from one turn of a voltage step to the next: a lag shows in the first, R_s in the others."""
LEAST_SAMPLES_PER_STEP_TEST_FUNCTION: float = 2.0
"""Samples between two test functions of voltage steps; with fewer, neighbours carry the same information."""
TEST_FUNCTIONS_PER_TURN: int = 8
"""Test functions in a turn of an injected direction: the flux along it turns twice, and each half turn needs two."""
LEAST_PERIODS_PER_TEST_FUNCTION: int = 4
"""Injection periods between two test functions; with fewer, the Fourier modes of a period are not separable."""
LEAST_SAMPLES_PER_PERIOD: int = 4
"""Samples in an injection period; with fewer, its edges cannot be resolved."""
MAX_BINS_PER_PERIOD: int = 40
"""Bins of an injection period; modes up to the fifth need no more."""
LEAST_SEGMENT_SAMPLES: int = 17
"""Readings below which a segment is not used: a test function takes eight on either side."""
INITIAL_READINGS: int = 5
"""Readings whose mean is the current that flowed until a segment began."""
HELD_OUT_EVERY: int = 5
"""Every so many-th injection point is kept out of all fits and used to validate them."""
LEAST_SWING_RATIO_OF_DIAGONAL: float = 0.5
"""Swing of one axis over the other's from which a sweep is of both axes; a sweep of one hardly moves the other."""
THINNED_TURNS: float = 1.25
"""Turns of the injected direction that a thinned point keeps: a whole one, whatever its windows lose at the ends."""
LEAST_THINNED_SAMPLES: int = 1000
"""Samples that a thinned point keeps at least."""
COARSE_POINTS: int = 16
"""Injection points in the part of a recording that is searched first."""
COARSE_TURNS: float = 0.75
"""Part of a turn of each injection point that the first search uses."""
LEAST_COARSE_SAMPLES: int = 100
"""Samples below which a segment is not shortened for the first search."""
LEAST_AVERAGED_SAMPLES: int = 200
"""Averaged samples that a segment keeps at least."""
ASSUMED_SETTLING_S: float = 1.0
"""How long before a capture its first current is assumed to have flowed, where nothing was captured [s]."""

Axis = Literal["d", "q", "dq"]
AXES: tuple[Axis, ...] = ("d", "q", "dq")
USABLE = (
    SegmentStage.GATES_OFF,
    SegmentStage.RESISTANCE,
    SegmentStage.CLASSICAL,
    SegmentStage.INJECTION,
    SegmentStage.STEPS,
)
_EXCITED_STAGES = (SegmentStage.CLASSICAL, SegmentStage.INJECTION, SegmentStage.STEPS)
_ZERO_TOLERANCE = 1e-6
"""Of the other axis: single precision turned from frame to frame makes a tenth of it."""
_FINAL_READINGS = 20
"""Whose mean is where a current was as a segment ended."""
_MAX_HISTORY_POINTS = 24
"""Of the way to a segment that are kept: a sweep's last period, or the last holds; what was before is wiped out."""
_SAMPLED = (
    *("i_ab", "v_ab", "v_late_ab", "v_dc", "theta_rad", "resistance_ohm", "heat_j"),
    *("i_quiet_ab", "i_abc", "temperature_c"),
)


@dataclass(frozen=True)
class SegmentSignals:
    """One segment.

    Attributes
    ----------
    segment : Segment
    held_out : bool
        Kept out of every fit, to judge it by.
    signals : Signals
        As measured and commanded; `resistance_ohm` is 1 (a factor), to be scaled.
        Of the slow stages each sample is the mean of `averaged` readings, at the middle of their times.
    windows : Windows
    scatter : Scatter
        What the readings say of the current noise.
    averaged : int
    before_ab : array, shape (2,)
        Current at the first readings, ripple aside: what had flowed until then [A].
    current_ab : array, shape (readings, 2)
        Currents as they were read.
    command_ab : array, shape (readings, 2)
        Voltages as they were commanded, each when it was.
    delay_samples : float
        By how much each acts later.
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
    """A recording as the diagnosis works on it."""

    manifest: Manifest
    pieces: tuple[SegmentSignals, ...]
    remarks: tuple[Remark, ...]
    criteria: Criteria
    fleet: FleetPriors | None = None
    """What other motors of its kind let expect."""
    quantiser: ModulatorTimer | None = None
    """Whose rounding is in the pieces' voltages."""
    ripples: bool = False
    """Whether the current ripples within a carrier's period by as much as matters to its resistance."""

    @property
    def rows(self) -> tuple[int, ...]:
        """How many equations each piece makes."""
        return tuple(piece.windows.rows for piece in self.pieces)

    @property
    def current_range(self) -> tuple[float, float, float]:
        """Lowest and highest i_d and highest |i_q| in the believed frame, gates-off aside [A]."""
        low, high, q = 0.0, 0.0, 0.0
        for piece in self.pieces:
            if piece.stage is SegmentStage.GATES_OFF:
                continue
            i_d, i_q = to_dq(piece.signals.i_ab, piece.segment.rotor_angle_rad).T
            low, high = min(low, float(i_d.min())), max(high, float(i_d.max()))
            q = max(q, float(np.abs(i_q).max()))
        return low, high, q


def prepare(recording: RecordingReader, criteria: Criteria) -> PreparedRecording:
    """Read every usable segment of a recording.

    Raises
    ------
    RecordingError
        Where a capture is not what the manifest says.
    NotMeasuredError
        Where there is no segment with current in it.
    """
    manifest = recording.manifest
    remarks: list[Remark] = []
    segments = [s for s in recording.segments() if s.stage in USABLE]
    cutting = criteria.weak_form
    segments, wanted = _thinned(segments, manifest.drive.sampling_frequency_hz, cutting, remarks)
    injections = [s.id for s in segments if s.stage is SegmentStage.INJECTION]
    # Not of a grid's first row or column, where the map would have to extrapolate.
    held_out = set(injections[2::HELD_OUT_EVERY]) if len(injections) >= cutting.held_out_from else set()
    pieces: list[SegmentSignals] = []
    short: list[Segment] = []
    for segment in segments:
        piece = _piece(recording, segment, segment.id in held_out, wanted.get(segment.id), cutting)
        if piece is None:
            short.append(segment)
        else:
            pieces.append(piece)
    remarks += _too_short(short)
    if not any(p.stage is not SegmentStage.GATES_OFF for p in pieces):
        raise NotMeasuredError(manifest.name, "segments", _nothing_long_enough(short))
    pieces = _held_out_among_fitted(pieces)
    pieces.sort(key=lambda p: p.segment.start_s)
    pieces = [replace(p, signals=s) for p, s in zip(pieces, since_the_start([p.signals for p in pieces]), strict=True)]
    pieces = _with_rotor_turn(_with_current_history(pieces))
    read = {p.segment.id for p in pieces}
    # What tells nothing of the motor warms it all the same: alignment, lock check, points left out.
    unread = heat_of_unread(recording, [s for s in recording.segments() if s.id not in read], LOSS_STEP_S)
    return PreparedRecording(manifest, _with_heat(pieces, unread, manifest), tuple(remarks), criteria)


def coarse(prepared: PreparedRecording) -> PreparedRecording:
    """A part of the recording, to search in: a period of each trapezoid, less than a turn of some injection points.

    What is held out is for the whole to be judged by, and is not in it.
    """
    cutting = prepared.criteria.weak_form
    points = [p.segment.id for p in prepared.pieces if p.stage is SegmentStage.INJECTION]
    most = min(COARSE_POINTS, len(points))
    spread = {points[round(k)] for k in np.linspace(0, len(points) - 1, most)}
    pieces = (p for p in prepared.pieces if p.stage is not SegmentStage.INJECTION or p.segment.id in spread)
    return replace(prepared, pieces=tuple(_part(p, cutting) for p in pieces if not p.held_out), remarks=())


def _held_out_among_fitted(pieces: list[SegmentSignals]) -> list[SegmentSignals]:
    """Held out is what lies among the currents that are fitted, and nothing where else nothing would move."""
    fitted = [_currents(p) for p in pieces if not p.held_out and p.stage in _EXCITED_STAGES]
    held = {p.segment.id for p in pieces if p.held_out and lies_among(_currents(p), fitted)}
    return [replace(p, held_out=p.segment.id in held) if p.held_out else p for p in pieces]


def _currents(piece: SegmentSignals) -> Array:
    """Some of its currents in the believed frame, (n, 2)."""
    every = len(piece.signals.i_ab) // 1000 + 1
    return to_dq(piece.signals.i_ab[::every], float(piece.segment.rotor_angle_rad))


def _part(piece: SegmentSignals, criteria: WeakFormCriteria) -> SegmentSignals:
    s, settings = piece.signals, piece.segment.settings
    n, fs = len(s.v_dc), s.sampling_frequency_hz
    count = n
    if piece.stage is SegmentStage.CLASSICAL and settings.get("period_s"):
        count = round(float(settings["period_s"]) * fs)
    elif piece.stage is SegmentStage.INJECTION and settings.get("rotation_hz"):
        count = round(COARSE_TURNS * fs / float(settings["rotation_hz"]))
    stop = count + 1
    if stop >= n or count < LEAST_COARSE_SAMPLES:
        return piece
    cut = {name: getattr(s, name)[:stop] for name in _SAMPLED if getattr(s, name) is not None}
    signals = replace(s, **{**cut, "i_m_ab": cut["i_ab"]})
    windows = windows_of(piece.segment, fs, signals.i_ab, signals.v_ab, criteria)
    if windows is None:
        return piece
    windows = replace(windows, unread=piece.windows.unread)
    read = {name: getattr(piece, name)[: stop * piece.averaged] for name in ("current_ab", "command_ab")}
    return replace(piece, signals=signals, windows=windows, **read)


def _nothing_long_enough(short: Sequence[Segment]) -> str:
    kinds = ", ".join(dict.fromkeys(segment.stage.value for segment in short)) or "none but readings without current"
    least = LEAST_SEGMENT_SAMPLES
    needed = f"a segment needs {least} samples, and several periods where one is injected"
    return f"nothing with current in it that is long enough to be used ({kinds}): {needed}"


def _too_short(segments: Sequence[Segment]) -> list[Remark]:
    """One remark for all segments of a stage that tell nothing."""
    by_stage: dict[SegmentStage, list[str]] = {}
    for segment in segments:
        by_stage.setdefault(segment.stage, []).append(segment.id)
    text = "{segment}: too short to be used"
    names = (ids[0] if len(ids) == 1 else f"{ids[0]} to {ids[-1]} ({len(ids)})" for ids in by_stage.values())
    return [Remark.of("too_short", text, segment=name) for name in names]


def _thinned(
    segments: Sequence[Segment], fs: float, criteria: WeakFormCriteria, remarks: list[Remark]
) -> tuple[list[Segment], dict[str, int]]:
    """The segments to be read, and how many samples of each injection point."""
    points = [s for s in segments if s.stage is SegmentStage.INJECTION]
    wanted = {s.id: s.samples for s in points}
    if sum(wanted.values()) <= criteria.most_samples:
        return list(segments), wanted
    turns = {s.id: THINNED_TURNS * fs / float(s.settings.get("rotation_hz") or 1.0) for s in points}
    wanted = {s.id: min(s.samples, max(round(turns[s.id]), LEAST_THINNED_SAMPLES)) for s in points}
    stride = max(1.0, sum(wanted.values()) / criteria.most_samples)
    spread = {points[int(k * stride)].id for k in range(int(len(points) / stride))}
    text = "{used} of {points} injection points are used, evenly spread, and one turn of each"
    remarks.append(Remark.of("thinned", text, used=len(spread), points=len(points)))
    return [s for s in segments if s.stage is not SegmentStage.INJECTION or s.id in spread], wanted


def _piece(
    recording: RecordingReader, segment: Segment, held_out: bool, samples: int | None, criteria: WeakFormCriteria
) -> SegmentSignals | None:
    drive = recording.manifest.drive
    capture = recording.load(segment)
    fs = drive.sampling_frequency_hz
    i_ab = np.ascontiguousarray(capture.i_ab[:samples], dtype=np.float64)
    current_ab, command_ab = i_ab, np.ascontiguousarray(capture.v_ab[:samples], dtype=np.float64)
    delay = drive.voltage_delay_samples or 0.0
    v_ab = delayed(command_ab, delay)
    v_dc = np.asarray(capture.v_dc[:samples], dtype=np.float64)
    if len(i_ab) < LEAST_SEGMENT_SAMPLES:
        return None
    ripple = segment.stage is SegmentStage.INJECTION
    scatter = _scatter(segment, fs, i_ab, v_ab)
    # An injected ripple moves the current at once; its mean is what the drive had settled to.
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
        **logged_fields(capture, n, width),
    )
    diagonal = segment.stage is SegmentStage.CLASSICAL and swept_axis(segment, i_ab) == "dq"
    return SegmentSignals(
        segment, held_out or diagonal, signals, windows, scatter, width, before, current_ab, command_ab, delay
    )


def _scatter(segment: Segment, fs: float, i_ab: Array, v_ab: Array) -> Scatter:
    """Scatter of a segment's readings, by differences that its voltage does not cause."""
    if segment.stage is SegmentStage.STEPS:
        return scatter_between(i_ab, v_ab)
    period = injection_period(segment, fs, v_ab) if segment.stage is SegmentStage.INJECTION else None
    if period is not None and not repeats(v_ab, period):
        return scatter_beside_answer(i_ab, v_ab)
    return scatter_of(i_ab, period, steady=segment.stage in (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE))


def _width(stage: SegmentStage, i_ab: Array, noise_a: float, criteria: WeakFormCriteria) -> int:
    """How many readings of a slow stage may be averaged: so few that the current hardly moves from mean to mean."""
    slow = stage in (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE)
    most = criteria.most_averaged_at_rest if slow else criteria.most_averaged_in_sweeps
    most = min(most, len(i_ab) // LEAST_AVERAGED_SAMPLES)
    if most < 2 or stage in (SegmentStage.INJECTION, SegmentStage.STEPS):
        return 1
    # Means of 32 readings, so that noise is not taken for movement; a jump at the start of a capture is let pass.
    length = len(i_ab) // 32 * 32
    means = i_ab[:length].reshape(-1, 32, 2).mean(axis=1)
    usual = float(np.quantile(np.abs(np.diff(means, axis=0)).max(axis=1), 0.95)) / 32.0
    allowed = max(criteria.averaged_step * float(np.abs(means).max()), criteria.averaged_noise * noise_a)
    return int(min(most, max(1.0, allowed / max(usual, 1e-12))))


def mean_between(command_ab: Array, width: int, delay_samples: float) -> Array:
    """The voltage that acts between the middles of means of `width` readings, shape (readings // width, 2).

    dpsi/dt = v - R i holds for means as for samples: the mean current of one block and the next differ by what
    the voltage does in between, and each v_k of 2 width - 1 intervals counts by the share of readings it moves.
    """
    if width == 1 and delay_samples == 0.0:
        return command_ab
    late_by = math.floor(delay_samples)
    commands = np.ascontiguousarray(command_ab, dtype=np.float64)
    return np.asarray(delayed_means(commands, width, late_by, delay_samples - late_by), dtype=np.float64)


def block_means(x: Array, width: int) -> Array:
    """Means of blocks of so many rows; what is left over at the end is left out."""
    blocks = len(x) // width
    return np.asarray(x[: blocks * width].reshape(blocks, width, -1).mean(axis=1), dtype=np.float64)


def swept_axis(segment: Segment, i_ab: RealArray) -> Axis:
    """The axis along which a sweep moves the current: as it says itself, else by what moved."""
    stated = segment.settings.get("swept_axis")
    for axis in AXES:
        if stated == axis:
            return axis
    swing_d, swing_q = np.ptp(to_dq(i_ab, segment.rotor_angle_rad), axis=0)
    if min(swing_d, swing_q) > LEAST_SWING_RATIO_OF_DIAGONAL * max(swing_d, swing_q):
        return "dq"
    return "d" if swing_d > swing_q else "q"


def unread_axis(segment: Segment, i_ab: RealArray, v_ab: RealArray) -> int | None:
    """The axis (0 for d, 1 for q) of which neither current nor voltage is anything but a rounded zero.

    A sensor has noise: what is nothing throughout was written, not read.
    """
    size = np.array([np.abs(to_dq(x, segment.rotor_angle_rad)).max(axis=0) for x in (i_ab, v_ab)])
    nothing = np.flatnonzero((size <= _ZERO_TOLERANCE * size.max(axis=1, keepdims=True)).all(axis=0))
    return int(nothing[0]) if len(nothing) == 1 else None


def windows_of(
    segment: Segment, fs: float, i_ab: RealArray, v_ab: RealArray, criteria: WeakFormCriteria
) -> Windows | None:
    """The windows that suit a segment's stage; None where it is too short for one.

    One hat of a dwell, overlapping ones of a sweep and within each swing of steps, and of an injection hats times the
    period's Fourier modes.
    """
    intervals = len(i_ab) - 1
    if segment.stage in (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE):
        return plain_windows(intervals, intervals / 2)
    if segment.stage is SegmentStage.STEPS:
        swing = intervals / (turns_of(np.asarray(v_ab, dtype=np.float64)) + 1)
        return plain_windows(
            intervals, max(swing / TEST_FUNCTIONS_PER_VOLTAGE_STEP, LEAST_SAMPLES_PER_STEP_TEST_FUNCTION)
        )
    period = injection_period(segment, fs, v_ab) if segment.stage is SegmentStage.INJECTION else None
    if period is None:
        shorter = max(intervals / LEAST_TEST_FUNCTIONS_PER_TRAPEZOID, LEAST_SAMPLES_PER_TEST_FUNCTION)
        return plain_windows(intervals, min(criteria.hat_s * fs, shorter))
    turn_s = 1.0 / float(segment.settings.get("rotation_hz") or 1.0)
    step = min(turn_s / TEST_FUNCTIONS_PER_TURN * fs, intervals / 4)
    return periodic_windows(intervals, max(step, LEAST_PERIODS_PER_TEST_FUNCTION * period), period, MAX_BINS_PER_PERIOD)


def injection_period(segment: Segment, fs: float, v_ab: RealArray) -> float | None:
    """Samples in an injection period: by the set point, else half the distance of the voltage's strongest lines."""
    requested = segment.settings.get("frequency_hz")
    highest = fs / LEAST_SAMPLES_PER_PERIOD
    if isinstance(requested, int | float) and 0 < requested < highest:
        return fs / float(requested)
    n = len(v_ab)
    vectors = v_ab[:, 0] + 1j * v_ab[:, 1]
    spectrum = np.abs(np.fft.fft((vectors - vectors.mean()) * np.hanning(n)))
    ahead = int(np.argmax(spectrum[1 : n // 2])) + 1
    behind = int(np.argmax(spectrum[: n // 2 : -1])) + 1
    frequency = 0.5 * (ahead + behind) * fs / n
    # A line nearer to zero than a Hann window's width is the mean's.
    return fs / frequency if 4.0 * fs / n < frequency < highest else None


def delayed(v_ab: Array, samples: float) -> Array:
    """The voltage that acts over [t_k, t_k+1) when each command is `samples` late."""
    if samples == 0.0:
        return v_ab
    late_by = math.floor(samples)
    return np.asarray(delayed_means(np.ascontiguousarray(v_ab, dtype=np.float64), 1, late_by, samples - late_by))


def late_beside(v_ab: Array, samples: float) -> Array | None:
    """What the voltage at t_k+1 then has beside its mean since t_k; None where it does not change in between."""
    late_by = math.floor(samples)
    if samples == late_by:
        return None
    return np.ascontiguousarray((samples - late_by) * (_late(v_ab, late_by) - _late(v_ab, late_by + 1)))


def _late(v_ab: Array, rows: int) -> Array:
    return v_ab[np.maximum(np.arange(len(v_ab)) - rows, 0)]


def _with_current_history(pieces: Sequence[SegmentSignals]) -> list[SegmentSignals]:
    """The pieces with where the current was on the way to each; none flows while a rotor is turned."""
    way, known = np.zeros((0, 2)), list(pieces[:1])
    for before, piece in pairwise(pieces):
        turned = before.segment.rotor_angle_rad != piece.segment.rotor_angle_rad
        way = np.zeros((1, 2)) if turned else np.concatenate([way, _current_history(before)])[-_MAX_HISTORY_POINTS:]
        known.append(replace(piece, signals=replace(piece.signals, came_from_ab=way)))
    return known


def _with_rotor_turn(pieces: Sequence[SegmentSignals]) -> list[SegmentSignals]:
    """The pieces with how far the rotor was turned to each, from where it was for most of the recording."""
    samples = dict[float, int]()
    for piece in pieces:
        angle = piece.segment.rotor_angle_rad
        samples[angle] = samples.get(angle, 0) + piece.segment.samples
    usual = max(samples, key=lambda angle: samples[angle], default=0.0)
    turned = ((piece, piece.segment.rotor_angle_rad - usual) for piece in pieces)
    return [replace(p, signals=replace(p.signals, turned_rad=by_rad)) for p, by_rad in turned]


def _current_history(piece: SegmentSignals) -> Array:
    """Where the current was in a piece, shape (points, 2): all along a sweep, else as it ended."""
    readings = piece.current_ab
    if not piece.signals.bridge_on:
        return np.zeros((1, 2))
    # An injected ripple's mean is where the drive holds the current.
    parts = [readings if piece.stage is SegmentStage.INJECTION else readings[-_FINAL_READINGS:]]
    if piece.stage is SegmentStage.CLASSICAL:
        parts = [*np.array_split(readings[len(readings) // 2 :], _MAX_HISTORY_POINTS - 1), *parts]
    return np.array([part.mean(axis=0) for part in parts if len(part)])


def _with_heat(
    pieces: Sequence[SegmentSignals], unread: Sequence[SegmentHeat], manifest: Manifest
) -> tuple[SegmentSignals, ...]:
    """The pieces with the copper loss since the start of the experiment, by the nameplate's resistance."""
    last = pieces[-1].signals
    step_s = step_of(last.start_s + len(last.v_dc) / last.sampling_frequency_hz)
    items = [*unread, *(_heated(p, step_s, manifest.drive.sampling_frequency_hz) for p in pieces)]
    losses = loss_history(items, manifest.motor.stator_resistance_ohm or 1.0, ASSUMED_SETTLING_S)
    energy = np.concatenate([np.zeros(1), np.cumsum(losses.power_w[:-1] * np.diff(losses.time_s))])
    return tuple(
        replace(p, signals=replace(p.signals, heat_j=_heat_of(p, losses, energy), losses=losses)) for p in pieces
    )


def _heated(piece: SegmentSignals, step_s: float, fs: float) -> SegmentHeat:
    """Of one piece: as captured, and as at its end where the segment went on after what was read."""
    s = piece.signals
    square = np.einsum("ij,ij->i", s.i_ab, s.i_ab) if s.bridge_on else np.zeros(len(s.v_dc))
    end = max(s.start_s + len(square) / s.sampling_frequency_hz, piece.segment.start_s + piece.segment.samples / fs)
    before = float(piece.before_ab @ piece.before_ab) if s.bridge_on else 0.0
    return segment_heat(square, s.start_s, end, s.sampling_frequency_hz, step_s, before)


def _heat_of(piece: SegmentSignals, losses: LossHistory, energy: Array) -> Array:
    return np.asarray(np.interp(piece.signals.time_s, losses.time_s, energy), dtype=np.float64)
