"""Results of one recording as the fields of its row. Computes nothing but ratios."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.estimation import RECOMMENDED_MAP, load_estimates, load_flux_map
from orchestrator.interface.comparison import RunSummary
from orchestrator.recording import Recording
from orchestrator.runs import RunDirectory, is_run
from protocols import About, DiagnosisReport, FoundEffect, Usability
from protocols.fleet import FleetEffect, FleetSetPoint

RELATIVE_SET_POINTS = (
    (0.0, 0.0),
    (-1.0, 0.0),
    (-0.5, 0.0),
    (0.5, 0.0),
    (0.0, 0.5),
    (0.0, 1.0),
    (-0.5, 0.5),
    (-0.5, 1.0),
)
"""(i_d, i_q) over the rated current."""
_BATCH = re.compile(r"batch\s*[=:]\s*(?P<name>.+)", re.IGNORECASE)


def identity(recording: Recording) -> dict[str, Any]:
    """Fields of the motor's identity and the time of the measurement."""
    manifest = recording.manifest
    about = RunDirectory.open(recording.path).record.procedure.about if is_run(recording.path) else About()
    fields: dict[str, Any] = {
        "name": manifest.name,
        "motor": manifest.motor.name,
        "serial": about.serial or None,
        "started_at": _moment(manifest.created),
        "recorded_samples": sum(segment.samples for segment in manifest.segments),
        "temperature_c": about.ambient_c,
    }
    batch = next((match["name"].strip() for tag in about.tags if (match := _BATCH.fullmatch(tag))), None)
    return fields if batch is None else fields | {"batch": batch}


def _moment(text: str) -> datetime | None:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def temperature(recording: Recording) -> dict[str, Any]:
    """The logged mean temperature as a field; empty where none was logged. Raises `RecordingError`."""
    means, weights = [], []
    for segment in recording.segments():
        column = recording.load(segment).temperature_c
        if column is None:  # a logged temperature is in all segments
            return {}
        means.append(float(np.mean(column, dtype=np.float64)))
        weights.append(segment.samples)
    return {"temperature_c": float(np.average(means, weights=weights))} if means else {}


def estimate_fields(run: RunSummary) -> dict[str, Any]:
    """R_s, and the recommended map's values at rest and at the set points."""
    resistance, estimates = run.estimates.resistance, run.estimates
    is_open = estimates.usability is Usability.NOT_JUDGED
    fields: dict[str, Any] = {"usable": None if is_open else estimates.usable}
    if resistance is not None:
        low, high = resistance.low, resistance.high
        fields |= {"R_s_ohm": resistance.value_ohm, "R_s_low_ohm": low, "R_s_high_ohm": high}
    if run.flux_map is None or run.surface is None:
        return fields
    at_rest = dict(run.map_values(np.zeros(2)))
    l_d, l_q = at_rest["l_dd"], at_rest["l_qq"]
    if l_d is not None and l_q is not None:
        fields |= {"L_d_h": l_d.value, "L_q_h": l_q.value, "saliency": l_q.value / l_d.value}
        magnet = float(run.surface.psi(np.zeros((1, 2)))[0, 0])
        fields["psi_pm_wb"] = magnet or None
    rated = run.manifest.motor.rated_current_a or float(run.flux_map.i_q[-1])
    fields["set_points"] = tuple(_set_points(run, rated))
    return fields


def _set_points(run: RunSummary, rated_a: float) -> Iterator[FleetSetPoint]:
    assert run.surface is not None
    for at in rated_a * np.array(RELATIVE_SET_POINTS):
        if run.surface.inside(at[None])[0]:
            psi_d, psi_q = run.surface.psi(at[None])[0]
            i_d, i_q = map(float, at)
            yield FleetSetPoint(i_d_a=i_d, i_q_a=i_q, psi_d_wb=float(psi_d), psi_q_wb=float(psi_q))


def diagnosis_fields(report: DiagnosisReport) -> dict[str, Any]:
    """Verdict, effects, and the error before and after."""
    before, after = report.ladder[0], report.ladder[-1]
    sizes = [size for effect in (*report.effects, *report.minor) for size in _sizes(effect)]
    return {
        "verdict": report.verdict,
        "effects": tuple(sizes),
        "chi2": after.chi2,
        "error_mv": _millivolts(after.heldout_rms_v),
        "error_before_mv": _millivolts(before.heldout_rms_v),
    }


def _sizes(effect: FoundEffect) -> Iterator[FleetEffect]:
    unit = next((parameter.unit for parameter in effect.parameters.values()), "")
    for name, parameter in effect.parameters.items():
        if parameter.unit == unit:
            yield FleetEffect(
                name=effect.name,
                parameter=name,
                size=parameter.value,
                unit=unit,
                low=parameter.low,
                high=parameter.high,
                probability=effect.probability,
                relative_size=effect.relative_size,
                material=effect.material,
                twins=effect.twins,
            )


def _millivolts(volts: float | None) -> float | None:
    return None if volts is None else 1e3 * volts


def summary_of(recording: Recording, out: Path) -> RunSummary:
    """The results below `out`; raises `RecordingError`."""
    estimates = load_estimates(out)
    flux_map = load_flux_map(out / RECOMMENDED_MAP) if estimates.method is not None else None
    return RunSummary(recording.path, recording.manifest, estimates, flux_map, None)
