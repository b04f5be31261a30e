"""A pass's results as one set of files: a kill leaves the old one, the new one, or no report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydantic import ValidationError

from orchestrator.estimation.flux_map_file import save_flux_map
from orchestrator.estimation.staging import staging_folder
from orchestrator.formatting.sentences import visible
from orchestrator.recording import replace_file
from orchestrator.validation.plain_files import read_bytes
from protocols import EstimationReport, FluxMap, RecordingError, StorageError

REPORT_NAME = "estimates.json"
RECOMMENDED_MAP = Path("results") / "flux_map.nc"


def has_estimates(directory: Path) -> bool:
    """Whether the ``results/`` of a directory has estimates."""
    return (directory / "results" / REPORT_NAME).is_file()


def load_estimates(directory: Path) -> EstimationReport:
    """The report that `write_results` wrote into the ``results/`` of a run or recording.

    Raises
    ------
    RecordingError
        Where it is missing or invalid.
    """
    path = directory / "results" / REPORT_NAME
    try:
        return EstimationReport.model_validate_json(read_bytes(path))
    except OSError as error:
        raise RecordingError(str(path), "", f"{error.strerror or error}; `fluxbench estimate` makes it") from None
    except ValidationError as error:
        first = error.errors()[0]
        raise RecordingError(str(path), ".".join(map(str, first["loc"])), str(first["msg"])) from None


def write_results(
    report: EstimationReport, maps: Mapping[str, FluxMap], folder: Path, *, motor: str, recording: str
) -> EstimationReport:
    """Replace the maps and the report in `folder`; returns the report with its files.

    Identical files of an earlier pass are kept with their time stamps.

    Parameters
    ----------
    maps : mapping of FluxMap
        By method; the recommended one becomes ``flux_map.nc``, the others ``flux_map_<method>.nc``.
    motor, recording : str
        Names, kept in the maps' attributes.

    Raises
    ------
    StorageError
        Where a result cannot be written.
    """
    named = {"flux_map" if m == report.method else f"flux_map_{m}": found for m, found in maps.items()}
    files = {**{name: f"{name}.nc" for name in named}, "estimates": REPORT_NAME}
    report = report.model_copy(update={"files": files})
    text = (visible(report.model_dump_json(indent=2)) + "\n").encode()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with staging_folder(folder, ".estimating-") as staging:
            for name, flux_map in named.items():
                about = {"motor": motor, "recording": recording, "model": _model_description(report, flux_map.method)}
                save_flux_map(staging / f"{name}.nc", flux_map, **about)
            if _is_same(folder, staging, text):
                return report
            # The report is removed first and written last: a present report matches all maps.
            (folder / REPORT_NAME).unlink(missing_ok=True)
            for old in folder.glob("flux_map*.nc"):
                old.unlink()
            for new in staging.glob("flux_map*.nc"):
                new.replace(folder / new.name)
    except OSError as error:
        raise StorageError(f"{folder}: cannot be written: {error.strerror or error}") from error
    replace_file(folder / REPORT_NAME, text)
    return report


def _model_description(report: EstimationReport, method: str) -> str:
    """Description of a map's model, for its file's attributes."""
    if report.model is not None and method == report.model_method:
        return f"fitted: {report.model.title}"
    return f"estimator {method}: no effect taken out by a diagnosis"


def _is_same(folder: Path, staging: Path, report: bytes) -> bool:
    """Whether the folder has this report and the staging's maps already, and no other map."""
    old, new = ({path.name: path.read_bytes() for path in one.glob("flux_map*.nc")} for one in (folder, staging))
    file = folder / REPORT_NAME
    return old == new and file.is_file() and file.read_bytes() == report
