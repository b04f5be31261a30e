"""Faulty channels of the logger: noise in place of a current, a dead phase, clipped readings, spikes of the bus."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.responses import explained_shares
from orchestrator.recording_checks.survey import (
    MAX_MATCH_ERROR,
    MIN_MISMATCH_ERROR,
    MIN_SAMPLES,
    MIN_SEGMENTS,
    SegmentReadings,
    Survey,
    Vectors,
    parts,
)
from orchestrator.recording_checks.vector_maps import AXES, PHASES
from protocols import Convention, ManifestCorrection, NotMeasuredError, SegmentStage

_CHANNELS = ("alpha", "beta", *PHASES)

MIN_LOST_CURRENT_FRACTION = 0.5
"""Deviation from the set-point, relative to the largest one, where the drive has lost its current."""
MIN_VOLTAGE_LIMIT_FRACTION = 0.8
"""Minimum voltage over V_dc / sqrt 3 of a drive that has lost its current."""
MAX_LINE_WIDTH_FRACTION = 0.02
"""Width of a line of readings, relative to its length, that one channel alone can draw."""
MAX_EXPLAINED_SHARE_DEAD = 0.05
"""Share of a channel's steps that the voltage explains, below which it shows no motor's current."""
MIN_EXPLAINED_SHARE_LIVE = 0.3
"""Share of a channel's steps that the voltage explains, above which it shows a motor's current."""
MIN_CLIPPED_SHARE = 0.002
"""Minimum share of varying readings exactly at their limit where they are clipped."""
MIN_CLIPPED_TO_STRIP_RATIO = 0.2
"""Minimum ratio of repeats at the limit over readings in the strip below it; the tail of noise has next to none."""
STRIP_WIDTH_FRACTION = 0.02
"""Width of that strip, relative to the limit."""
MAX_REPEATED_SHARE = 0.5
"""Share of commands equal to the one before, above which they are steps of an open loop: they repeat unclipped."""
MIN_BUS_SPIKE_FRACTION = 0.5
"""Relative step of single bus readings that its capacitors exclude within a sample."""
MAX_BUS_SPIKE_SHARE = 0.02
"""Maximum share of outlying readings that count as spikes; with more, the bus itself has changed."""
MIN_BRIDGE_LIMIT_FRACTION = 0.45
"""Voltage over the bus voltage above which the bridge may be the limit: 1/2 to 2/3, by modulation."""


def require_response(survey: Survey) -> None:
    """Refuse readings of a current that do not depend on the voltage.

    Raises
    ------
    NotMeasuredError
        Where the voltage varied and the readings do not follow it, neither at rest nor under injection.
    """
    segments = [*survey.holds, *survey.injections]
    if len(segments) < MIN_SEGMENTS:
        return
    i, v = (np.array([getattr(s, name) for s in segments]) for name in ("mean_i", "mean_v"))
    shares = explained_shares(survey.injections)
    moving = max((float(np.std(s.v)) for s in survey.injections), default=0.0)
    if moving == 0.0 or shares is None or max(shares) > MAX_EXPLAINED_SHARE_DEAD:
        return
    size = float(np.linalg.norm(i) * np.linalg.norm(v))
    if size > 0.0 and max(abs(np.vdot(i, v)), abs(np.sum(i * v))) > MIN_EXPLAINED_SHARE_LIVE * size:
        return
    problem = "the current readings do not follow the voltage, neither at rest nor under injection: they are noise"
    raise NotMeasuredError(survey.manifest.name, "i_alpha, i_beta", problem)


def require_held(survey: Survey) -> None:
    """Refuse captures made after the drive had lost its current.

    Raises
    ------
    NotMeasuredError
        Where most segments reach their set-point, and others are far from it.
    """
    max_v = survey.manifest.drive.dc_bus_voltage_v / math.sqrt(3.0)
    seen = [(s, point) for s in (*survey.holds, *survey.injections) if (point := s.set_point) is not None]
    max_current = max((abs(point) for _, point in seen), default=0.0)
    held = [s for s, point in seen if abs(s.mean_i - point) < MAX_MATCH_ERROR * max_current]
    lost = [
        (s, point)
        for s, point in seen
        if abs(s.mean_i - point) > MIN_LOST_CURRENT_FRACTION * max_current
        and abs(s.mean_v) > MIN_VOLTAGE_LIMIT_FRACTION * max_v
    ]
    if not lost or 2 * len(held) < len(seen):
        return
    first, point = min(lost, key=lambda pair: pair[0].segment.start_s)
    problem = (
        f"{abs(first.mean_i):.3g} A, {abs(first.mean_i - point):.3g} A from the set-point of {abs(point):.3g} A, at "
        f"the voltage limit, as in {len(lost)} of the {len(seen)} segments examined: "
        "the drive had lost its current there; leave them out"
    )
    raise NotMeasuredError(survey.manifest.name, f"{first.segment.id}: i_alpha, i_beta", problem)


def dead_channel(survey: Survey) -> Convention | None:
    """A dead sensor of one phase, or of alpha or beta: it shows no current though there must be one."""
    columns = [s.phases for s in survey.seen if s.phases is not None]
    if columns:
        phases = np.concatenate(columns)
        swing, total = np.ptp(phases, axis=0), float(np.ptp(phases.sum(axis=1)))
        # With zero current in a phase the other two are opposite; with a dead sensor they need not be.
        if swing.min() < MAX_LINE_WIDTH_FRACTION * swing.max() < total:
            return _dead(f"phase {PHASES[int(np.argmin(swing))]}", "its column is constant in every segment")
    segments = survey.injections or survey.seen
    if sum(len(s.i) for s in segments) < MIN_SAMPLES or not _spans_plane(segments):
        return None
    width, direction = _line(np.concatenate([s.i for s in segments])) or (1.0, 0.0)
    if width < MAX_LINE_WIDTH_FRACTION:
        across = np.exp(1j * (direction + np.pi / 2.0))
        distances = [abs(np.imag(across * np.conj(axis))) for axis in AXES]
        nearest = int(np.argmin(distances))
        name = f"phase {PHASES[nearest]}" if distances[nearest] < MIN_MISMATCH_ERROR else "i_beta"
        return _dead(name, "all readings lie on one line, while the voltage has both directions")
    shares = explained_shares(survey.injections)
    if shares is not None and min(shares) < MAX_EXPLAINED_SHARE_DEAD and max(shares) > MIN_EXPLAINED_SHARE_LIVE:
        name, low, high = "i_alpha" if shares[0] < shares[1] else "i_beta", 100.0 * min(shares), 100.0 * max(shares)
        return _dead(name, f"the voltage explains {low:.0f} % of its steps, and {high:.0f} % of the other's")
    return None


def _spans_plane(segments: Sequence[SegmentReadings]) -> bool:
    """Whether the voltage, of a hold its mean, spans the plane, so that a motor's current does too."""
    holds = SegmentStage.RESISTANCE
    line = _line(np.concatenate([np.array([s.mean_v]) if s.segment.stage is holds else s.ripple_v for s in segments]))
    return line is not None and line[0] > MIN_EXPLAINED_SHARE_LIVE


