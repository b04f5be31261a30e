"""Where the current and the rotor were before each segment, and the copper loss over the whole experiment.

The loss is measured where it was captured, and taken from the next segment where it was not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise

import numpy as np

from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.types import Array
from protocols import LossHistory, Manifest, RecordingReader, Segment, SegmentStage

ASSUMED_SETTLING_S: float = 1.0
"""How long before a capture its first current is assumed to have flowed, where nothing was captured [s]."""
_FINAL_READINGS = 20
"""Whose mean is where a current was as a segment ended."""
_MAX_HISTORY_POINTS = 24
"""Of the way to a segment that are kept: a sweep's last period, or the last holds; what was before is wiped out."""

LOSS_STEP_S: float = 0.05
"""Step of the history of losses [s]: short beside a winding's thermal time constant."""
MAX_LOSS_STEPS: int = 2000
"""Steps of the history of losses in a long experiment, without those at gaps."""

_UNFITTED_STAGES = (SegmentStage.ALIGNMENT, SegmentStage.LOCK_CHECK)


@dataclass(frozen=True)
class SegmentHeat:
    """What is known of the current of one segment, for the heat it leaves.

    Attributes
    ----------
    start_s, end_s : float
    times_s, squares : array, shape (m,)
        Mean square of the current from each time to the next [A^2].
    before : float
        The same of what had flowed until the first reading.
    """

    start_s: float
    end_s: float
    times_s: Array
    squares: Array
    before: float


def step_of(duration_s: float) -> float:
    """Time step of the history of an experiment that took so long [s]."""
    return max(LOSS_STEP_S, duration_s / MAX_LOSS_STEPS)


def segment_heat(square: Array, start_s: float, end_s: float, fs: float, step_s: float, before: float) -> SegmentHeat:
    """From the square of the current at each sample, shape (n,)."""
    starts = np.arange(0, len(square), max(1, round(step_s * fs)))
    means = np.add.reduceat(square, starts) / np.diff(np.append(starts, len(square)))
    return SegmentHeat(start_s, end_s, start_s + starts / fs, np.asarray(means, dtype=np.float64), before)


def heat_of_unread(recording: RecordingReader, segments: Sequence[Segment], step_s: float) -> list[SegmentHeat]:
    """Of segments that are not fitted: as captured, injection points that were left out by what they aimed at."""
    fs = recording.manifest.drive.sampling_frequency_hz
    heats = []
    for segment in segments:
        end = segment.start_s + segment.samples / fs
        target = [segment.settings.get(f"target_{axis}_a") for axis in "dq"]
        if segment.stage in _UNFITTED_STAGES and segment.samples:
            i_ab = np.asarray(recording.load(segment).i_ab, dtype=np.float64)
            square = np.einsum("ij,ij->i", i_ab, i_ab)
            heats.append(segment_heat(square, segment.start_s, end, fs, step_s, float(square[0])))
        elif segment.stage is SegmentStage.INJECTION and None not in target:
            aimed = sum(float(x) ** 2 for x in target if x is not None)
            heats.append(SegmentHeat(segment.start_s, end, np.array([segment.start_s]), np.array([aimed]), aimed))
    return heats


def loss_history(items: Sequence[SegmentHeat], resistance_ohm: float, settling_s: float) -> LossHistory:
    """All of them in order of time.

    In a gap the drive settles to what flows next; the rest of one longer than `settling_s` is spent without current.
    """
    items = sorted(items, key=lambda h: h.start_s)
    usual_s = _usual_settling_s(items, settling_s)
    times: list[Array] = []
    squares: list[Array] = []
    captured: list[Array] = []
    end = 0.0
    for item in items:
        gap = max(item.start_s - end, 0.0)
        if gap > 0.0:
            settled = gap if gap <= settling_s else usual_s
            times.append(np.array([end, item.start_s - settled]))
            squares.append(np.array([0.0, item.before]))
            captured.append(np.zeros(2))
        times.append(item.times_s)
        squares.append(item.squares)
        captured.append(np.ones(len(item.squares)))
        end = item.end_s
    times.append(np.array([end]))
    squares.append(np.zeros(1))
    captured.append(np.zeros(1))
    return LossHistory(
        time_s=np.concatenate(times),
        power_w=1.5 * resistance_ohm * np.concatenate(squares),
        captured=np.concatenate(captured),
    )


