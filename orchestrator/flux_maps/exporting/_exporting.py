"""Writing of a flux map in other tools' formats, each file completely or not at all, with a report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import Path

from orchestrator.flux_maps.exporting._c_header import c_float_file, c_q15_file
from orchestrator.flux_maps.exporting._fmu import fmu_file
from orchestrator.flux_maps.exporting._matlab_files import simulink_file, syre_file
from orchestrator.flux_maps.exporting._motulator_script import motulator_file
from orchestrator.flux_maps.exporting._numeric_files import csv_file, netcdf_file, npz_file
from orchestrator.flux_maps.exporting._products import FileContent, Products
from orchestrator.flux_maps.exporting._simulator_tables import ltspice_file, modelica_file, plecs_file
from orchestrator.formatting.sentences import listed
from orchestrator.recording import replace_file
from protocols import FluxMap, InputError, Motor, StorageError, Strict

FORMATS: dict[str, str] = {
    "netcdf": "NetCDF: the map with torque, saliency, inverse map, MTPA and MTPV",
    "csv": "one row per measured grid point, units in the column names",
    "syre": "MATLAB, SyR-e layout: Id, Iq, Fd, Fq, T with i_d along the columns",
    "simulink": "MATLAB, parameters of the Flux-Based PMSM block: id, iq over 51 x 51 fluxes",
    "npz": "NumPy, as motulator reads it: complex i_s_dq, psi_s_dq",
    "c": "C header: tables and lookups in float",
    "c-q15": "C header: tables and lookups in 16-bit fixed point with scale factors",
    "modelica": "text file of CombiTable2Ds tables: fluxes over currents, currents over fluxes",
    "plecs": "initialisation commands: axes and tables for 2D-Table blocks",
    "ltspice": "subcircuit of the machine in the dq frame",
    "fmu": "FMI 2.0 co-simulation: voltages and speed in, currents and torque out",
    "motulator": "script that runs the machine in motulator's drive; takes the npz",
}
"""Name and description of each format."""

_WRITERS: dict[str, tuple[str, Callable[[Products], FileContent]]] = {
    "netcdf": ("flux_map.nc", netcdf_file),
    "csv": ("flux_map.csv", csv_file),
    "syre": ("flux_map_syre.mat", syre_file),
    "simulink": ("flux_based_pmsm.mat", simulink_file),
    "npz": ("flux_map.npz", npz_file),
    "c": ("flux_map.h", c_float_file),
    "c-q15": ("flux_map_q15.h", c_q15_file),
    "modelica": ("flux_map_modelica.txt", modelica_file),
    "plecs": ("flux_map_plecs.m", plecs_file),
    "ltspice": ("flux_map_ltspice.lib", ltspice_file),
    "fmu": ("machine.fmu", fmu_file),
    "motulator": ("flux_map_motulator.py", motulator_file),
}


class ExportedFile(Strict):
    """One written file."""

    format: str
    path: Path
    measured_percent: float
    """Share of measured nodes; the others are NaN, omitted or continued."""
    filled_nodes: int
    """Nodes that were continued by least curvature, because the format has no NaN."""
    notes: tuple[str, ...]


class ExportReport(Strict):
    """The files of an export; the JSON contract of `fluxbench export --json`."""

    files: tuple[ExportedFile, ...]
    """The files in the requested order."""
    measured_percent: float
    """Share of the map's grid that was measured."""
    inverse_coverage_percent: float
    """Share of the measured points whose current the inverse map reproduces."""
    inverse_misfit_wb: float
    """Largest |psi(i(psi)) - psi| at the inverse map's measured nodes."""
    non_convex_points: int
    """Points where the energy is not convex: there the inverse gives one of several currents of the same flux."""
    notes: tuple[str, ...]
    caution: str = ""
    """Why the map is not to be relied on, which is the first of the notes; empty where it is usable or not known."""


def _suggestion(name: str) -> str:
    """The formats that an unknown name may mean; empty where it resembles none."""
    if get_close_matches(name.lower(), ["matlab"]):
        return f"MATLAB reads {listed([key for key, text in FORMATS.items() if text.startswith('MATLAB')])}; "
    close = get_close_matches(name, FORMATS, 1)
    return f"did you mean {close[0]}? " if close else ""


def export_map(
    flux_map: FluxMap,
    motor: Motor,
    out: Path,
    formats: Sequence[str] | None = None,
    *,
    recording: str = "",
    caution: str = "",
    resistance: str = "",
) -> ExportReport:
    """Write a flux map into a folder, in every requested format.

    Everything is computed before the first file is written; each file is replaced atomically.

    Parameters
    ----------
    flux_map : FluxMap
    motor : Motor
        Pole pairs for the torque; resistance (measured, if available) and magnet flux where they are known.
    out : Path
        A folder, created if missing.
    formats : sequence of str, optional
        Names of `FORMATS`; by default all that the map suffices for.
    recording : str
        Name of the map's recording, for every file.
    caution : str
        Why the map is not to be relied on, for every file that has notes.
    resistance : str
        At which temperature R_s holds, likewise.

    Raises
    ------
    InputError
        Where a format is unknown, or the map cannot be interpolated or does not suffice for a requested format.
    StorageError
        Where a file cannot be written.
    """
    for name in formats or ():
        if name not in FORMATS:
            raise InputError("export", name, f"no such format; {_suggestion(name)}there are {', '.join(FORMATS)}")
    products = Products(flux_map, motor, recording, caution, resistance)
    contents, omitted = _contents(products, formats)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{out}: cannot be created: {error.strerror or error}; --out names another place") from error
    files = []
    for name, written in contents.items():
        path = out / _WRITERS[name][0]
        replace_file(path, written.content)
        files.append(
            ExportedFile(
                format=name,
                path=path,
                measured_percent=written.measured_percent,
                filled_nodes=written.filled_nodes,
                notes=written.notes,
            )
        )
    return ExportReport(
        files=tuple(files),
        measured_percent=products.measured_percent,
        inverse_coverage_percent=products.inverse.coverage_percent,
        inverse_misfit_wb=products.inverse.misfit_wb,
        non_convex_points=len(products.audit.non_convex),
        notes=(*products.notes, *omitted),
        caution=caution,
    )


def _contents(products: Products, formats: Sequence[str] | None) -> tuple[dict[str, FileContent], list[str]]:
    """Contents of the files by format, and notes on omitted ones that were not requested by name."""
    _ = products.inverse  # every format needs it, so that its error comes first
    contents, omitted = {}, []
    for name in dict.fromkeys(FORMATS if formats is None else formats):
        try:
            contents[name] = _WRITERS[name][1](products)
        except InputError as error:
            if formats is not None:
                raise
            omitted.append(f"no {name} file: {error.problem}")
    return contents, omitted
