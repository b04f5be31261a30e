"""Maps for other tools, from a run, a recording, a map file or a model."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from protocols import InputError, Motor

if TYPE_CHECKING:
    from orchestrator.flux_maps.exporting import ExportReport


def export(
    place: str | PathLike[str],
    *formats: str,
    motor: Motor | str | PathLike[str] | None = None,
    out: str | PathLike[str] | None = None,
) -> ExportReport:
    """Write flux map, torque and saliency for other tools.

    Parameters
    ----------
    place : path
        A run, a recording, a map file, or a model.json.
    formats : str
        Names of the formats; all by default.
    motor : Motor or path, optional
        The motor, or a YAML file with it, for a map file without one.
    out : path, optional
        Folder to write to; by default ``export/`` beside the source.

    Raises
    ------
    InputError
        Where there is no map or no motor, or no format of such a name.
    StorageError
        Where a file cannot be written.
    """
    from orchestrator.flux_maps import load_map, resistance_basis, with_magnet
    from orchestrator.flux_maps.exporting import export_map
    from orchestrator.runs import is_run, refuse_file

    path = Path(place)
    folder = Path(out) if out is not None else (path if path.is_dir() else path.parent) / "export"
    refuse_file(folder)
    flux_map = load_map(path)
    motor_used, recording = motor_and_recording(path, motor)
    flux_map = with_magnet(flux_map, motor_used)
    caution = _caution(path)
    ohm = motor_used.stator_resistance_ohm
    resistance = resistance_basis(ohm, winding_c(path)) if ohm is not None and is_run(path) else ""
    return export_map(
        flux_map, motor_used, folder, formats or None, recording=recording, caution=caution, resistance=resistance
    )


def winding_c(path: Path) -> float | None:
    """Temperature of the winding when a run began [°C]: that of the room; None where it is not known."""
    from orchestrator.runs import RunDirectory, is_run

    return RunDirectory.open(path).record.procedure.about.ambient_c if is_run(path) else None


def _caution(path: Path) -> str:
    """Why the delivered map of a run is not to be relied on; empty where it is usable, or another map is exported."""
    from orchestrator.estimation import load_estimates
    from protocols import RecordingError, Usability

    try:
        run = path if path.is_dir() else path.resolve().parent.parent
        report = load_estimates(run)
    except RecordingError:
        return ""
    is_delivered = path.is_dir() or path.resolve() == (run / "results" / report.files.get("flux_map", "")).resolve()
    if not is_delivered or report.usability is Usability.USABLE:
        return ""
    if report.usability is Usability.NOT_JUDGED:
        name = path if path.is_dir() else run.name
        return f"the map is not judged: `fluxbench diagnose {name}` decides whether it is usable"
    why = next((remark.text for remark in report.remarks), "its checks failed")
    return f"the map is not usable: {why}"


def motor_and_recording(path: Path, motor: Motor | str | PathLike[str] | None) -> tuple[Motor, str]:
    """The motor, with the measured R_s where there is one, and the name of what was measured."""
    from orchestrator.config import load_motor
    from orchestrator.estimation import load_estimates
    from orchestrator.recording import read_model
    from orchestrator.runs import open_any
    from orchestrator.validation.plain_files import read_text

    measured: float | None = None
    chosen: Motor | None = None
    name = _folder_of(path)
    if path.suffix == ".json":
        model = read_model(path)
        chosen, measured = model.motor, model.r_s_ohm
    elif path.is_dir():
        chosen = open_any(path).manifest.motor
        resistance = load_estimates(path).resistance
        measured = None if resistance is None else resistance.value_ohm
    elif path.suffix in (".yaml", ".yml") and "motor:" in read_text(path):
        chosen = load_motor(path)  # the mapping of a table names its motor
    if motor is not None:
        given = motor if isinstance(motor, Motor) else load_motor(Path(motor))
        if chosen is not None and given != chosen:
            problem = f"{chosen.name}'s map was measured, and {given.name} is another motor: leave it out (--motor)"
            raise InputError(str(path), "motor", problem)
        chosen = given
    if chosen is None:
        raise InputError(str(path), "motor", "a map file has no motor: give it or its YAML file (--motor)")
    return chosen if measured is None else chosen.model_copy(update={"stator_resistance_ohm": measured}), name


def _folder_of(path: Path) -> str:
    """Folder of the run or recording that a path is or belongs to; else the file's own name."""
    from orchestrator.recording import MANIFEST_NAME
    from orchestrator.runs import is_run

    folders = (path.resolve(), *path.resolve().parents[:2])
    return next((folder.name for folder in folders if is_run(folder) or (folder / MANIFEST_NAME).is_file()), path.name)
