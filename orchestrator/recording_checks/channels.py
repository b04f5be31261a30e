"""Channels of the logger that show nothing, or only a part: noise for a current, a dead phase, readings cut off."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array
from orchestrator.recording_checks.criteria import ConventionCriteria
from orchestrator.recording_checks.responses import shares
from orchestrator.recording_checks.survey import Sighting, Survey, Vectors, parts
from orchestrator.recording_checks.vector_maps import AXES, PHASES
from protocols import Convention, ManifestCorrection, NotMeasuredError, SegmentStage

_CHANNELS = ("alpha", "beta", *PHASES)


def require_response(survey: Survey) -> None:
    """Refuse what stands in the place of a current and has nothing to do with the voltage.

    Raises
    ------
    NotMeasuredError
        Where the voltage was moved and the readings show none of it, at rest or under injection.
    """
    limits = survey.criteria
    seen = [*survey.holds, *survey.injections]
    if len(seen) < limits.looked_at_segments:
        return
    i, v = (np.array([getattr(s, name) for s in seen]) for name in ("mean_i", "mean_v"))
    told = shares(survey.injections)
    moving = max((float(np.std(s.v)) for s in survey.injections), default=0.0)
    if moving == 0.0 or told is None or max(told) > limits.silent:
        return
    size = float(np.linalg.norm(i) * np.linalg.norm(v))
    if size > 0.0 and max(abs(np.vdot(i, v)), abs(np.sum(i * v))) > limits.speaking * size:
        return
    problem = "the readings show nothing of the voltage, neither at rest nor under injection: noise, and no current"
    raise NotMeasuredError(survey.manifest.name, "i_alpha, i_beta", problem)


def require_held(survey: Survey) -> None:
    """Refuse what was captured after the drive had lost its current.

    Raises
    ------
    NotMeasuredError
        Where most segments have the current that was asked for, and others are far from it.
    """
    limits, most_v = survey.criteria, survey.manifest.drive.dc_bus_voltage_v / math.sqrt(3.0)
    seen = [(s, point) for s in (*survey.holds, *survey.injections) if (point := s.set_point) is not None]
    reach = max((abs(point) for _, point in seen), default=0.0)
    held = [s for s, point in seen if abs(s.mean_i - point) < limits.alike * reach]
    lost = [
        (s, point)
        for s, point in seen
        if abs(s.mean_i - point) > limits.lost * reach and abs(s.mean_v) > limits.at_its_limit * most_v
    ]
    if not lost or 2 * len(held) < len(seen):
        return
    first, point = min(lost, key=lambda pair: pair[0].segment.start_s)
    problem = (
        f"{abs(first.mean_i):.3g} A, {abs(first.mean_i - point):.3g} A from the {abs(point):.3g} A that were asked "
        f"for, at all the voltage there is, and so in {len(lost)} of {len(seen)} segments that were looked at: "
        "the drive had lost its current there; leave them out"
    )
    raise NotMeasuredError(survey.manifest.name, f"{first.segment.id}: i_alpha, i_beta", problem)


def dead_channel(survey: Survey) -> Convention | None:
    """One phase, or one of alpha and beta, that shows no current though there must be one."""
    limits = survey.criteria
    columns = [s.phases for s in survey.seen if s.phases is not None]
    if columns:
        phases = np.concatenate(columns)
        swing, total = np.ptp(phases, axis=0), float(np.ptp(phases.sum(axis=1)))
        # Where a phase is at rest because nothing flows in it, the other two are each other's negative.
        if swing.min() < limits.flat * swing.max() < total:
            return _dead(f"phase {PHASES[int(np.argmin(swing))]}", "its column is constant in every segment")
    seen = survey.injections or survey.seen
    if sum(len(s.i) for s in seen) < limits.least_looked_at or not _moves_both_ways(seen, limits):
        return None
    width, direction = _line(np.concatenate([s.i for s in seen])) or (1.0, 0.0)
    if width < limits.flat:
        across = np.exp(1j * (direction + np.pi / 2.0))
        apart = [abs(np.imag(across * np.conj(axis))) for axis in AXES]
        nearest = int(np.argmin(apart))
        name = f"phase {PHASES[nearest]}" if apart[nearest] < limits.unlike else "i_beta"
        return _dead(name, "all readings lie on one line, while the voltage has both directions")
    told = shares(survey.injections)
    if told is not None and min(told) < limits.silent and max(told) > limits.speaking:
        name, least, most = "i_alpha" if told[0] < told[1] else "i_beta", 100.0 * min(told), 100.0 * max(told)
        return _dead(name, f"the voltage explains {least:.0f} % of its steps, and {most:.0f} % of the other's")
    return None


def _moves_both_ways(seen: Sequence[Sighting], limits: ConventionCriteria) -> bool:
    """Whether the voltage goes in both directions, so that a motor's current does.

    Of a hold the mean counts: what its voltage does beside that is a controller's answer to noise.
    """
    holds = SegmentStage.RESISTANCE
    line = _line(np.concatenate([np.array([s.mean_v]) if s.segment.stage is holds else s.ripple_v for s in seen]))
    return line is not None and line[0] > limits.speaking


def _dead(name: str, evidence: str) -> Convention:
    return Convention(
        kind="dead_channel",
        what=f"the current of {name} looks dead" if name.startswith("phase") else f"{name} looks dead",
        evidence=evidence,
        correction=ManifestCorrection(text=f"measure again with {name} connected; three sensors could spare one"),
    )


def _line(z: Vectors) -> tuple[float, float] | None:
    """Width over length of a cloud, and the direction of its length [rad]; None where it is a point."""
    x = parts(z) - parts(z).mean(axis=0)
    values, vectors = np.linalg.eigh(x.T @ x)
    if values[1] <= 0.0:
        return None
    return float(np.sqrt(max(values[0], 0.0) / values[1])), float(np.arctan2(vectors[1, 1], vectors[0, 1]))


def clipped(survey: Survey) -> Convention | None:
    """Readings or commands that stand at one and the same limit where they should move."""
    limits = survey.criteria
    for field, unit, name in (("i", "A", "currents"), ("v", "V", "voltages")):
        for channel, at, share in _piled(survey, field):
            # A bridge has a limit of its own, and what it commands there is true.
            if field == "v" and (
                _as_asked(survey) or at > limits.bridge_limit * survey.manifest.drive.dc_bus_voltage_v
            ):
                continue
            return Convention(
                kind=f"clipped_{name}",
                what=f"the {name} look clipped at {at:.4g} {unit}",
                evidence=f"{100 * share:.2g} % of the moving readings of {channel} stand at exactly this limit",
                correction=ManifestCorrection(text=f"record again with a wider range of the {name}, or smaller {name}"),
            )
    return None


def bus_spikes(survey: Survey) -> Convention | None:
    """Single readings of the bus voltage that the capacitors of no bus can follow."""
    limits = survey.criteria
    found = [(int(np.count_nonzero(_spikes(s.v_dc, limits))), s) for s in survey.seen]
    count = sum(number for number, _ in found)
    if not count:
        return None
    worst = max(found, key=lambda one: one[0])[1]
    at = int(np.argmax(_spikes(worst.v_dc, limits)))
    typical = float(np.median(worst.v_dc))
    told = f"{worst.segment.id}: sample {at}: {worst.v_dc[at]:.4g} V between readings of {typical:.4g} V"
    return Convention(
        kind="bus_spikes",
        what=f"{count} readings of v_dc look like spikes",
        evidence=told,
        correction=ManifestCorrection(text="measure the bus anew, or give its nominal voltage in every row"),
    )


def _spikes(v_dc: NDArray[np.floating[Any]], limits: ConventionCriteria) -> NDArray[np.bool_]:
    """Which readings are far from the rest; none where they are more than a few, for then the bus itself has moved."""
    typical = float(np.median(v_dc))
    far: NDArray[np.bool_] = np.abs(v_dc - typical) > limits.bus_spike * abs(typical)
    return far if np.count_nonzero(far) < limits.flat * len(far) else np.zeros_like(far)


def _piled(survey: Survey, field: str) -> Iterator[tuple[str, float, float]]:
    """Channels that pile up at both ends: name, limit, share of the readings."""
    limits = survey.criteria
    for channel, x in _moving(survey, field).items():
        most = float(np.abs(x).max(initial=0.0))
        if most == 0.0:
            continue
        size = np.abs(x)
        at_limit = size >= most * (1.0 - 1e-6)
        below = int(np.count_nonzero(size >= most * (1.0 - limits.strip)) - np.count_nonzero(at_limit))
        both = min(np.count_nonzero(at_limit & (x > 0.0)), np.count_nonzero(at_limit & (x < 0.0)))
        # What is cut off is flat; a peak is one reading.
        flat = int(np.count_nonzero(at_limit[1:] & at_limit[:-1]))
        share = np.count_nonzero(at_limit) / len(x)
        if both and share > limits.least_piled and flat > limits.piled_up * max(below, 1):
            yield channel, most, share


def _moving(survey: Survey, field: str) -> dict[str, Array]:
    """alpha, beta and the phases of the injections, whose readings never rest."""
    seen = [getattr(s, field) for s in survey.injections]
    if not seen:
        return {}
    z = np.concatenate(seen)
    return {name: np.real(z * np.conj(axis)) for name, axis in zip(_CHANNELS, (1.0, 1j, *AXES), strict=True)}


def _as_asked(survey: Survey) -> bool:
    """Whether the injected amplitude is the one that was asked for, so that nothing was cut off."""
    ratios = [
        float(np.sqrt(np.mean(np.abs(s.ripple_v) ** 2))) / asked
        for s in survey.injections
        if (asked := s.asked("amplitude_v")) and s.segment.settings.get("waveform") != "sine"
    ]
    return bool(ratios) and min(ratios) > 1.0 - survey.criteria.alike
