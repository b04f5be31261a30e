"""Reading of a recording: which segments are used, how many samples of each, and which are held out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orchestrator.diagnosis.criteria import Criteria, WeakFormCriteria
from orchestrator.diagnosis.weak_form.loss_history import (
    LOSS_STEP_S,
    heat_of_unread,
    with_current_history,
    with_heat,
    with_rotor_turn,
)
from orchestrator.diagnosis.weak_form.segments import (
    MIN_SEGMENT_SAMPLES,
    PreparedRecording,
    SegmentData,
    read_segment,
    since_the_start,
    windows_of,
)
from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.types import Array
from protocols import NotMeasuredError, RecordingReader, Remark, Segment, SegmentStage

HELD_OUT_EVERY: int = 5
"""One in this many injection points is held out of all fits, for validation."""
MAX_HELD_OUT_SHARE: float = 0.4
"""Maximum part of the points which others surround that is held out: the map needs the rest."""
GOLDEN_RATIO: float = 0.5 * (math.sqrt(5.0) - 1.0)
THINNED_TURNS: float = 1.25
"""Turns of the injected direction that a thinned point keeps: at least a full one after losses at the ends."""
MIN_THINNED_SAMPLES: int = 1000
"""Minimum number of samples of a thinned point."""
COARSE_POINTS: int = 16
"""Maximum number of injection points in the part of a recording that is searched first."""
COARSE_TURNS: float = 0.75
"""Turns of the injected direction of each injection point that the first search uses."""
MIN_COARSE_SAMPLES: int = 100
"""Samples below which a segment is not shortened for the first search."""
USABLE = (
    SegmentStage.GATES_OFF,
    SegmentStage.RESISTANCE,
    SegmentStage.CLASSICAL,
    SegmentStage.INJECTION,
    SegmentStage.STEPS,
)
_EXCITED_STAGES = (SegmentStage.CLASSICAL, SegmentStage.INJECTION, SegmentStage.STEPS)
_SAMPLED = (
    *("i_ab", "v_ab", "v_late_ab", "v_dc", "theta_rad", "resistance_ohm", "heat_j"),
    *("i_quiet_ab", "i_abc", "largest_command_abc", "temperature_c"),
)


def prepare(recording: RecordingReader, criteria: Criteria) -> PreparedRecording:
    """Read every usable segment of a recording.

    Raises
    ------
    RecordingError
        If a capture contradicts the manifest.
    NotMeasuredError
        If no usable segment has current.
    """
    manifest = recording.manifest
    remarks: list[Remark] = []
    segments = [s for s in recording.segments() if s.stage in USABLE]
    cutting = criteria.weak_form
    segments, wanted = _thinned(segments, manifest.drive.sampling_frequency_hz, cutting, remarks)
    pieces: list[SegmentData] = []
    short: list[Segment] = []
    for segment in segments:
        piece = read_segment(recording, segment, wanted.get(segment.id), cutting)
        if piece is None:
            short.append(segment)
        else:
            pieces.append(piece)
    remarks += _too_short(short)
    if not any(p.stage is not SegmentStage.GATES_OFF for p in pieces):
        raise NotMeasuredError(manifest.name, "segments", _nothing_long_enough(short))
    pieces = _held_out_among_fitted(_with_points_held_out(pieces, cutting))
    pieces.sort(key=lambda p: p.segment.start_s)
    pieces = [replace(p, signals=s) for p, s in zip(pieces, since_the_start([p.signals for p in pieces]), strict=True)]
    pieces = with_rotor_turn(with_current_history(pieces))
    read = {p.segment.id for p in pieces}
    # Segments that are not fitted heat the motor too: alignment, lock check, skipped points.
    unread = heat_of_unread(recording, [s for s in recording.segments() if s.id not in read], LOSS_STEP_S)
    return PreparedRecording(manifest, with_heat(pieces, unread, manifest), tuple(remarks), criteria)


def coarse(prepared: PreparedRecording) -> PreparedRecording:
    """A part of the recording for the search: a period of each trapezoid, less than a turn of some injection points.

    It has no held-out segments.
    """
    cutting = prepared.criteria.weak_form
    points = [p.segment.id for p in prepared.pieces if p.stage is SegmentStage.INJECTION]
    count = min(COARSE_POINTS, len(points))
    spread = {points[round(k)] for k in np.linspace(0, len(points) - 1, count)}
    pieces = (p for p in prepared.pieces if p.stage is not SegmentStage.INJECTION or p.segment.id in spread)
    return replace(prepared, pieces=tuple(_part(p, cutting) for p in pieces if not p.held_out), remarks=())


def _with_points_held_out(pieces: list[SegmentData], criteria: WeakFormCriteria) -> list[SegmentData]:
    """The segments with a part of the injection points held out."""
    points = [p for p in pieces if p.stage is SegmentStage.INJECTION]
    if len(points) < criteria.held_out_from:
        return pieces
    means = np.array([_currents(p).mean(axis=0) for p in points])
    held = {points[k].segment.id for k in held_out_points(means)}
    return [replace(p, held_out=p.held_out or p.segment.id in held) for p in pieces]


def held_out_points(means: Array) -> list[int]:
    """Which injection points are held out: one in `HELD_OUT_EVERY`, of those that others surround or that repeat one.

    Multiples of the golden ratio spread them: a fixed stride would take a whole row or column of a grid.

    Parameters
    ----------
    means : array, shape (points, 2)
        Mean currents in the order of the recording [A].
    """
    slack = HULL_TOLERANCE * float(np.abs(means).max(initial=0.0))
    is_near = np.linalg.norm(means[:, None] - means[None], axis=2) < slack
    # Of a point measured twice one is fitted: the second where others surround it, else the first.
    fit = np.flatnonzero((_beyond_hull(means, means) < -slack) ^ np.tril(is_near, -1).any(axis=1))
    share = min(len(means) / (HELD_OUT_EVERY * max(len(fit), 1)), MAX_HELD_OUT_SHARE)
    return [int(at) for k, at in enumerate(fit, 1) if k * GOLDEN_RATIO % 1.0 < share]


def _held_out_among_fitted(pieces: list[SegmentData]) -> list[SegmentData]:
    """Hold out only segments within the range of fitted currents, and none if no excited segment would remain."""
    fitted = [_currents(p) for p in pieces if not p.held_out and p.stage in _EXCITED_STAGES]
    held = {p.segment.id for p in pieces if p.held_out and lies_among(_currents(p), fitted)}
    return [replace(p, held_out=p.segment.id in held) if p.held_out else p for p in pieces]


def _currents(piece: SegmentData) -> Array:
    """A selection of a segment's currents in the believed frame, (n, 2)."""
    every = len(piece.signals.i_ab) // 1000 + 1
    return to_dq(piece.signals.i_ab[::every], float(piece.segment.rotor_angle_rad))


