"""Flux maps as NetCDF files: dimensions (i_d, i_q), units and conventions in attributes. Computes nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from orchestrator.recording import replace_file
from protocols import FluxMap, RecordingError

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
        "motor": motor,
        "recording": recording,
        "conventions": _CONVENTIONS,
    }
    # Made in memory: on a full disk the HDF5 library takes the whole process with it.
    content = bytes(xr.Dataset(fields, axes, attributes).to_netcdf(engine="h5netcdf"))
    replace_file(path, content)


def load_flux_map(path: Path) -> FluxMap:
    """Read a map that `save_flux_map` (or anybody, with these names) wrote.

    Raises
    ------
    RecordingError
        Where the file is missing, not NetCDF, or lacks a variable or dimension.
    """
    import xarray as xr

    if not path.is_file():
        raise RecordingError(str(path), "", "no such file")
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            held = dataset.load()
    except (OSError, ValueError, KeyError) as error:
        problem = f"not a readable NetCDF file: {str(error).splitlines()[0] if str(error) else error!r}"
        raise RecordingError(str(path), "", problem) from None
    for name in ("i_d", "i_q", *_UNITS):
        if name not in held.variables:
            raise RecordingError(
                str(path), name, f"variable missing; the file has {', '.join(map(str, held.variables))}"
            )
    grids = {}
    for name in (n for unit in _UNITS for n in (unit, f"{unit}_std")):
        if name not in held:
            grids[name] = np.full((held.sizes["i_d"], held.sizes["i_q"]), np.nan)
        elif set(held[name].dims) != {"i_d", "i_q"}:
            raise RecordingError(str(path), name, f"expected dimensions (i_d, i_q), got {held[name].dims}")
        else:
            grids[name] = held[name].transpose("i_d", "i_q").to_numpy().astype(np.float64)
    axes = {name: held[name].to_numpy().astype(np.float64) for name in ("i_d", "i_q")}
    return FluxMap(method=str(held.attrs.get("method", "")), **axes, **grids)
