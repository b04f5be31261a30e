"""A small measurement as a laboratory would bring it, and ways to write it down in any frame, unit and file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import yaml
from numpy.typing import NDArray

from orchestrator.importing import ImportReport, import_files
from orchestrator.recording import open_recording
from protocols import Capture

Numbers = NDArray[np.float64]

RATE = 1e4
MOTOR: dict[str, Any] = {
    "name": "bench motor",
    "pole_pairs": 2,
    "rated_current_rms_a": 1.66,
    "stator_resistance_ohm": 4.25,
}
DRIVE: dict[str, Any] = {"name": "laboratory", "dc_bus_voltage_v": 540.0}
PHASES: dict[str, Any] = {"a": "ia", "b": "ib", "c": "ic"}


def in_phases(x_ab: Numbers) -> Numbers:
    """Phase quantities of vectors: the projections on the axes of the phases."""
    axes = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0
    return x_ab[:, :1] * np.cos(axes) + x_ab[:, 1:] * np.sin(axes)


def held_current(n: int = 400, noise_a: float = 0.01, seed: int = 0) -> tuple[Numbers, Numbers]:
    """Current and voltage of a held vector at the angle of 0.4 rad, shape (n, 2) each."""
    rng = np.random.default_rng(seed)
    i = 2.0 * np.array([np.cos(0.4), np.sin(0.4)]) + noise_a * rng.normal(size=(n, 2))
    v = np.tile(4.25 * 2.0 * np.array([np.cos(0.4), np.sin(0.4)]), (n, 1))
    return i, v


@dataclass
class Bench:
    """A measurement to be spoilt: columns by name, the mapping that describes them, and a folder for both."""

    folder: Path
    columns: dict[str, Any]
    mapping: dict[str, Any]
    files: dict[str, dict[str, Any]] = field(default_factory=dict)

    def run(self, out: str = "recording") -> ImportReport:
        """Write everything and import it."""
        paths = [
            write_table(self.folder / name, columns)
            for name, columns in (self.files or {"log.csv": self.columns}).items()
        ]
        return import_files(self.write_mapping(), paths, self.folder / out)

    def write_mapping(self) -> Path:
        path = self.folder / "mapping.yaml"
        path.write_text(yaml.safe_dump(self.mapping, sort_keys=False))
        return path

    def captures(self, out: str = "recording") -> list[Capture]:
        recording = open_recording(self.folder / out)
        return [recording.load(segment) for segment in recording.segments()]


def write_table(path: Path, columns: Mapping[str, Any]) -> Path:
    """Columns as CSV or Parquet, chosen by the ending."""
    table = pa.table({name: np.asarray(values) for name, values in columns.items()})
    if path.suffix == ".csv":
        pa.csv.write_csv(table, path)
    else:
        pa.parquet.write_table(table, path)
    return path


def phase_log(i_ab: Numbers, v_ab: Numbers) -> tuple[dict[str, Any], dict[str, Any]]:
    """Columns with time, three phase currents and phase voltages, and a mapping that fits them."""
    columns: dict[str, Any] = {"t": np.arange(len(i_ab)) / RATE}
    columns |= dict(zip(("ia", "ib", "ic"), in_phases(i_ab).T, strict=True))
    columns |= dict(zip(("va", "vb", "vc"), in_phases(v_ab).T, strict=True))
    mapping = {
        "format": "fluxbench-import",
        "version": 1,
        "name": "bench",
        "motor": dict(MOTOR),
        "drive": dict(DRIVE),
        "time": {"column": "t", "unit": "s"},
        "current": {"frame": "abc", "columns": dict(PHASES), "unit": "A"},
        "voltage": {"frame": "abc", "columns": {"a": "va", "b": "vb", "c": "vc"}, "unit": "V"},
        "rotor_angle": {"value": 0.0, "unit": "rad"},
        "segments": [{"stage": "resistance", "settings": {"current_d_a": 2.0}}],
    }
    return columns, mapping


def left_in(folder: Path) -> Sequence[str]:
    """Everything in a folder that an import may have left, hidden or not."""
    return sorted(entry.name for entry in folder.iterdir() if entry.name not in ("mapping.yaml", "log.csv"))