def _dead(name: str, evidence: str) -> Convention:
    return Convention(
        kind="dead_channel",
        what=f"the current of {name} looks dead" if name.startswith("phase") else f"{name} looks dead",
        evidence=evidence,
        correction=ManifestCorrection(
            text=f"measure again with {name} connected; with three sensors the other two suffice"
        ),
    )


def _line(z: Vectors) -> tuple[float, float] | None:
    """Width over length of a cloud, and the direction of its length [rad]; None where it is a point."""
    x = parts(z) - parts(z).mean(axis=0)
    values, vectors = np.linalg.eigh(x.T @ x)
    if values[1] <= 0.0:
        return None
    return float(np.sqrt(max(values[0], 0.0) / values[1])), float(np.arctan2(vectors[1, 1], vectors[0, 1]))


def clipped(survey: Survey) -> Convention | None:
    """Clipped readings or commands: they repeat one and the same limit where they should move."""
    for field, unit, name in (("i", "A", "currents"), ("v", "V", "voltages")):
        for channel, at, share in _clipped_channels(survey, field):
            # At the bridge's own limit the commands are true.
            if field == "v" and (
                _amplitude_as_set(survey) or at > MIN_BRIDGE_LIMIT_FRACTION * survey.manifest.drive.dc_bus_voltage_v
            ):
                continue
            return Convention(
                kind=f"clipped_{name}",
                what=f"the {name} look clipped at {at:.4g} {unit}",
                evidence=f"{100 * share:.2g} % of the moving readings of {channel} are exactly at this limit",
                correction=ManifestCorrection(text=f"record again with a wider range of the {name}, or smaller {name}"),
            )
    return None


