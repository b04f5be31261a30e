"""Flux maps from files: NetCDF, CSV, NPZ, SyR-e's and Simulink's .mat, models, and any table by a mapping.

What a file lacks is differentiated or NaN.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.estimation import RECOMMENDED_MAP, load_flux_map
from orchestrator.flux_maps._arrays import first_line, mat_arrays, npz_arrays
from orchestrator.flux_maps._gridding import CSV_UNITS, TORQUE, MapFile, gridded
from orchestrator.flux_maps._mapped import read_mapped
from orchestrator.flux_maps._surface import require_usable
from orchestrator.numerics.types import Array
from orchestrator.recording import MANIFEST_NAME, RUN_FILE, read_model, require_recording
from orchestrator.validation.plain_files import MAX_FILE_SIZES, read_text
from protocols import FluxMap, InputError

_OPTIONAL = [name for name in CSV_UNITS if name not in ("psi_d", "psi_q")]
_TABLES = (".txt", ".tsv", ".parquet", ".pq")
"""Kinds of files that are read by a mapping only."""


_HINT = "; `fluxbench audit` of it prints a mapping that assigns its columns"


class UnknownLayoutError(InputError):
    """A file that may contain a flux map with unknown column names, which need a mapping."""


def load_map(path: Path) -> FluxMap:
    """The flux map alone of `read_map`."""
    return read_map(path).flux_map


def read_map(path: Path) -> MapFile:
    """Read a flux map: a run or recording with estimates, a .nc, .csv, .npz or .mat file, or a `model.json`.

    Any other table needs a mapping: a .yaml file with its name and the meaning of its columns (docs/audit.md).

    CSV and NPZ as `export_map` writes them (CSV columns may also end in `_Vs` for `_wb`, in any case); NPZ as
    motulator has it (complex `i_s_dq`, `psi_s_dq`); .mat in the SyR-e layout, bare or as `motorModel.FluxMap_dq`, SR
    axes turned to PM axes, or as Simulink's Flux-Based PM Controller takes it (`id_index, iq_index, lambda_d,
    lambda_q`). Points may come in any order; where they lie on no rectangular grid they are interpolated onto one. A
    model's map is without its effects.

    Inductances that a file lacks are derivatives of its flux; standard deviations that it lacks are NaN.

    Raises
    ------
    InputError
        Where the file is missing, of another kind, or holds no flux map; `UnknownLayoutError` where a mapping may help.
    RecordingError
        Where a directory has no map and is no recording, or a file is part of a recording instead.
    """
    if path.is_dir():
        if not (path / RECOMMENDED_MAP).is_file():
            require_recording(path)
            problem = f"no such file; `fluxbench estimate {path}` makes it, or notes which stages it lacks"
            raise InputError(str(path), str(RECOMMENDED_MAP), problem)
        return MapFile(_read_netcdf(path / RECOMMENDED_MAP))
    if path.suffix == ".json":
        if path.name in (RUN_FILE, MANIFEST_NAME):
            require_recording(path)
        from orchestrator.diagnosis import flux_map_of  # a late import, because it compiles

        return MapFile(flux_map_of(read_model(path)))
    readers = {".csv": _read_csv, ".npz": _read_npz, ".mat": _read_mat}
    if path.suffix not in (*readers, *_TABLES, ".nc", ".yaml", ".yml"):
        if not path.exists() and not path.suffix:
            require_recording(path)
        raise InputError(str(path), "", "expected a run, a recording, or a .nc, .csv, .npz, .mat, .json or .yaml file")
    if not path.is_file():
        raise InputError(str(path), "", "no such file")
    if path.suffix == ".nc":
        return MapFile(_read_netcdf(path))
    if path.suffix in _TABLES:
        raise UnknownLayoutError(str(path), "", f"a table with unknown columns{_HINT}")
    try:
        if path.suffix in (".yaml", ".yml"):
            return read_mapped(path)
        method, columns = readers[path.suffix](path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(str(path), "", f"cannot be read: {error}") from None
    return gridded(str(path), method, columns)


def _read_netcdf(path: Path) -> FluxMap:
    try:
        flux_map = load_flux_map(path)
    except RuntimeError as error:  # of the HDF5 library, on a damaged file
        raise InputError(str(path), "", f"not a readable NetCDF file: {first_line(error)}") from None
    require_usable(flux_map, str(path))
    return flux_map


def _read_csv(path: Path) -> tuple[str, dict[str, Array]]:
    lines = (
        line
        for line in read_text(path, MAX_FILE_SIZES.generated_bytes, "utf-8-sig").splitlines()
        if not line.startswith("#")
    )
    rows = list(csv.reader(lines))
    header = [name.strip().lower().replace("_vs", "_wb") for name in rows[0]] if rows else []
    wanted = {"i_d": "i_d_a", "i_q": "i_q_a"} | {name: f"{name}_{unit}" for name, unit in CSV_UNITS.items()}
    wanted[TORQUE] = TORQUE
    for name in ("i_d", "i_q", "psi_d", "psi_q"):
        if wanted[name] not in header:
            problem = f"no such column; the file has {', '.join(header) or 'none'}{_HINT}"
            raise UnknownLayoutError(str(path), wanted[name], problem)
    columns: dict[str, Array] = {}
    for name, column in wanted.items():
        if column in header:
            at = header.index(column)
            columns[name] = np.array([_number(path, column, k, row, at) for k, row in enumerate(rows[1:], 1) if row])
    return "csv", columns


def _number(path: Path, column: str, line: int, row: list[str], at: int) -> float:
    try:
        return float(row[at]) if row[at].strip() else float("nan")
    except (IndexError, ValueError):
        cell = repr(row[at]) if at < len(row) else "nothing"
        raise InputError(str(path), column, f"row {line}: expected a number, got {cell}") from None


def _read_npz(path: Path) -> tuple[str, dict[str, Array]]:
    content = npz_arrays(path)
    for name in ("i_s_dq", "psi_s_dq"):
        if name not in content or not np.iscomplexobj(content[name]):
            problem = f"expected a complex array; the file has {', '.join(content) or 'none'}{_HINT}"
            raise UnknownLayoutError(str(path), name, problem)
    i, psi = content["i_s_dq"], content["psi_s_dq"]
    columns = {"i_d": i.real, "i_q": i.imag, "psi_d": psi.real, "psi_q": psi.imag}
    columns |= {name: content[name] for name in _OPTIONAL if name in content}
    if "tau_M" in content:
        columns[TORQUE] = content["tau_M"]
    return str(content.get("method", "npz")), columns


def _read_mat(path: Path) -> tuple[str, dict[str, Array]]:
    content = mat_arrays(path)
    if isinstance(content.get("lambda_d"), np.ndarray):
        return _from_simulink(path, content)
    model = _struct(content, "motorModel")
    layout = _struct(model, "FluxMap_dq") if model else content
    for name in ("Id", "Iq", "Fd", "Fq"):
        if not isinstance(layout.get(name), np.ndarray):
            problem = f"no such array; expected SyR-e's Id, Iq, Fd, Fq, or id_index, lambda_d, ...{_HINT}"
            raise UnknownLayoutError(str(path), name, problem)
    axes = _struct(model, "data").get("axisType", _struct(content, "dataSet").get("axisType", "PM"))
    i_d, i_q, psi_d, psi_q = (np.asarray(layout[name], dtype=np.float64) for name in ("Id", "Iq", "Fd", "Fq"))
    if axes == "SR":  # SyR-e's reluctance axes: the magnet lies on -q
        i_d, i_q, psi_d, psi_q = -i_q, i_d, -psi_q, psi_d
    columns = {"i_d": i_d, "i_q": i_q, "psi_d": psi_d, "psi_q": psi_q}
    if isinstance(layout.get("T"), np.ndarray):
        columns[TORQUE] = np.asarray(layout["T"], dtype=np.float64)
    extras = _struct(content, "fluxbench")
    columns |= {name: np.asarray(extras[name], dtype=np.float64) for name in _OPTIONAL if name in extras}
    return str(extras.get("method", "syre")), columns


def _from_simulink(path: Path, content: Mapping[str, Any]) -> tuple[str, dict[str, Array]]:
    """The tables of the Flux-Based PM Controller block, without an export's continuation beyond measured points."""
    for name in ("id_index", "iq_index", "lambda_q"):
        if not isinstance(content.get(name), np.ndarray):
            raise InputError(str(path), name, "no such array; it goes with lambda_d")
    axes = [np.asarray(content[name], dtype=np.float64).ravel() for name in ("id_index", "iq_index")]
    i_d, i_q = np.meshgrid(*axes, indexing="ij")
    known = np.asarray(content.get("lambda_measured", np.ones(i_d.shape)), dtype=bool)
    columns = {"i_d": i_d, "i_q": i_q}
    for name, table in (("psi_d", content["lambda_d"]), ("psi_q", content["lambda_q"]), ("", known)):
        if np.shape(table) != i_d.shape:
            problem = f"of shape {np.shape(table)}, expected {i_d.shape}: rows along id_index"
            raise InputError(str(path), f"lambda_{name[-1:] or 'measured'}", problem)
        if name:
            columns[name] = np.where(known, np.asarray(table, dtype=np.float64), np.nan)
    extras = _struct(content, "fluxbench")
    columns |= {name: np.asarray(extras[name], dtype=np.float64).T for name in _OPTIONAL if name in extras}
    return str(extras.get("method", "simulink")), columns


def _struct(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    value = content.get(name)
    return value if isinstance(value, dict) else {}
