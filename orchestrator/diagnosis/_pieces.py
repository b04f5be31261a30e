"""A recording, read once: each usable segment as float64 signals with its windows. Judges nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis._windows import Windows, periodic_windows, plain_windows
from protocols import (
    LossHistory,
    Manifest,
    NotMeasuredError,
    RealArray,
    RecordingReader,
    Segment,
    SegmentStage,
    Signals,
)

Array = NDArray[np.float64]

HAT_S = 0.010
"""Distance of the hats in trapezoids; a hat is twice as long."""
HATS_PER_TURN = 8
USABLE = (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE, SegmentStage.CLASSICAL, SegmentStage.INJECTION)
_SETTLE_S = 1.0
"""How long before a capture its first current is taken to have flowed, where nothing was captured."""
_LOSS_STEP_S = 0.05
_SAMPLED = ("i_ab", "v_ab", "v_dc", "theta_rad", "resistance_ohm", "heat_j")
MOST_SAMPLES = 6_000_000


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
    windows : Windows
    """

    segment: Segment
    held_out: bool
    signals: Signals
    windows: Windows

    @property
    def stage(self) -> SegmentStage:
        return self.segment.stage


@dataclass(frozen=True)
class Prepared:
    """A recording as the diagnosis works on it."""

    manifest: Manifest
    pieces: tuple[Piece, ...]
    notes: tuple[str, ...]

    @property
    def current_range(self) -> tuple[float, float, float]:
        """Lowest and highest i_d and highest |i_q| in the believed frame, gates-off aside [A]."""
        low, high, q = 0.0, 0.0, 0.0
        for piece in self.pieces:
            if piece.stage is SegmentStage.GATES_OFF:
                continue
            i_d, i_q = believed_dq(piece.signals.i_ab, piece.segment.rotor_angle_rad).T
            low, high = min(low, float(i_d.min())), max(high, float(i_d.max()))
            q = max(q, float(np.abs(i_q).max()))
        return low, high, q


