"""Write a flux map in the forms that other tools read, each file whole or not at all, and say what became of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import Path

from orchestrator.exporting._c_header import c_float_file, c_q15_file
from orchestrator.exporting._fmu import fmu_file
from orchestrator.exporting._matlab_files import simulink_file, syre_file
from orchestrator.exporting._motulator_script import motulator_file
from orchestrator.exporting._numeric_files import csv_file, netcdf_file, npz_file
from orchestrator.exporting._products import Products, Written
from orchestrator.exporting._simulator_tables import ltspice_file, modelica_file, plecs_file
from orchestrator.recording import replace_file
from protocols import FluxMap, InputError, Motor, StorageError, Strict

FORMATS: dict[str, str] = {
    "netcdf": "NetCDF: the map with torque, saliency, inverse map, MTPA and MTPV",
    "csv": "one row a measured grid point, units in the column names",
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
"""Name of each format, and what it is."""

_WRITERS: dict[str, tuple[str, Callable[[Products], Written]]] = {
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
    """One file that was written."""

    format: str
    path: Path
    measured_percent: float
    """Share of its nodes that stand on measurement; the others are NaN, left out or continued."""
    filled_nodes: int
    """Nodes that were continued by least curvature, because the format cannot say NaN."""
    notes: tuple[str, ...]


class ExportReport(Strict):
    """What an export wrote; the JSON contract of `fluxbench export --json`."""

    files: tuple[ExportedFile, ...]
    """In the order asked for."""
    measured_percent: float
    """Share of the map's grid that was measured."""
    inverse_coverage_percent: float
    """Share of the measured points whose current the inverse map gives back."""
    inverse_misfit_wb: float
    """Largest |psi(i(psi)) - psi| at the inverse map's measured nodes."""
    non_convex_points: int
    """Where the energy is not convex: there the inverse gives back one of several currents of the same flux."""
    notes: tuple[str, ...]


def export_map(
    flux_map: FluxMap, motor: Motor, out: Path, formats: Sequence[str] | None = None, *, recording: str = ""
) -> ExportReport:
    """Write a flux map into a folder, in every format asked for.

    Everything is computed before the first file is written; each file is replaced atomically.

    Parameters
    ----------
    flux_map : FluxMap
    motor : Motor
        Pole pairs for the torque; resistance (as measured, if it was) and magnet flux are used where they are known.
    out : Path
        A folder; made where it does not exist.
    formats : sequence of str, optional
        Of `FORMATS`; all that the map has enough for, unless told.
    recording : str
        Name of what the map is of; it stands in every file.

    Raises
    ------
    InputError
        Where a format is unknown, the map cannot be interpolated, or lacks what a format that was asked for needs.
    StorageError
        Where a file cannot be written.
    """
    for name in formats or ():
        if name not in FORMATS:
            close = get_close_matches(name, FORMATS, 1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise InputError("export", name, f"no such format{hint} There are {', '.join(FORMATS)}")
    products = Products(flux_map, motor, recording)
    made, left_out = _made(products, formats)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{out}: cannot be made: {error.strerror or error}") from error
    files = []
    for name, written in made.items():
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
        notes=(*products.notes, *left_out),
    )


def _made(products: Products, formats: Sequence[str] | None) -> tuple[dict[str, Written], list[str]]:
    """What goes into the files, by format; and why some were left out, where they were not asked for by name."""
    _ = products.inverse  # what no format can do without says what is wrong with the map
    made, left_out = {}, []
    for name in dict.fromkeys(FORMATS if formats is None else formats):
        try:
            made[name] = _WRITERS[name][1](products)
        except InputError as error:
            if formats is not None:
                raise
            left_out.append(f"no {name} file: {error.problem}")
    return made, left_out
