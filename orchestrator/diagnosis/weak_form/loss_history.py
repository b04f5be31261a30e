"""History before each segment: the current's path, the rotor's rotation, and the copper loss of the experiment.

The loss is measured where it was captured; in gaps it is taken from the next segment.
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
"""Time before a capture for which its first current is assumed to flow, where nothing was captured [s]."""
_FINAL_READINGS = 20
"""Readings averaged for the final current of a segment."""
_MAX_HISTORY_POINTS = 24
"""Points kept of the path to a segment: a sweep's last period or the last holds, which erase earlier hysteresis."""

LOSS_STEP_S: float = 0.05
"""Time step of the loss history [s]: much shorter than a winding's thermal time constant."""
MAX_LOSS_STEPS: int = 2000
"""Maximum number of steps of the loss history, without those at gaps."""

_UNFITTED_STAGES = (SegmentStage.ALIGNMENT, SegmentStage.LOCK_CHECK)


@dataclass(frozen=True)
class SegmentHeat:
    """Squared current of one segment, for the copper loss.

    Attributes
    ----------
    start_s, end_s : float
    times_s, squares : array, shape (m,)
        Mean square of the current from each time to the next [A^2].
    before : float
        Square of the current before the first reading [A^2].
    """

    start_s: float
    end_s: float
    times_s: Array
    squares: Array
    before: float


def step_of(duration_s: float) -> float:
    """Time step of the loss history for an experiment's duration [s]."""
    return max(LOSS_STEP_S, duration_s / MAX_LOSS_STEPS)


def segment_heat(square: Array, start_s: float, end_s: float, fs: float, step_s: float, before: float) -> SegmentHeat:
    """Segment heat from the square of the current at each sample, shape (n,)."""
    starts = np.arange(0, len(square), max(1, round(step_s * fs)))
    means = np.add.reduceat(square, starts) / np.diff(np.append(starts, len(square)))
    return SegmentHeat(start_s, end_s, start_s + starts / fs, np.asarray(means, dtype=np.float64), before)


def heat_of_unread(recording: RecordingReader, segments: Sequence[Segment], step_s: float) -> list[SegmentHeat]:
    """Heat of segments that are not fitted: from their captures, or from the set-points of skipped injection points."""
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
    """The loss history of all segments in temporal order.

    In a gap the drive settles at the next current for up to `settling_s`; before that, no current flows.
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
    """Settling time before a capture: the usual gap that is no longer than `longest_s`, if there is one."""
    ends = accumulate((item.end_s for item in items), max, initial=0.0)
    gaps = [gap for item, end in zip(items, ends, strict=False) if 0.0 < (gap := item.start_s - end) <= longest_s]
    return float(np.median(gaps)) if gaps else longest_s


def with_current_history(pieces: Sequence[SegmentData]) -> list[SegmentData]:
    """The segments with the current's path to each; no current flows while the rotor is turned."""
    way, known = np.zeros((0, 2)), list(pieces[:1])
    for before, piece in pairwise(pieces):
        turned = before.segment.rotor_angle_rad != piece.segment.rotor_angle_rad
        way = np.zeros((1, 2)) if turned else np.concatenate([way, _current_history(before)])[-_MAX_HISTORY_POINTS:]
        known.append(replace(piece, signals=replace(piece.signals, came_from_ab=way)))
    return known


def with_rotor_turn(pieces: Sequence[SegmentData]) -> list[SegmentData]:
    """The segments with the rotor's rotation from its most frequent position."""
    samples = dict[float, int]()
    for piece in pieces:
        angle = piece.segment.rotor_angle_rad
        samples[angle] = samples.get(angle, 0) + piece.segment.samples
    usual = max(samples, key=lambda angle: samples[angle], default=0.0)
    turned = ((piece, piece.segment.rotor_angle_rad - usual) for piece in pieces)
    return [replace(p, signals=replace(p.signals, turned_rad=by_rad)) for p, by_rad in turned]


def _current_history(piece: SegmentData) -> Array:
    """Path of the current in a segment, shape (points, 2): a sweep's course, else the final current."""
    readings = piece.current_ab
    if not piece.signals.bridge_on:
        return np.zeros((1, 2))
    # Under injection, the drive holds the mean current.
    parts = [readings if piece.stage is SegmentStage.INJECTION else readings[-_FINAL_READINGS:]]
    if piece.stage is SegmentStage.CLASSICAL:
        parts = [*np.array_split(readings[len(readings) // 2 :], _MAX_HISTORY_POINTS - 1), *parts]
    return np.array([part.mean(axis=0) for part in parts if len(part)])


def with_heat(
    pieces: Sequence[SegmentData], unread: Sequence[SegmentHeat], manifest: Manifest
) -> tuple[SegmentData, ...]:
    """The segments with the copper loss since the start of the experiment, with the nameplate's resistance."""
    last = pieces[-1].signals
    step_s = step_of(last.start_s + len(last.v_dc) / last.sampling_frequency_hz)
    items = [*unread, *(_heated(p, step_s, manifest.drive.sampling_frequency_hz) for p in pieces)]
    losses = loss_history(items, manifest.motor.stator_resistance_ohm or 1.0, ASSUMED_SETTLING_S)
    energy = np.concatenate([np.zeros(1), np.cumsum(losses.power_w[:-1] * np.diff(losses.time_s))])
    return tuple(
        replace(p, signals=replace(p.signals, heat_j=_heat_of(p, losses, energy), losses=losses)) for p in pieces
    )


def _heated(piece: SegmentData, step_s: float, fs: float) -> SegmentHeat:
    """Heat of one segment: as captured, and at its final current where it lasted longer than the capture."""
    s = piece.signals
    square = np.einsum("ij,ij->i", s.i_ab, s.i_ab) if s.bridge_on else np.zeros(len(s.v_dc))
    end = max(s.start_s + len(square) / s.sampling_frequency_hz, piece.segment.start_s + piece.segment.samples / fs)
    before = float(piece.before_ab @ piece.before_ab) if s.bridge_on else 0.0
    return segment_heat(square, s.start_s, end, s.sampling_frequency_hz, step_s, before)


def _heat_of(piece: SegmentData, losses: LossHistory, energy: Array) -> Array:
    return np.asarray(np.interp(piece.signals.time_s, losses.time_s, energy), dtype=np.float64)