def believed_dq(x_ab: NDArray[np.floating], angle_rad: float) -> Array:
    """Stator-frame vectors (n, 2) in the frame that the operator believes in."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(np.asarray(x_ab, dtype=np.float64) @ np.array([[c, -s], [s, c]]))


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
    notes: list[str] = []
    segments = [s for s in recording.segments() if s.stage in USABLE]
    segments = _thinned(segments, notes)
    injections = [s.id for s in segments if s.stage is SegmentStage.INJECTION]
    # Every fifth injection point, not of a sweep's first row or column, where the map would have to extrapolate.
    fifth = set(injections[2::5]) if len(injections) >= 10 else set()
    pieces: list[Piece] = []
    for segment in segments:
        piece = _piece(recording, segment, segment.id in fifth)
        if piece is None:
            notes.append(f"{segment.id}: too short to be used")
        else:
            pieces.append(piece)
    if not any(p.stage is not SegmentStage.GATES_OFF for p in pieces):
        raise NotMeasuredError(manifest.name, "segments", "nothing with current in it that is long enough to be used")
    pieces.sort(key=lambda p: p.segment.start_s)
    return Prepared(manifest, _with_heat(pieces, manifest), tuple(notes))


def coarse(prepared: Prepared) -> Prepared:
    """A part of every segment, to search in: one period of a trapezoid, one turn of the injection, half a hold."""
    return Prepared(prepared.manifest, tuple(_part(p) for p in prepared.pieces), ())


def _part(piece: Piece) -> Piece:
    s, settings = piece.signals, piece.segment.settings
    n, fs = len(s.v_dc), s.sampling_frequency_hz
    first, count = 0, n
    if piece.stage is SegmentStage.CLASSICAL and settings.get("period_s"):
        count = round(float(settings["period_s"]) * fs)
    elif piece.stage is SegmentStage.INJECTION and settings.get("rotation_hz"):
        count = round(1.25 * fs / float(settings["rotation_hz"]))
    elif piece.stage in (SegmentStage.RESISTANCE, SegmentStage.GATES_OFF):
        first, count = n // 4, n // 2
    stop = first + count + 1
    if stop >= n or count < 100:
        return piece
    cut = {name: getattr(s, name)[first:stop] for name in _SAMPLED}
    # Without effects both are one and the same array, and the fit looks for that.
    signals = s.model_copy(update={**cut, "i_m_ab": cut["i_ab"], "start_s": s.start_s + first / fs})
    windows = _windows(piece.segment, fs, signals.i_ab, signals.v_ab)
    return piece if windows is None else Piece(piece.segment, piece.held_out, signals, windows)


def _thinned(segments: Sequence[Segment], notes: list[str]) -> list[Segment]:
    total = sum(s.samples for s in segments)
    if total <= MOST_SAMPLES:
        return list(segments)
    stride = math.ceil(total / MOST_SAMPLES)
    points = [s for s in segments if s.stage is SegmentStage.INJECTION]
    kept = {s.id for s in points[::stride]}
    notes.append(f"{len(kept)} of {len(points)} injection points are used, evenly spread")
    return [s for s in segments if s.stage is not SegmentStage.INJECTION or s.id in kept]


def _piece(recording: RecordingReader, segment: Segment, fifth: bool) -> Piece | None:
    drive = recording.manifest.drive
    capture = recording.load(segment)
    fs = drive.sampling_frequency_hz
    i_ab = np.ascontiguousarray(capture.i_ab, dtype=np.float64)
    v_ab = _delayed(np.ascontiguousarray(capture.v_ab, dtype=np.float64), drive.voltage_delay_samples or 0.0)
    windows = _windows(segment, fs, i_ab, v_ab)
    if windows is None:
        return None
    n = len(i_ab)
    pwm = segment.settings.get("pwm_frequency_hz") or drive.pwm_frequency_hz or fs
    signals = Signals(
        start_s=segment.start_s,
        sampling_frequency_hz=fs,
        pwm_frequency_hz=float(pwm),
        i_ab=i_ab,
        v_ab=v_ab,
        v_dc=np.asarray(capture.v_dc, dtype=np.float64),
        theta_rad=np.full(n, float(segment.rotor_angle_rad)),
        resistance_ohm=np.ones(n),
        i_m_ab=i_ab,
        heat_j=np.zeros(n),
        motor=recording.manifest.motor,
        drive=drive,
        bridge_on=segment.stage is not SegmentStage.GATES_OFF,
    )
    diagonal = segment.stage is SegmentStage.CLASSICAL and _sweeps_both(segment, i_ab)
    return Piece(segment, fifth or diagonal, signals, windows)


def _sweeps_both(segment: Segment, i_ab: Array) -> bool:
    axis = segment.settings.get("swept_axis")
    if axis is not None:
        return str(axis) == "dq"
    spread = np.ptp(believed_dq(i_ab, segment.rotor_angle_rad), axis=0)
    return bool(spread.min() > 0.5 * spread.max())


def _windows(segment: Segment, fs: float, i_ab: RealArray, v_ab: RealArray) -> Windows | None:
    intervals = len(i_ab) - 1
    if intervals < 16:
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


def _with_heat(pieces: Sequence[Piece], manifest: Manifest) -> tuple[Piece, ...]:
    """The pieces with the copper loss since the start of the experiment, by the nameplate's resistance."""
    resistance = manifest.motor.stator_resistance_ohm or 1.0
    times: list[Array] = []
    powers: list[Array] = []
    captured: list[Array] = []
    energy, end = 0.0, 0.0
    warmed: list[tuple[Piece, Array]] = []
    for piece in pieces:
        s = piece.signals
        ts = 1.0 / s.sampling_frequency_hz
        power = 1.5 * resistance * np.einsum("ij,ij->i", s.i_ab, s.i_ab) if s.bridge_on else np.zeros(len(s.v_dc))
        gap = max(s.start_s - end, 0.0)
        settle = min(gap, _SETTLE_S)
        # Before the capture there was no ripple: the loss of the mean current, not the mean loss.
        part = len(power) // 10 if piece.stage is SegmentStage.INJECTION else len(power) // 50
        current = s.i_ab[: max(1, part)].mean(axis=0)
        first = 1.5 * resistance * float(current @ current) if s.bridge_on else 0.0
        if gap > 0.0:
            times.append(np.array([end, s.start_s - settle]))
            powers.append(np.array([0.0, first]))
            captured.append(np.zeros(2))
            energy += first * settle
        stride = max(1, round(_LOSS_STEP_S / ts))
        starts = np.arange(0, len(power), stride)
        times.append(np.asarray(s.start_s + starts * ts, dtype=np.float64))
        powers.append(np.asarray(np.add.reduceat(power, starts) / np.diff(np.append(starts, len(power))), np.float64))
        captured.append(np.ones(len(starts)))
        heat = energy + np.cumsum(power) * ts
        energy, end = float(heat[-1]), s.start_s + len(power) * ts
        warmed.append((piece, heat))
    times.append(np.array([end]))
    powers.append(np.zeros(1))
    captured.append(np.zeros(1))
    losses = LossHistory(
        time_s=np.concatenate(times), power_w=np.concatenate(powers), captured=np.concatenate(captured)
    )
    return tuple(
        Piece(p.segment, p.held_out, p.signals.model_copy(update={"heat_j": heat, "losses": losses}), p.windows)
        for p, heat in warmed
    )
