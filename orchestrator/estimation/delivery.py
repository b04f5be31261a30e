"""Adds a diagnosed model's map to the estimators' results, ranked first if there is no objection."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.analysis._checks import reference_flux_wb
from orchestrator.estimation.flux_map_file import load_flux_map
from orchestrator.estimation.judgement import inductances_of
from orchestrator.estimation.nameplate import with_nameplate_checks
from orchestrator.estimation.results import RECOMMENDED_MAP, has_estimates, load_estimates, write_results
from orchestrator.estimation.usability import MODEL, convex, flux_band, met, missing_model, resistance_checks, unmet
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

MODEL_LEFT_OUT = "model_left_out"
"""Code of the remark on an earlier model of other segments."""
_RECOMPUTED_REMARKS = ("no_map", "far_from_nameplate", "common_factor")
"""Codes of remarks that are recomputed for the model's map."""


def deliver_model(
    directory: Path,
    model_map: FluxMap,
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
        With any, the others keep their rank before the model's map, and none is usable: errors that the model does not
        explain affect them too.
    manifest : Manifest
        Manifest of the diagnosed recording; R_s and the inductances are compared with its nameplate.
    title : str
        The model in one line.

    Raises
    ------
    StorageError
        Where a result cannot be written.
    """
    base, maps = _estimator_results(directory, model_map.method)
    model = DeliveredModel(title=title, segments=_digest(manifest), resistance=resistance, objections=objections)
    report, maps = join_model(base, maps, model_map, model, manifest.motor)
    return write_results(report, maps, directory / "results", motor=manifest.motor.name, recording=manifest.name)


def join_model(
    base: EstimationReport,
    maps: Mapping[str, FluxMap],
    flux_map: FluxMap,
    model: DeliveredModel,
    motor: Motor,
) -> tuple[EstimationReport, dict[str, FluxMap]]:
    """The estimators' report and maps with a diagnosed model's map, which comes first if there is no objection.

    Parameters
    ----------
    base : EstimationReport
        Report of the estimators alone.
    """
    map_report = MapReport(basis=flux_map.basis, checks=MapChecks(), inductances=inductances_of(flux_map))
    # This model takes the place of one that was left out.
    base = base.model_copy(update={"remarks": tuple(r for r in base.remarks if r.code != MODEL_LEFT_OUT)})
    bare = base.without_check(MODEL)  # the diagnosed model's own check replaces it
    if bare.usable:
        base = bare.checked([missing_model("the fitted model is judged instead")])
    if model.objections:
        report = bare.model_copy(update={"maps": {**base.maps, flux_map.method: map_report}})
        report = report.checked(unmet(MODEL, model.objections))
    else:
        report = _recommended(bare, flux_map, map_report, model, motor)
        report = with_nameplate_checks(report, {flux_map.method: flux_map}, motor)
    fields: dict[str, Any] = {"model": model}
    if base.maps or base.resistance:
        fields["estimators"] = EstimatorsReport(**_fields(base))
    return report.model_copy(update=fields), {flux_map.method: flux_map, **maps}


def earlier_model(
    directory: Path, manifest: Manifest
) -> tuple[tuple[FluxMap, DeliveredModel] | None, tuple[Remark, ...]]:
    """The model that a diagnosis of the same segments left in a directory, and its map; None where there is none.

    A remark says which one was left out, because it is of other segments or cannot be read.
    """
    if not has_estimates(directory):
        return None, ()
    try:
        report = load_estimates(directory)
        model, method = report.model, report.model_method
        if model is None or method is None:
            return None, ()
        if model.segments != _digest(manifest):
            text = "the fitted model {title} is of other segments and left out: diagnose again"
            return None, (Remark.of(MODEL_LEFT_OUT, text, title=model.title),)
        return (load_flux_map(_map_file(directory, report, method)), model), ()
    except RecordingError as error:
        return None, (_unreadable(error),)


def _unreadable(error: RecordingError) -> Remark:
    return Remark.of("results_left_out", "earlier results are left out: {problem}", problem=str(error))


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
    """SHA-256 of the segments' entries in the manifest."""
    return sha256("\n".join(segment.model_dump_json() for segment in manifest.segments).encode()).hexdigest()


def _recommended(
    base: EstimationReport, model_map: FluxMap, map_report: MapReport, model: DeliveredModel, motor: Motor
) -> EstimationReport:
    """The report with the model's map first; remarks on the former first map stay there, crossings in the report."""
    unmet_codes = {check.remark.code for check in base.checks if not check.is_met}
    recomputed = {*_RECOMPUTED_REMARKS, *(remark.code for remark in model.resistance.remarks)}
    others = (r for r in base.remarks if r.code not in recomputed)
    kept_remarks = [r.by(base.method) if base.method and r.code in unmet_codes else r for r in others]
    resistance = model.resistance
    if base.resistance is not None:
        kept = {name: getattr(base.resistance, name) for name in ("readings", "inverter", "temperature_rise_k")}
        resistance = resistance.model_copy(update=kept)
    fields = {
        "method": model_map.method,
        "parity": None,
        "reciprocity_percent": None,
        "checks": (),
        "remarks": (*resistance.remarks, *kept_remarks),
        "maps": {model_map.method: map_report, **base.maps},
    }
    report = base.model_copy(update=fields).with_resistance(resistance)
    explains = Remark.of("model", "the model explains the recording: the diagnosis has no objection to its map")
    return report.checked(
        [
            met(MODEL, explains),
            flux_band(model_map, reference_flux_wb(model_map, motor), base.criteria),
            convex(model_map),
            *resistance_checks(resistance, motor, set(), base.criteria),
        ]
    )


def _estimator_results(directory: Path, method: str) -> tuple[EstimationReport, dict[str, FluxMap]]:
    """Report and maps (by method) of the estimators alone; empty where they did not run."""
    if not has_estimates(directory):
        return _NOTHING, {}
    try:
        report = load_estimates(directory)
        if report.estimators is None and report.model is not None:
            return _NOTHING, {}
        base = EstimationReport(**{**_fields(report.estimators or report), "files": {}})
        names = [name for name in base.maps if name != method]
        return base, {name: load_flux_map(_map_file(directory, report, name)) for name in names}
    except RecordingError as error:
        return _NOTHING.model_copy(update={"remarks": (_unreadable(error),)}), {}


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
