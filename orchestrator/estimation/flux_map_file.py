"""Flux maps as NetCDF files: dimensions (i_d, i_q), units and conventions in attributes.

Files are written and read by h5netcdf directly: importing xarray takes longer than all estimators together.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orchestrator.numerics.types import Array
from orchestrator.recording import replace_file
from orchestrator.validation.memory import require_memory
from protocols import Basis, FluxMap, RecordingError

if TYPE_CHECKING:
    import xarray as xr


_AXES = ("i_d", "i_q")
_PACKING = (("scale_factor", 1.0), ("add_offset", 0.0))
_UNITS = {"psi_d": "Wb", "psi_q": "Wb", "l_dd": "H", "l_dq": "H", "l_qq": "H"}
_NAMES = {
    "psi_d": "d-axis flux linkage",
    "psi_q": "q-axis flux linkage",
    "l_dd": "incremental inductance dpsi_d/di_d",
    "l_dq": "incremental cross inductance dpsi_d/di_q = dpsi_q/di_d",
    "l_qq": "incremental inductance dpsi_q/di_q",
}
_CONVENTIONS = (
    "peak-valued dq vectors (amplitude-invariant Clarke), electrical angles, believed rotor angle; "
    "psi(0, 0) = (pm_flux_wb of the nameplate, or 0 where unknown; 0); NaN outside the measured hull; "
    "_std: one standard deviation"
)


def save_flux_map(path: Path, flux_map: FluxMap, *, motor: str = "", recording: str = "", model: str = "") -> None:
    """Write a map as NetCDF, whole or not at all.

    Parameters
    ----------
    path : Path
        Its folder must exist.
    motor, recording : str
        Names, kept as attributes.
    model : str
        Description of the model; an attribute too.

    Raises
    ------
    StorageError
        Where it cannot be written.
    """
    import h5netcdf

    # Written to memory first: on a full disk the HDF5 library ends the whole process.
    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        file.attrs.update(_attributes(flux_map, motor, recording) | ({"model": model} if model else {}))
        file.dimensions = {name: len(getattr(flux_map, name)) for name in _AXES}
        for name, dimensions, values, described in _variables(flux_map):
            variable = file.create_variable(name, dimensions, data=values, fillvalue=np.nan)
            variable.attrs.update(described)
    replace_file(path, buffer.getvalue())


def flux_dataset(flux_map: FluxMap, *, motor: str = "", recording: str = "") -> xr.Dataset:
    """A map with named dimensions, units and conventions: what `save_flux_map` writes."""
    import xarray as xr

    variables = {name: tuple(parts) for name, *parts in _variables(flux_map)}
    axes = {name: variables.pop(name) for name in _AXES}
    return xr.Dataset(variables, axes, _attributes(flux_map, motor, recording))


def _variables(flux_map: FluxMap) -> Iterator[tuple[str, tuple[str, ...], Array, dict[str, str]]]:
    """Name, dimensions, values and attributes of each."""
    for name in _AXES:
        yield name, (name,), getattr(flux_map, name), {"units": "A", "long_name": f"{name[-1]}-axis current"}
    for name, unit in _UNITS.items():
        yield name, _AXES, getattr(flux_map, name), {"units": unit, "long_name": _NAMES[name]}
        std = {"units": unit, "long_name": f"standard deviation of {name}"}
        yield f"{name}_std", _AXES, getattr(flux_map, f"{name}_std"), std


def _attributes(flux_map: FluxMap, motor: str, recording: str) -> dict[str, str]:
    return {
        "title": "current-flux relations of a permanent-magnet synchronous motor, rotor locked",
        "method": flux_map.method,
        "basis": flux_map.basis.value if flux_map.basis else "",
        "motor": motor,
        "recording": recording,
        "conventions": _CONVENTIONS,
    }


def load_own_flux_map(path: Path) -> FluxMap:
    """Read a map that `save_flux_map` wrote, in a millisecond or two; raises `RecordingError`."""
    import h5py

    names = [*_AXES, *(name for quantity in _UNITS for name in (quantity, f"{quantity}_std"))]
    try:
        with h5py.File(path, "r") as file:
            basis = str(file.attrs["basis"])
            require_memory(path, 8 * len(names) * int(np.prod(file["psi_d"].shape)), "its tables")
            tables = {name: _read_table(file, name) for name in names}
            return FluxMap(method=str(file.attrs["method"]), basis=Basis(basis) if basis else None, **tables)
    # The HDF5 library raises RuntimeError for a truncated file, and other errors for other formats.
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError, EOFError) as error:
        problem = f"not a flux map of this program: {str(error).splitlines()[0] if str(error) else error!r}"
        raise RecordingError(str(path), "", problem) from None


def _read_table(file: Any, name: str) -> Array:
    """A table by h5py's low-level functions, which are several times as fast as its objects."""
    from h5py import h5d, h5s

    dataset = h5d.open(file.id, name.encode())
    table = np.empty(dataset.shape)
    dataset.read(h5s.ALL, h5s.ALL, table)
    return table


