"""What was found of one recording, as the fields of its row. Computes nothing but ratios."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.comparison import RunSaid
from orchestrator.estimation import RECOMMENDED_MAP, load_estimates, load_flux_map
from orchestrator.recording import Recording
from orchestrator.runs import RunDirectory, is_run
from protocols import About, CompareReport, DiagnosisReport, FoundEffect
from protocols.fleet import FleetEffect, FleetSetPoint

SET_POINTS = ((0.0, 0.0), (-1.0, 0.0), (-0.5, 0.0), (0.5, 0.0), (0.0, 0.5), (0.0, 1.0), (-0.5, 0.5), (-0.5, 1.0))
"""(i_d, i_q) over the rated current."""
_BATCH = re.compile(r"batch\s*[=:]\s*(?P<name>.+)", re.IGNORECASE)


def identity(recording: Recording) -> dict[str, Any]:
    """Who was measured, and when."""
    manifest = recording.manifest
    about = RunDirectory.open(recording.path).record.procedure.about if is_run(recording.path) else About()
    told: dict[str, Any] = {
        "name": manifest.name,
        "motor": manifest.motor.name,
        "serial": about.serial or None,
        "started_at": _moment(manifest.created),
        "recorded_samples": sum(segment.samples for segment in manifest.segments),
        "temperature_c": about.ambient_c,
    }
    batch = next((found["name"].strip() for tag in about.tags if (found := _BATCH.fullmatch(tag))), None)
    return told if batch is None else told | {"batch": batch}


def _moment(text: str) -> datetime | None:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def temperature(recording: Recording) -> dict[str, Any]:
    """The mean temperature that was logged; nothing where none was. Raises `RecordingError`."""
    means, weights = [], []
    for segment in recording.segments():
        column = recording.load(segment).temperature_c
        if column is None:  # one that was logged is in all segments
            return {}
        means.append(float(np.mean(column, dtype=np.float64)))
        weights.append(segment.samples)
    return {"temperature_c": float(np.average(means, weights=weights))} if means else {}


def estimated(said: RunSaid) -> dict[str, Any]:
    """R_s, and what the recommended map says at rest and at the set points."""
    resistance, estimates = said.estimates.resistance, said.estimates
    fields: dict[str, Any] = {"usable": estimates.usable}
    if resistance is not None:
        low, high = resistance.low, resistance.high
        fields |= {"R_s_ohm": resistance.value_ohm, "R_s_low_ohm": low, "R_s_high_ohm": high}
    if said.flux_map is None or said.surface is None:
        return fields
    at_rest = dict(said.of_the_map(np.zeros(2)))
    l_d, l_q = at_rest["l_dd"], at_rest["l_qq"]
    if l_d is not None and l_q is not None:
        fields |= {"L_d_h": l_d.value, "L_q_h": l_q.value, "saliency": l_q.value / l_d.value}
        magnet = float(said.surface.psi(np.zeros((1, 2)))[0, 0])
        fields["psi_pm_wb"] = magnet or None
    rated = said.manifest.motor.rated_current_a or float(said.flux_map.i_q[-1])
    fields["set_points"] = tuple(_set_points(said, rated))
    return fields


def _set_points(said: RunSaid, rated_a: float) -> Iterator[FleetSetPoint]:
    assert said.surface is not None
    for at in rated_a * np.array(SET_POINTS):
        if said.surface.inside(at[None])[0]:
            psi_d, psi_q = said.surface.psi(at[None])[0]
            i_d, i_q = map(float, at)
            yield FleetSetPoint(i_d_a=i_d, i_q_a=i_q, psi_d_wb=float(psi_d), psi_q_wb=float(psi_q))


def compared(report: CompareReport) -> dict[str, Any]:
    """How well the model without effects fits."""
    return {"chi2": report.chi2}


def diagnosed(report: DiagnosisReport) -> dict[str, Any]:
    """Verdict, effects, and the error before and after."""
    before, after = report.ladder[0], report.ladder[-1]
    effects = [effect for found in (*report.effects, *report.minor) for effect in _sizes(found)]
    return {
        "verdict": report.verdict,
        "effects": tuple(effects),
        "chi2": after.chi2,
        "error_mv": _millivolts(after.heldout_rms_v),
        "error_before_mv": _millivolts(before.heldout_rms_v),
    }


def _sizes(found: FoundEffect) -> Iterator[FleetEffect]:
    unit = next((parameter.unit for parameter in found.parameters.values()), "")
    for name, parameter in found.parameters.items():
        if parameter.unit == unit:
            yield FleetEffect(
                name=found.name,
                parameter=name,
                size=parameter.value,
                unit=unit,
                low=parameter.low,
                high=parameter.high,
                probability=found.probability,
                relative_size=found.relative_size,
                material=found.material,
                twins=found.twins,
            )


def _millivolts(volts: float | None) -> float | None:
    return None if volts is None else 1e3 * volts


def said_of(recording: Recording, out: Path) -> RunSaid:
    """What the estimators and the diagnosis have put below `out`; raises `RecordingError`."""
    estimates = load_estimates(out)
    flux_map = load_flux_map(out / RECOMMENDED_MAP) if estimates.method is not None else None
    return RunSaid(recording.path, recording.manifest, estimates, flux_map, None)
