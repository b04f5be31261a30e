"""A recording, read once: each usable segment as float64 signals with its windows. Judges nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.diagnosis.weak_form.loss_history import Heated, heated, loss_history, step_of, unread_heat
from orchestrator.diagnosis.weak_form.sensor_scatter import Scatter, scatter_of
from orchestrator.diagnosis.weak_form.windows import Windows, periodic_windows, plain_windows
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.types import Array
from protocols import (
    LossHistory,
    Manifest,
    NotMeasuredError,
    RealArray,
    RecordingReader,
    Remark,
    Segment,
    SegmentStage,
    Signals,
)

HAT_S = 0.010
"""Distance of the hats in trapezoids; a hat is twice as long."""
HATS_PER_TURN = 8
USABLE = (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION)
_LEAST_SAMPLES = 17
_FIRST = 5
_SAMPLED = ("i_ab", "v_ab", "v_dc", "theta_rad", "resistance_ohm", "heat_j")
MOST_SAMPLES = 2_400_000
"""Of injection that are read; longer recordings are thinned."""
_COARSE_POINTS = 24
_COARSE_TURN = 0.75
"""Injection points, and the part of a turn of each, to search in."""
_STEP = 0.002
"""Largest step of the current between averaged samples, as a part of the largest current."""
_QUIET = 0.2
"""The same as a part of the noise."""
_MOST_AVERAGED = {SegmentStage.GATES_OFF: 10, SegmentStage.RESISTANCE: 10, SegmentStage.CLASSICAL: 2}


@dataclass(frozen=True)
class Piece:
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
    """

    segment: Segment
    held_out: bool
    signals: Signals
    windows: Windows
    scatter: Scatter
    averaged: int
    before_ab: Array

    @property
    def stage(self) -> SegmentStage:
        return self.segment.stage


@dataclass(frozen=True)
class Prepared:
    """A recording as the diagnosis works on it."""

    manifest: Manifest
    pieces: tuple[Piece, ...]
    remarks: tuple[Remark, ...]

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


def prepare(recording: RecordingReader) -> Prepared:
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
    segments, wanted = _thinned(segments, manifest.drive.sampling_frequency_hz, remarks)
    injections = [s.id for s in segments if s.stage is SegmentStage.INJECTION]
    # Every fifth injection point, not of a sweep's first row or column, where the map would have to extrapolate.
    fifth = set(injections[2::5]) if len(injections) >= 10 else set()
    pieces: list[Piece] = []
    for segment in segments:
        piece = _piece(recording, segment, segment.id in fifth, wanted.get(segment.id))
        if piece is None:
            remarks.append(Remark.of("too_short", "{segment}: too short to be used", segment=segment.id))
        else:
            pieces.append(piece)
    if not any(p.stage is not SegmentStage.GATES_OFF for p in pieces):
        raise NotMeasuredError(manifest.name, "segments", "nothing with current in it that is long enough to be used")
    pieces.sort(key=lambda p: p.segment.start_s)
    read = {p.segment.id for p in pieces}
    # What tells nothing of the motor warms it all the same: alignment, lock check, points left out.
    unread = unread_heat(recording, [s for s in recording.segments() if s.id not in read])
    return Prepared(manifest, _with_heat(pieces, unread, manifest), tuple(remarks))


def coarse(prepared: Prepared) -> Prepared:
    """A part of the recording, to search in: a period of each trapezoid, less than a turn of some injection points."""
    points = [p.segment.id for p in prepared.pieces if p.stage is SegmentStage.INJECTION]
    stride = max(1, len(points) - 1) / (_COARSE_POINTS - 1)
    kept = {points[round(k * stride)] for k in range(_COARSE_POINTS)} if len(points) > _COARSE_POINTS else set(points)
    pieces = (p for p in prepared.pieces if p.stage is not SegmentStage.INJECTION or p.segment.id in kept)
    return Prepared(prepared.manifest, tuple(_part(p) for p in pieces), ())


def _part(piece: Piece) -> Piece:
    s, settings = piece.signals, piece.segment.settings
    n, fs = len(s.v_dc), s.sampling_frequency_hz
    first, count = 0, n
    if piece.stage is SegmentStage.CLASSICAL and settings.get("period_s"):
        count = round(float(settings["period_s"]) * fs)
    elif piece.stage is SegmentStage.INJECTION and settings.get("rotation_hz"):
        count = round(_COARSE_TURN * fs / float(settings["rotation_hz"]))
    stop = first + count + 1
    if stop >= n or count < 100:
        return piece
    cut = {name: getattr(s, name)[first:stop] for name in _SAMPLED}
    # Without effects both are one and the same array, and the fit looks for that.
    signals = s.model_copy(update={**cut, "i_m_ab": cut["i_ab"], "start_s": s.start_s + first / fs})
    windows = _windows(piece.segment, fs, signals.i_ab, signals.v_ab)
    return piece if windows is None else replace(piece, signals=signals, windows=windows)


