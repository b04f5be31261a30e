"""The map of a whole model among a pass's results: recommended where nothing speaks against it. Estimates nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from orchestrator.estimation.flux_map_file import load_flux_map
from orchestrator.estimation.judgement import inductances_of
from orchestrator.estimation.nameplate import beside_nameplate
from orchestrator.estimation.results import RECOMMENDED_MAP, load_estimates, write_results
from protocols import (
    EstimationReport,
    EstimatorsReport,
    FluxMap,
    MapChecks,
    MapReport,
    Motor,
    RecordingError,
    Remark,
    ResistanceEstimate,
)

_OF_A_MAP = ("bad_crossings", "bad_parity", "bad_reciprocity", "methods_differ", "no_map", "unchecked")
"""Remarks that speak against the estimators' maps."""
_OF_NO_OTHER = ("no_map", "far_from_nameplate")
"""And those that are made anew of the model's."""


def deliver_model(
    directory: Path,
    found: FluxMap,
    resistance: ResistanceEstimate,
    objections: tuple[Remark, ...],
    *,
    motor: Motor,
    recording: str,
) -> EstimationReport:
    """Put a model's map and R_s among the results in a directory, in place of an earlier model's.

    Parameters
    ----------
    objections : tuple of Remark
        Where there are any, the map is kept beside the others; those keep their rank, and none of them is usable:
        what the model does not explain is in them too.
    motor : Motor
        The nameplate, beside which the model's R_s and inductances are held.
    recording : str
        Its name, kept in the maps' attributes.

    Raises
    ------
    StorageError
        Where a result cannot be written.
    """
    own, maps = _of_the_estimators(directory, found.method)
    told = MapReport(basis=found.basis, checks=MapChecks(), inductances=inductances_of(found))
    if objections:
        report = own.model_copy(update={"maps": {**own.maps, found.method: told}}).objected(objections)
    else:
        report = beside_nameplate(_recommended(own, found.method, told, resistance), {found.method: found}, motor)
    if own.maps or own.resistance:
        report = report.model_copy(update={"estimators": EstimatorsReport(**_fields(own))})
    maps = {found.method: found, **maps}
    return write_results(report, maps, directory / "results", motor=motor.name, recording=recording)


def _recommended(
    own: EstimationReport, method: str, told: MapReport, resistance: ResistanceEstimate
) -> EstimationReport:
    """The report with the model's map in first place; what was said against the one before is said of that one.

    Crossings stay: they are the recording's, whichever map is made of it.
    """
    others = (r for r in own.remarks if r.code not in _OF_NO_OTHER)
    rest = (r.by(own.method) if own.method and r.code in _OF_A_MAP else r for r in others)
    if own.resistance is not None:
        kept = {name: getattr(own.resistance, name) for name in ("readings", "inverter", "temperature_rise_k")}
        resistance = resistance.model_copy(update=kept)
    return _with(
        own,
        resistance=resistance,
        method=method,
        parity=None,
        reciprocity_percent=None,
        usable=True,
        remarks=(*resistance.remarks, *rest),
        maps={method: told, **own.maps},
    )


def _with(report: EstimationReport, **fields: Any) -> EstimationReport:
    return report.model_copy(update=fields)


def _of_the_estimators(directory: Path, method: str) -> tuple[EstimationReport, dict[str, FluxMap]]:
    """What the estimators alone found, and their maps by method; nothing where they have not been asked."""
    try:
        report = load_estimates(directory)
        own = EstimationReport(**_fields(report.estimators or report))
        folder = (directory / RECOMMENDED_MAP).parent
        names = [name for name in own.maps if name != method]
        files = {name: "flux_map.nc" if name == report.method else f"flux_map_{name}.nc" for name in names}
        return own, {name: load_flux_map(folder / file) for name, file in files.items()}
    except RecordingError:
        return _NOTHING, {}


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