def bus_spikes(survey: Survey) -> Convention | None:
    """Single readings of the bus voltage that differ more than the bus capacitors allow."""
    counts = [(int(np.count_nonzero(_spikes(s.v_dc))), s) for s in survey.seen]
    count = sum(number for number, _ in counts)
    if not count:
        return None
    worst = max(counts, key=lambda pair: pair[0])[1]
    at = int(np.argmax(_spikes(worst.v_dc)))
    typical = float(np.median(worst.v_dc))
    evidence = f"{worst.segment.id}: sample {at}: {worst.v_dc[at]:.4g} V between readings of {typical:.4g} V"
    return Convention(
        kind="bus_spikes",
        what=f"{count} readings of v_dc look like spikes",
        evidence=evidence,
        correction=ManifestCorrection(text="measure the bus anew, or give its nominal voltage in every row"),
    )


def _spikes(v_dc: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Mask of readings far from the median; all False where they are many, because then the bus itself has moved."""
    typical = float(np.median(v_dc))
    far: NDArray[np.bool_] = np.abs(v_dc - typical) > MIN_BUS_SPIKE_FRACTION * abs(typical)
    return far if np.count_nonzero(far) < MAX_BUS_SPIKE_SHARE * len(far) else np.zeros_like(far)


def _clipped_channels(survey: Survey, field: str) -> Iterator[tuple[str, float, float]]:
    """Channels with many readings at both ends of their range: name, limit, share of the readings."""
    for channel, x in _moving(survey, field).items():
        limit = float(np.abs(x).max(initial=0.0))
        if limit == 0.0:
            continue
        size = np.abs(x)
        at_limit = size >= limit * (1.0 - 1e-6)
        below = int(np.count_nonzero(size >= limit * (1.0 - STRIP_WIDTH_FRACTION)) - np.count_nonzero(at_limit))
        both_ends = min(np.count_nonzero(at_limit & (x > 0.0)), np.count_nonzero(at_limit & (x < 0.0)))
        # Clipped readings repeat; a peak is one reading.
        flat = int(np.count_nonzero(at_limit[1:] & at_limit[:-1]))
        share = np.count_nonzero(at_limit) / len(x)
        if both_ends and share > MIN_CLIPPED_SHARE and flat > MIN_CLIPPED_TO_STRIP_RATIO * max(below, 1):
            yield channel, limit, share


def _moving(survey: Survey, field: str) -> dict[str, Array]:
    """alpha, beta and the phases of the injections whose readings always move."""
    seen = [getattr(s, field) for s in survey.injections if field == "i" or not _is_open_loop(s)]
    if not seen:
        return {}
    z = np.concatenate(seen)
    return {name: np.real(z * np.conj(axis)) for name, axis in zip(_CHANNELS, (1.0, 1j, *AXES), strict=True)}


def _is_open_loop(segment: SegmentReadings) -> bool:
    """Whether a voltage of no stated amplitude stands still between edges, as no current control makes it."""
    repeated = float(np.mean(segment.v[1:] == segment.v[:-1]))
    return segment.setting("amplitude_v") is None and repeated > MAX_REPEATED_SHARE


def _amplitude_as_set(survey: Survey) -> bool:
    """Whether the injected amplitude equals its set-point, so that nothing was clipped."""
    ratios = [
        float(np.sqrt(np.mean(np.abs(s.ripple_v) ** 2))) / amplitude
        for s in survey.injections
        if (amplitude := s.setting("amplitude_v")) and s.segment.settings.get("waveform") != "sine"
    ]
    return bool(ratios) and min(ratios) > 1.0 - MAX_MATCH_ERROR
