"""`fluxbench export` and `fluxbench import`: maps for other tools, measurements from other tools."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from orchestrator.cli._audit import motor_of
from orchestrator.cli._output import say, say_document, say_notes
from orchestrator.config import load_motor
from orchestrator.estimation import load_estimates
from orchestrator.exporting import export_map
from orchestrator.flux_maps import load_map
from orchestrator.importing import ImportReport, import_files, merge_recordings
from orchestrator.importing.guessing import guess_mapping
from orchestrator.presentation.quantities import percent
from orchestrator.recording import read_model
from orchestrator.runs import open_any
from protocols import InputError, Motor


def export(path: Path, formats: Sequence[str], motor: Path | None, out: Path | None, as_json: bool) -> int:
    """Write the flux map of a run, recording or map file for other tools."""
    flux_map = load_map(path)
    folder = out if out is not None else (path if path.is_dir() else path.parent) / "export"
    report = export_map(flux_map, _motor_of(path, motor), folder, list(formats) or None, recording=_recording_of(path))
    if as_json:
        say_document(report.model_dump_json(indent=2))
        return 0
    for file in report.files:
        say(f"{file.format}: {file.path}")
    say(f"{percent(report.measured_percent, 3)} of the grid was measured")
    say_notes(report.notes)
    return 0


def _motor_of(path: Path, motor: Path | None) -> Motor:
    found = motor_of(path, motor)
    if found is None:
        raise InputError(str(path), "--motor", "a map file does not say its motor: name a YAML file that does")
    measured = _measured_resistance(path)
    return found if measured is None else found.model_copy(update={"stator_resistance_ohm": measured})


def _measured_resistance(path: Path) -> float | None:
    """R_s as a run's estimates or a model have it; None for a map file."""
    if path.suffix == ".json":
        return read_model(path).r_s_ohm
    found = load_estimates(path).resistance if path.is_dir() else None
    return None if found is None else found.value_ohm


def _recording_of(path: Path) -> str:
    if path.suffix == ".json":
        return read_model(path).recording
    return open_any(path).manifest.name if path.is_dir() else path.name


def import_(mapping: Path, files: Sequence[Path], out: Path, as_json: bool) -> int:
    """Turn somebody else's measurements into a recording."""
    return _say_import(import_files(mapping, files, out), as_json)


def merge_import(recordings: Sequence[Path], out: Path, as_json: bool) -> int:
    """Make one recording of several."""
    return _say_import(merge_recordings(recordings, out), as_json)


def _say_import(report: ImportReport, as_json: bool) -> int:
    if as_json:
        say_document(report.model_dump_json(indent=2))
        return 0
    say(f"{report.recording}: {report.segments} segments, {report.samples} samples")
    if report.dropped_rows:
        why = ", ".join(f"{rows} ({why})" for why, rows in report.dropped_rows.items())
        say(f"left out of {report.rows} rows: {why}")
    say_notes(report.notes)
    return 0


def guess_import(files: Sequence[Path], out: Path | None, motor: Path | None, as_json: bool) -> int:
    """Write the mapping for a measurement file, and say what to look at in it."""
    if len(files) != 1:
        raise InputError("", "--guess", f"expected one measurement file, got {len(files)}")
    target = out if out is not None else Path(files[0].with_suffix(".yaml").name)
    if target.exists():
        raise InputError(str(target), "", "exists already, and nothing is overwritten: name another with --out")
    plate = None if motor is None else load_motor(motor).model_dump(exclude_defaults=True)
    guessed = guess_mapping(files[0], plate)
    try:
        target.write_text(guessed.text, encoding="utf-8")
    except OSError as error:
        raise InputError(str(target), "", f"cannot be written: {error.strerror or error}") from None
    if as_json:
        say_document(json.dumps({"mapping": str(target), "doubts": guessed.doubts}, indent=2))
        return 0
    say(f"{target}: read it, then: fluxbench import {target} {files[0]} --out DIR")
    say_notes(guessed.doubts)
    return 0
