"""The map of a whole model among a pass's results: recommended where nothing speaks against it. Estimates nothing."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.analysis._checks import reference_flux_wb
from orchestrator.estimation.flux_map_file import load_flux_map
from orchestrator.estimation.judgement import inductances_of
from orchestrator.estimation.nameplate import beside_nameplate
from orchestrator.estimation.results import RECOMMENDED_MAP, load_estimates, write_results
from orchestrator.estimation.usability import convex, flux_band, met, resistance_checks, unmet
from protocols import (
    DeliveredModel,
    EstimationReport,
    EstimatorsReport,
    FluxMap,
    FluxMapEstimate,
    FluxPoints,
    Manifest,
    MapChecks,
    MapReport,
    Motor,
    RecordingError,
    Remark,
    ResistanceEstimate,
)

_OF_NO_OTHER = ("no_map", "far_from_nameplate")
"""Remarks on the estimators' results that are made anew of the model's."""


def deliver_model(
    directory: Path,
    found: FluxMap,
    resistance: ResistanceEstimate,
    objections: tuple[Remark, ...],
    *,
    manifest: Manifest,
    title: str = "",
) -> EstimationReport:
    """Put a model's map and R_s among the results in a directory, in place of an earlier model's.

    Parameters
    ----------
    objections : tuple of Remark
        Where there are any, the map is kept beside the others; those keep their rank, and none of them is usable:
        what the model does not explain is in them too.
    manifest : Manifest
        Of the recording that the model is of; R_s and the inductances are held beside its nameplate.
    title : str
        The model in one line.

    Raises
    ------
    StorageError
        Where a result cannot be written.
    """
    own, maps = _of_the_estimators(directory, found.method)
    model = DeliveredModel(title=title, segments=_digest(manifest), resistance=resistance, objections=objections)
    report, maps = join_model(own, maps, found, model, manifest.motor)
    return write_results(report, maps, directory / "results", motor=manifest.motor.name, recording=manifest.name)


def join_model(
    own: EstimationReport, maps: Mapping[str, FluxMap], found: FluxMap, model: DeliveredModel, motor: Motor
) -> tuple[EstimationReport, dict[str, FluxMap]]:
    """The estimators' report and maps with a diagnosed model's map, which comes first where nothing speaks against it.

    Parameters
    ----------
    own : EstimationReport
        The estimators' alone.
    """
    map_report = MapReport(basis=found.basis, checks=MapChecks(), inductances=inductances_of(found))
    if model.objections:
        report = own.model_copy(update={"maps": {**own.maps, found.method: map_report}})
        report = report.checked(unmet("model", model.objections))
    else:
        report = beside_nameplate(_recommended(own, found, map_report, model, motor), {found.method: found}, motor)
    fields: dict[str, Any] = {"model": model}
    if own.maps or own.resistance:
        fields["estimators"] = EstimatorsReport(**_fields(own))
    return report.model_copy(update=fields), {found.method: found, **maps}


def earlier_model(directory: Path, manifest: Manifest) -> tuple[FluxMap, DeliveredModel] | None:
    """The model that a diagnosis of the same segments left in a directory, and its map; None where there is none."""
    try:
        report = load_estimates(directory)
        model, method = report.model, report.model_method
        if model is None or method is None or model.segments != _digest(manifest):
            return None
        return load_flux_map(_map_file(directory, report, method)), model
    except RecordingError:
        return None


def estimate_of_map(grid: FluxMap, report: EstimationReport | None, points_per_axis: int = 9) -> FluxMapEstimate:
    """A map among the results as an estimator publishes its own, with all remarks where it is the recommended one.

    The points that were measured are not kept with a map; some points of its grid stand for them.
    """
    axes = (np.asarray(axis) for axis in (grid.i_d, grid.i_q))
    rows, columns = (np.unique(np.linspace(0, len(axis) - 1, points_per_axis).astype(int)) for axis in axes)
    d, q = np.meshgrid(grid.i_d[rows], grid.i_q[columns], indexing="ij")
    psi = np.stack([getattr(grid, name)[np.ix_(rows, columns)] for name in ("psi_d", "psi_q")], axis=-1)
    known = np.isfinite(psi).all(axis=-1)
    i_dq = np.stack([d[known], q[known]], axis=1).astype(np.float64)
    points = FluxPoints(i_dq=i_dq, psi_dq=psi[known].astype(np.float64), segment=("",) * len(i_dq))
    checks = report.maps[grid.method].checks if report is not None and grid.method in report.maps else MapChecks()
    remarks = report.remarks if report is not None and report.method == grid.method else ()
    return FluxMapEstimate(map=grid, points=points, checks=checks, remarks=remarks)


def _digest(manifest: Manifest) -> str:
    """Of what the segments are and hold, as far as the manifest knows."""
    return sha256("\n".join(segment.model_dump_json() for segment in manifest.segments).encode()).hexdigest()


def _recommended(
    own: EstimationReport, found: FluxMap, map_report: MapReport, model: DeliveredModel, motor: Motor
) -> EstimationReport:
    """The report with the model's map in first place; objections to the one before stay with that one.

    Crossings stay: they are the recording's, whichever map is made of it.
    """
    against = {check.remark.code for check in own.checks if not check.is_met}
    anew = {*_OF_NO_OTHER, *(remark.code for remark in model.resistance.remarks)}
    others = (r for r in own.remarks if r.code not in anew)
    rest = [r.by(own.method) if own.method and r.code in against else r for r in others]
    resistance = model.resistance
    if own.resistance is not None:
        kept = {name: getattr(own.resistance, name) for name in ("readings", "inverter", "temperature_rise_k")}
        resistance = resistance.model_copy(update=kept)
    fields = {
        "method": found.method,
        "parity": None,
        "reciprocity_percent": None,
        "checks": (),
        "remarks": (*resistance.remarks, *rest),
        "maps": {found.method: map_report, **own.maps},
    }
    report = own.model_copy(update=fields).with_resistance(resistance)
    explains = Remark.of("model", "the model explains the recording: the diagnosis has no objection to its map")
    return report.checked(
        [
            met("model", explains),
            flux_band(found, reference_flux_wb(found, motor), own.criteria),
            convex(found),
            *resistance_checks(resistance, motor, set(), own.criteria),
        ]
    )


def _of_the_estimators(directory: Path, method: str) -> tuple[EstimationReport, dict[str, FluxMap]]:
    """What the estimators alone found, and their maps by method; nothing where they did not run."""
    try:
        report = load_estimates(directory)
        if report.estimators is None and report.model is not None:
            return _NOTHING, {}
        own = EstimationReport(**{**_fields(report.estimators or report), "files": {}})
        names = [name for name in own.maps if name != method]
        return own, {name: load_flux_map(_map_file(directory, report, name)) for name in names}
    except RecordingError:
        return _NOTHING, {}


def _map_file(directory: Path, report: EstimationReport, method: str) -> Path:
    name = "flux_map.nc" if method == report.method else f"flux_map_{method}.nc"
    return (directory / RECOMMENDED_MAP).parent / name


def _fields(report: EstimatorsReport) -> dict[str, Any]:
    return {name: getattr(report, name) for name in EstimatorsReport.model_fields}


_NOTHING = EstimationReport(
    resistance=None,
    method=None,
    crossings=None,
    parity=None,
    reciprocity_percent=None,
    classical_against_injection_percent=None,
    usable=False,
)