def _thinned(segments: Sequence[Segment], fs: float, remarks: list[Remark]) -> tuple[list[Segment], dict[str, int]]:
    """The segments to be read, and how many samples of each injection point."""
    points = [s for s in segments if s.stage is SegmentStage.INJECTION]
    wanted = {s.id: s.samples for s in points}
    if sum(wanted.values()) <= MOST_SAMPLES:
        return list(segments), wanted
    turns = {s.id: 1.25 * fs / float(s.settings.get("rotation_hz") or 1.0) for s in points}
    wanted = {s.id: min(s.samples, max(round(turns[s.id]), 1000)) for s in points}
    stride = max(1.0, sum(wanted.values()) / MOST_SAMPLES)
    kept = {points[int(k * stride)].id for k in range(int(len(points) / stride))}
    told = "{used} of {points} injection points are used, evenly spread, and one turn of each"
    remarks.append(Remark.of("thinned", told, used=len(kept), points=len(points)))
    return [s for s in segments if s.stage is not SegmentStage.INJECTION or s.id in kept], wanted


def _piece(recording: RecordingReader, segment: Segment, fifth: bool, samples: int | None) -> Piece | None:
    drive = recording.manifest.drive
    capture = recording.load(segment)
    fs = drive.sampling_frequency_hz
    i_ab = np.ascontiguousarray(capture.i_ab[:samples], dtype=np.float64)
    v_ab = np.ascontiguousarray(capture.v_ab[:samples], dtype=np.float64)
    v_ab = _delayed(v_ab, drive.voltage_delay_samples or 0.0)
    v_dc = np.asarray(capture.v_dc[:samples], dtype=np.float64)
    if len(i_ab) < _LEAST_SAMPLES:
        return None
    ripple = segment.stage is SegmentStage.INJECTION
    scatter = scatter_of(i_ab, _injection_period(segment, fs, v_ab) if ripple else None)
    # An injected ripple moves the current at once; its mean is what the drive had settled to.
    before, start = (i_ab if ripple else i_ab[:_FIRST]).mean(axis=0), segment.start_s
    width = _width(segment.stage, i_ab, 0.0 if ripple else math.sqrt(float(np.trace(scatter.covariance))))
    if width > 1:
        i_ab, v_ab, v_dc = _averaged(i_ab, v_ab, v_dc, width)
        start, fs = start + 0.5 * (width - 1) / fs, fs / width
    windows = _windows(segment, fs, i_ab, v_ab)
    if windows is None:
        return None
    n = len(i_ab)
    pwm = segment.settings.get("pwm_frequency_hz") or drive.pwm_frequency_hz or drive.sampling_frequency_hz
    signals = Signals(
        start_s=start,
        sampling_frequency_hz=fs,
        pwm_frequency_hz=float(pwm),
        i_ab=i_ab,
        v_ab=v_ab,
        v_dc=v_dc,
        theta_rad=np.full(n, float(segment.rotor_angle_rad)),
        resistance_ohm=np.ones(n),
        i_m_ab=i_ab,
        heat_j=np.zeros(n),
        motor=recording.manifest.motor,
        drive=drive,
        bridge_on=segment.stage is not SegmentStage.GATES_OFF,
    )
    diagonal = segment.stage is SegmentStage.CLASSICAL and _sweeps_both(segment, i_ab)
    return Piece(segment, fifth or diagonal, signals, windows, scatter, width, before)