def _usual_settling_s(items: Sequence[SegmentHeat], longest_s: float) -> float:
    """How long a drive settles before a capture: as in most gaps that are no longer than the longest, if there are."""
    ends = accumulate((item.end_s for item in items), max, initial=0.0)
    gaps = [gap for item, end in zip(items, ends, strict=False) if 0.0 < (gap := item.start_s - end) <= longest_s]
    return float(np.median(gaps)) if gaps else longest_s


def with_current_history(pieces: Sequence[SegmentData]) -> list[SegmentData]:
    """The pieces with where the current was on the way to each; none flows while a rotor is turned."""
    way, known = np.zeros((0, 2)), list(pieces[:1])
    for before, piece in pairwise(pieces):
        turned = before.segment.rotor_angle_rad != piece.segment.rotor_angle_rad
        way = np.zeros((1, 2)) if turned else np.concatenate([way, _current_history(before)])[-_MAX_HISTORY_POINTS:]
        known.append(replace(piece, signals=replace(piece.signals, came_from_ab=way)))
    return known


def with_rotor_turn(pieces: Sequence[SegmentData]) -> list[SegmentData]:
    """The pieces with how far the rotor was turned to each, from where it was for most of the recording."""
    samples = dict[float, int]()
    for piece in pieces:
        angle = piece.segment.rotor_angle_rad
        samples[angle] = samples.get(angle, 0) + piece.segment.samples
    usual = max(samples, key=lambda angle: samples[angle], default=0.0)
    turned = ((piece, piece.segment.rotor_angle_rad - usual) for piece in pieces)
    return [replace(p, signals=replace(p.signals, turned_rad=by_rad)) for p, by_rad in turned]


def _current_history(piece: SegmentData) -> Array:
    """Where the current was in a piece, shape (points, 2): all along a sweep, else as it ended."""
    readings = piece.current_ab
    if not piece.signals.bridge_on:
        return np.zeros((1, 2))
    # An injected ripple's mean is where the drive holds the current.
    parts = [readings if piece.stage is SegmentStage.INJECTION else readings[-_FINAL_READINGS:]]
    if piece.stage is SegmentStage.CLASSICAL:
        parts = [*np.array_split(readings[len(readings) // 2 :], _MAX_HISTORY_POINTS - 1), *parts]
    return np.array([part.mean(axis=0) for part in parts if len(part)])


def with_heat(
    pieces: Sequence[SegmentData], unread: Sequence[SegmentHeat], manifest: Manifest
) -> tuple[SegmentData, ...]:
    """The pieces with the copper loss since the start of the experiment, by the nameplate's resistance."""
    last = pieces[-1].signals
    step_s = step_of(last.start_s + len(last.v_dc) / last.sampling_frequency_hz)
    items = [*unread, *(_heated(p, step_s, manifest.drive.sampling_frequency_hz) for p in pieces)]
    losses = loss_history(items, manifest.motor.stator_resistance_ohm or 1.0, ASSUMED_SETTLING_S)
    energy = np.concatenate([np.zeros(1), np.cumsum(losses.power_w[:-1] * np.diff(losses.time_s))])
    return tuple(
        replace(p, signals=replace(p.signals, heat_j=_heat_of(p, losses, energy), losses=losses)) for p in pieces
    )


def _heated(piece: SegmentData, step_s: float, fs: float) -> SegmentHeat:
    """Of one piece: as captured, and as at its end where the segment went on after what was read."""
    s = piece.signals
    square = np.einsum("ij,ij->i", s.i_ab, s.i_ab) if s.bridge_on else np.zeros(len(s.v_dc))
    end = max(s.start_s + len(square) / s.sampling_frequency_hz, piece.segment.start_s + piece.segment.samples / fs)
    before = float(piece.before_ab @ piece.before_ab) if s.bridge_on else 0.0
    return segment_heat(square, s.start_s, end, s.sampling_frequency_hz, step_s, before)


def _heat_of(piece: SegmentData, losses: LossHistory, energy: Array) -> Array:
    return np.asarray(np.interp(piece.signals.time_s, losses.time_s, energy), dtype=np.float64)