def load_flux_map(path: Path) -> FluxMap:
    """Read a map written by `save_flux_map`, or by other software with these names.

    Missing inductances are the slopes of the flux: exact in the middle of a grid's step, and the mean of both mutual
    ones for `l_dq`.

    Raises
    ------
    RecordingError
        Where the file is missing, not NetCDF, lacks i_d, i_q, psi_d or psi_q, or an axis does not increase.
    """
    import h5netcdf
    import h5py

    if not path.is_file():
        raise RecordingError(str(path), "", "no such file")
    names = [name for quantity in _UNITS for name in (quantity, f"{quantity}_std")]
    try:
        # Where attributes are damaged, h5netcdf's constructor leaves an object that prints a traceback when deleted.
        with h5py.File(path, "r") as root:
            root.attrs.get("_nc3_strict")
        with h5netcdf.File(path, "r") as file:
            present = ", ".join(file.variables) or "none"
            found = {name: file.variables[name] for name in (*_AXES, *names) if name in file.variables}
            require_memory(path, sum(v.dtype.itemsize * int(np.prod(v.shape)) for v in found.values()), "its tables")
            attributes = dict(file.attrs)
            tables = {name: (variable.dimensions, _decoded(variable)) for name, variable in found.items()}
    # The HDF5 library raises RuntimeError for a truncated file, and other errors for other formats.
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError, EOFError) as error:
        problem = f"not a readable NetCDF file: {str(error).splitlines()[0] if str(error) else error!r}"
        raise RecordingError(str(path), "", problem) from None
    for name in (*_AXES, "psi_d", "psi_q"):
        if name not in tables:
            raise RecordingError(str(path), name, f"variable missing; the file has {present}")
    axes = {name: _axis(path, tables, name) for name in _AXES}
    grids = {name: _grid(path, tables, name) for name in names if name in tables}
    shape = (len(axes["i_d"]), len(axes["i_q"]))
    slopes = _slopes(axes["i_d"], axes["i_q"], grids["psi_d"], grids["psi_q"])
    grids.update({name: slope for name, slope in slopes.items() if name not in grids})
    grids.update({name: np.full(shape, np.nan) for name in names if name not in grids})
    basis = next((one for one in Basis if one.value == attributes.get("basis")), None)
    return FluxMap(method=str(attributes.get("method", "")), basis=basis, **axes, **grids)


_Tables = Mapping[str, tuple[tuple[str, ...], Any]]
"""Dimensions and values by the variable's name."""


def _decoded(variable: Any) -> Any:
    """The values of a variable as the CF conventions mean them: fill values as NaN, scale and offset applied."""
    values, attributes = variable[...], variable.attrs
    if np.asarray(values).dtype.kind not in "iuf":
        return values
    fills = [np.atleast_1d(attributes[name]) for name in ("_FillValue", "missing_value") if name in attributes]
    packed = "scale_factor" in attributes or "add_offset" in attributes
    if not packed and not fills:
        return values
    numbers = np.asarray(values, dtype=np.float64)
    if fills:
        numbers = np.where(np.isin(values, np.concatenate(fills)), np.nan, numbers)
    scale, offset = (float(np.squeeze(attributes.get(name, one))) for name, one in _PACKING)
    return numbers * scale + offset if packed else numbers


def _axis(path: Path, tables: _Tables, name: str) -> Array:
    values = _numbers(path, name, tables[name][1])
    if tables[name][0] != (name,) or len(values) < 2 or not (np.diff(values) > 0.0).all():
        raise RecordingError(str(path), name, "expected a coordinate of at least two increasing currents")
    return values


def _grid(path: Path, tables: _Tables, name: str) -> Array:
    dimensions, values = tables[name]
    if set(dimensions) != set(_AXES):
        raise RecordingError(str(path), name, f"expected dimensions (i_d, i_q), got {dimensions}")
    numbers = _numbers(path, name, values)
    return numbers if dimensions == _AXES else np.ascontiguousarray(numbers.T)


def _numbers(path: Path, name: str, values: Any) -> Array:
    try:
        return np.asarray(values).astype(np.float64)
    except (TypeError, ValueError):
        raise RecordingError(str(path), name, f"expected numbers, got {np.asarray(values).dtype}") from None


def _slopes(i_d: Array, i_q: Array, psi_d: Array, psi_q: Array) -> dict[str, Array]:
    return {
        "l_dd": np.gradient(psi_d, i_d, axis=0),
        "l_dq": 0.5 * (np.gradient(psi_d, i_q, axis=1) + np.gradient(psi_q, i_d, axis=0)),
        "l_qq": np.gradient(psi_q, i_q, axis=1),
    }