def _width(stage: SegmentStage, i_ab: Array, noise_a: float) -> int:
    """How many readings of a slow stage may be averaged: so few that the current hardly moves from mean to mean."""
    most = min(_MOST_AVERAGED.get(stage, 1), len(i_ab) // 200)
    if most < 2:
        return 1
    # Means of 32 readings, so that noise is not taken for movement; a jump at the start of a capture is let pass.
    length = len(i_ab) // 32 * 32
    means = i_ab[:length].reshape(-1, 32, 2).mean(axis=1)
    usual = float(np.quantile(np.abs(np.diff(means, axis=0)).max(axis=1), 0.95)) / 32.0
    allowed = max(_STEP * float(np.abs(means).max()), _QUIET * noise_a)
    return int(min(most, max(1.0, allowed / max(usual, 1e-12))))


def _averaged(i_ab: Array, v_ab: Array, v_dc: Array, width: int) -> tuple[Array, Array, Array]:
    """Means of `width` readings, and the voltage that acts between the middles of these means.

    dpsi/dt = v - R i holds for means as for samples: the mean current of one block and the next differ by what
    the voltage does in between, and each v_k of 2 width - 1 intervals counts by the share of readings it moves.
    """
    blocks = len(i_ab) // width
    used = blocks * width
    impulse = np.concatenate([np.zeros((1, 2)), np.cumsum(v_ab[:used], axis=0)])[:-1]
    mean = impulse.reshape(blocks, width, 2).mean(axis=1)
    between = np.diff(mean, axis=0) / width
    return (
        i_ab[:used].reshape(blocks, width, 2).mean(axis=1),
        np.concatenate([between, v_ab[used - width : used].mean(axis=0)[None]]),
        v_dc[:used].reshape(blocks, width).mean(axis=1),
    )


def _sweeps_both(segment: Segment, i_ab: Array) -> bool:
    axis = segment.settings.get("swept_axis")
    if axis is not None:
        return str(axis) == "dq"
    spread = np.ptp(to_dq(i_ab, segment.rotor_angle_rad), axis=0)
    return bool(spread.min() > 0.5 * spread.max())


def _windows(segment: Segment, fs: float, i_ab: RealArray, v_ab: RealArray) -> Windows | None:
    intervals = len(i_ab) - 1
    if intervals < 4:
        return None
    if segment.stage is SegmentStage.CLASSICAL:
        return plain_windows(intervals, HAT_S * fs)
    if segment.stage is SegmentStage.INJECTION:
        period = _injection_period(segment, fs, v_ab)
        if period is None:
            return plain_windows(intervals, HAT_S * fs)
        turn_s = 1.0 / float(segment.settings.get("rotation_hz") or 1.0)
        step = min(turn_s / HATS_PER_TURN * fs, intervals / 4)
        return periodic_windows(intervals, max(step, 4 * period), period)
    return plain_windows(intervals, intervals / 2)


def _injection_period(segment: Segment, fs: float, v_ab: RealArray) -> float | None:
    """Samples in an injection period: as asked for, else half the distance of the voltage's strongest lines."""
    asked = segment.settings.get("frequency_hz")
    if isinstance(asked, int | float) and 0 < asked < fs / 4:
        return fs / float(asked)
    n = len(v_ab)
    vectors = v_ab[:, 0] + 1j * v_ab[:, 1]
    spectrum = np.abs(np.fft.fft((vectors - vectors.mean()) * np.hanning(n)))
    ahead = int(np.argmax(spectrum[1 : n // 2])) + 1
    behind = int(np.argmax(spectrum[: n // 2 : -1])) + 1
    frequency = 0.5 * (ahead + behind) * fs / n
    return fs / frequency if 4.0 * fs / n < frequency < fs / 4 else None


def _delayed(v_ab: Array, samples: float) -> Array:
    """The voltage that acts over [t_k, t_k+1) when each command is `samples` late."""
    if samples == 0.0:
        return v_ab
    whole = math.floor(samples)
    part = samples - whole
    last = np.maximum(np.arange(len(v_ab)) - whole, 0)
    return np.ascontiguousarray((1.0 - part) * v_ab[last] + part * v_ab[np.maximum(last - 1, 0)])


def _with_heat(pieces: Sequence[Piece], unread: Sequence[Heated], manifest: Manifest) -> tuple[Piece, ...]:
    """The pieces with the copper loss since the start of the experiment, by the nameplate's resistance."""
    last = pieces[-1].signals
    step_s = step_of(last.start_s + len(last.v_dc) / last.sampling_frequency_hz)
    items = [*unread, *(_heated(p, step_s, manifest.drive.sampling_frequency_hz) for p in pieces)]
    losses = loss_history(items, manifest.motor.stator_resistance_ohm or 1.0)
    energy = np.concatenate([np.zeros(1), np.cumsum(losses.power_w[:-1] * np.diff(losses.time_s))])
    return tuple(
        replace(p, signals=p.signals.model_copy(update={"heat_j": _heat_of(p, losses, energy), "losses": losses}))
        for p in pieces
    )


def _heated(piece: Piece, step_s: float, fs: float) -> Heated:
    """Of one piece: as captured, and as at its end where the segment went on after what was read."""
    s = piece.signals
    square = np.einsum("ij,ij->i", s.i_ab, s.i_ab) if s.bridge_on else np.zeros(len(s.v_dc))
    end = max(s.start_s + len(square) / s.sampling_frequency_hz, piece.segment.start_s + piece.segment.samples / fs)
    before = float(piece.before_ab @ piece.before_ab) if s.bridge_on else 0.0
    return heated(square, s.start_s, end, s.sampling_frequency_hz, step_s, before)


def _heat_of(piece: Piece, losses: LossHistory, energy: Array) -> Array:
    s = piece.signals
    now = s.start_s + np.arange(len(s.v_dc)) / s.sampling_frequency_hz
    return np.asarray(np.interp(now, losses.time_s, energy), dtype=np.float64)
