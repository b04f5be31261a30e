"""Converts a result's CSV file to a capture by the importer, which checks it, and its mapping."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import yaml

from orchestrator.importing import Finding, import_files
from orchestrator.recording import open_recording
from orchestrator.validation.plain_files import read_text
from protocols import Capture, DriveFault, Excitation, FaultCause, FluxbenchError, InputError, Motor, SegmentStage

STAGES = {
    "gates_off": SegmentStage.GATES_OFF,
    "hold": SegmentStage.RESISTANCE,
    "trapezoid": SegmentStage.CLASSICAL,
    "injection": SegmentStage.INJECTION,
}
COLUMNS = (
    "time",
    "current",
    "voltage",
    "phase_currents",
    "bus",
    "temperature",
    "csv",
    "accept",
    "rotor_angle",
    "resample",
)
"""The sections of a mapping that describe columns; the excitation determines the others."""


def read_columns(path: Path) -> dict[str, Any]:
    """The mapping's sections about columns; raises `InputError` where the file is not a mapping."""
    try:
        mapping = yaml.safe_load(read_text(path))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise InputError(str(path), "", f"cannot be read as a mapping: {str(error).splitlines()[0]}") from None
    if not isinstance(mapping, dict) or not {"current", "voltage"} <= mapping.keys():
        raise InputError(str(path), "", "expected the sections current and voltage of an import's mapping")
    return {name: mapping[name] for name in COLUMNS if name in mapping}


def read_result(
    path: Path, columns: dict[str, Any], excitation: Excitation, motor: Motor, drive: dict[str, Any], fs: float
) -> Capture:
    """The capture that a result file holds; raises `DriveFault` (wrong_data) where it does not fit the request."""
    mapping = {
        "format": "fluxbench-import",
        "version": 1,
        "name": path.stem,
        "motor": {name: value for name, value in motor.model_dump(mode="json").items() if value is not None},
        "drive": drive,
        "sampling_frequency_hz": fs,
        "rotor_angle": {"value": excitation.rotor_angle_rad, "unit": "rad"},
        **columns,
        "accept": [*columns.get("accept", ()), *_expected_findings(excitation, motor)],
        "segments": [{"stage": STAGES[excitation.kind].value}],
    }
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "mapping.yaml"
        written.write_text(yaml.safe_dump(mapping), encoding="utf-8")
        try:
            import_files(written, [path], Path(folder) / "recording")
            recording = open_recording(Path(folder) / "recording")
            capture = recording.load(recording.segments()[0])
        except FluxbenchError as error:
            reason = str(error).replace(str(written), "the mapping")
            raise DriveFault(FaultCause.WRONG_DATA, reason) from None
    rows = excitation.rows(fs)
    if len(capture) != rows:
        raise DriveFault(FaultCause.WRONG_DATA, f"{path}: {len(capture)} rows, {rows} were requested")
    return capture


def _expected_findings(excitation: Excitation, motor: Motor) -> tuple[str, ...]:
    """Findings of the importer that are intended for a measurement at zero current."""
    is_small = excitation.longest_current_a < 0.05 * (motor.rated_current_a or 0.0)
    at_rest = is_small and excitation.kind in ("hold", "gates_off")
    return tuple(f.value for f in (Finding.CURRENT_UNIT, Finding.VOLTAGE_UNIT, Finding.CONSTANT_VOLTAGE) if at_rest)