def _part(piece: SegmentData, criteria: WeakFormCriteria) -> SegmentData:
    s, settings = piece.signals, piece.segment.settings
    n, fs = len(s.v_dc), s.sampling_frequency_hz
    count = n
    if piece.stage is SegmentStage.CLASSICAL and settings.get("period_s"):
        count = round(float(settings["period_s"]) * fs)
    elif piece.stage is SegmentStage.INJECTION and settings.get("rotation_hz"):
        count = round(COARSE_TURNS * fs / float(settings["rotation_hz"]))
    stop = count + 1
    if stop >= n or count < MIN_COARSE_SAMPLES:
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
    needed = f"a segment needs {MIN_SEGMENT_SAMPLES} samples, and several periods where one is injected"
    return f"nothing with current in it that is long enough to be used ({kinds}): {needed}"


def _too_short(segments: Sequence[Segment]) -> list[Remark]:
    """One remark per stage on its segments that are too short."""
    by_stage: dict[SegmentStage, list[str]] = {}
    for segment in segments:
        by_stage.setdefault(segment.stage, []).append(segment.id)
    text = "{segment}: too short to be used"
    names = (ids[0] if len(ids) == 1 else f"{ids[0]} to {ids[-1]} ({len(ids)})" for ids in by_stage.values())
    return [Remark.of("too_short", text, segment=name) for name in names]


def _thinned(
    segments: Sequence[Segment], fs: float, criteria: WeakFormCriteria, remarks: list[Remark]
) -> tuple[list[Segment], dict[str, int]]:
    """The segments to read, and the number of samples of each injection point."""
    points = [s for s in segments if s.stage is SegmentStage.INJECTION]
    wanted = {s.id: s.samples for s in points}
    if sum(wanted.values()) <= criteria.most_samples:
        return list(segments), wanted
    turns = {s.id: THINNED_TURNS * fs / float(s.settings.get("rotation_hz") or 1.0) for s in points}
    wanted = {s.id: min(s.samples, max(round(turns[s.id]), MIN_THINNED_SAMPLES)) for s in points}
    stride = max(1.0, sum(wanted.values()) / criteria.most_samples)
    spread = {points[int(k * stride)].id for k in range(int(len(points) / stride))}
    text = "{used} of {points} injection points are used, evenly spread, and one turn of each"
    remarks.append(Remark.of("thinned", text, used=len(spread), points=len(points)))
    return [s for s in segments if s.stage is not SegmentStage.INJECTION or s.id in spread], wanted


HULL_TOLERANCE = 0.1
"""Allowed distance beyond the hull over the largest current, and part of the currents that may exceed it."""


def lies_among(current: Array, others: Sequence[Array]) -> bool:
    """Whether nearly all currents (n, 2) are within the convex hull of others; on a line, between its ends.

    False where there are no others.
    """
    if not others:
        return False
    around = np.concatenate(others)
    slack = HULL_TOLERANCE * float(np.abs(around).max(initial=0.0))
    return bool((_beyond_hull(current, around) > slack).mean() <= HULL_TOLERANCE)


def _beyond_hull(points: Array, others: Array) -> Array:
    """Signed distance of points (n, 2) from the convex hull of others, negative inside; on a line, from its ends."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        sides = ConvexHull(others).equations
        return np.asarray((points @ sides[:, :2].T + sides[:, 2]).max(axis=1))
    except QhullError:
        low, high = others.min(axis=0), others.max(axis=0)
        return np.asarray(np.maximum(low - points, points - high).max(axis=1))
