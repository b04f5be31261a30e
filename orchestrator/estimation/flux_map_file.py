"""Flux maps as NetCDF files: dimensions (i_d, i_q), units and conventions in attributes. Computes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from orchestrator.memory import require_memory
from orchestrator.numerics.types import Array
from orchestrator.recording import replace_file
from protocols import Basis, FluxMap, RecordingError

if TYPE_CHECKING:
    import xarray as xr


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


def save_flux_map(path: Path, flux_map: FluxMap, *, motor: str = "", recording: str = "") -> None:
    """Write a map as NetCDF, whole or not at all.

    Parameters
    ----------
    path : Path
        Its folder must exist.
    motor, recording : str
        Names, kept as attributes.

    Raises
    ------
    StorageError
        Where it cannot be written.
    """
    # Made in memory: on a full disk the HDF5 library takes the whole process with it.
    replace_file(path, bytes(flux_dataset(flux_map, motor=motor, recording=recording).to_netcdf(engine="h5netcdf")))


def flux_dataset(flux_map: FluxMap, *, motor: str = "", recording: str = "") -> xr.Dataset:
    """A map with named dimensions, units and conventions: what `save_flux_map` writes."""
    import xarray as xr

    fields = {}
    for name, unit in _UNITS.items():
        fields[name] = (("i_d", "i_q"), getattr(flux_map, name), {"units": unit, "long_name": _NAMES[name]})
        std = {"units": unit, "long_name": f"standard deviation of {name}"}
        fields[f"{name}_std"] = (("i_d", "i_q"), getattr(flux_map, f"{name}_std"), std)
    axes = {
        name: ((name,), getattr(flux_map, name), {"units": "A", "long_name": f"{name[-1]}-axis current"})
        for name in ("i_d", "i_q")
    }
    attributes = {
        "title": "current-flux relations of a permanent-magnet synchronous motor, rotor locked",
        "method": flux_map.method,
        "basis": flux_map.basis.value if flux_map.basis else "",
        "motor": motor,
        "recording": recording,
        "conventions": _CONVENTIONS,
    }
    return xr.Dataset(fields, axes, attributes)


def load_flux_map(path: Path) -> FluxMap:
    """Read a map that `save_flux_map` (or anybody, with these names) wrote.

    Inductances that are not there are the slopes of the flux: exact in the middle of a grid's step, and half the
    sum of both mutual ones for `l_dq`.

    Raises
    ------
    RecordingError
        Where the file is missing, not NetCDF, lacks i_d, i_q, psi_d or psi_q, or an axis does not increase.
    """
    import xarray as xr

    if not path.is_file():
        raise RecordingError(str(path), "", "no such file")
    names = [name for quantity in _UNITS for name in (quantity, f"{quantity}_std")]
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            present = ", ".join(map(str, dataset.variables)) or "none"
            found = dataset[[name for name in ("i_d", "i_q", *names) if name in dataset.variables]]
            require_memory(path, found.nbytes, "its tables")
            held = found.load()
    # The HDF5 library says RuntimeError of a file that is cut off, and more of one that is something else.
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError, EOFError) as error:
        problem = f"not a readable NetCDF file: {str(error).splitlines()[0] if str(error) else error!r}"
        raise RecordingError(str(path), "", problem) from None
    for name in ("i_d", "i_q", "psi_d", "psi_q"):
        if name not in held.variables:
            raise RecordingError(str(path), name, f"variable missing; the file has {present}")
    axes = {name: _axis(path, held, name) for name in ("i_d", "i_q")}
    grids = {name: _grid(path, held, name) for name in names if name in held.variables}
    shape = (len(axes["i_d"]), len(axes["i_q"]))
    slopes = _slopes(axes["i_d"], axes["i_q"], grids["psi_d"], grids["psi_q"])
    grids.update({name: slope for name, slope in slopes.items() if name not in grids})
    grids.update({name: np.full(shape, np.nan) for name in names if name not in grids})
    basis = next((one for one in Basis if one.value == held.attrs.get("basis")), None)
    return FluxMap(method=str(held.attrs.get("method", "")), basis=basis, **axes, **grids)


def _axis(path: Path, held: xr.Dataset, name: str) -> Array:
    values = _numbers(path, held, name)
    if held[name].dims != (name,) or len(values) < 2 or not (np.diff(values) > 0.0).all():
        raise RecordingError(str(path), name, "expected a coordinate of at least two increasing currents")
    return values


def _grid(path: Path, held: xr.Dataset, name: str) -> Array:
    if set(held[name].dims) != {"i_d", "i_q"}:
        raise RecordingError(str(path), name, f"expected dimensions (i_d, i_q), got {held[name].dims}")
    return _numbers(path, held.transpose("i_d", "i_q", ...), name)


def _numbers(path: Path, held: xr.Dataset, name: str) -> Array:
    try:
        return held[name].to_numpy().astype(np.float64)
    except (TypeError, ValueError):
        raise RecordingError(str(path), name, f"expected numbers, got {held[name].dtype}") from None


def _slopes(i_d: Array, i_q: Array, psi_d: Array, psi_q: Array) -> dict[str, Array]:
    return {
        "l_dd": np.gradient(psi_d, i_d, axis=0),
        "l_dq": 0.5 * (np.gradient(psi_d, i_q, axis=1) + np.gradient(psi_q, i_d, axis=0)),
        "l_qq": np.gradient(psi_q, i_q, axis=1),
    }
