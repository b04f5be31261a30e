"""Flux maps as NetCDF, CSV and NPZ: formats with NaN, so that nothing in them is continued."""

from __future__ import annotations

import csv
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.estimation import save_flux_map
from orchestrator.flux_maps import CSV_UNITS
from orchestrator.flux_maps.exporting._products import FileContent, Products
from orchestrator.flux_maps.exporting._torque import Trajectory
from orchestrator.numerics.types import Array


def netcdf_file(products: Products) -> FileContent:
    """The map's NetCDF file with torque, saliency, inverse map, MTPA and MTPV."""
    import xarray as xr

    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "flux_map.nc"
        save_flux_map(plain, products.flux_map, motor=products.motor.name, recording=products.recording)
        with xr.open_dataset(plain, engine="h5netcdf") as opened:
            dataset = opened.load()
    dataset.attrs |= {"pole_pairs": products.motor.pole_pairs, "notes": "\n".join(products.notes)}
    for name, (values, unit, meaning) in _grids(products).items():
        dataset[name] = (("i_d", "i_q"), values, {"units": unit, "long_name": meaning})
    inverse = products.inverse
    for axis, nodes in (("flux_d", inverse.psi_d), ("flux_q", inverse.psi_q)):
        dataset[axis] = ((axis,), nodes, {"units": "Wb", "long_name": f"{axis[-1]}-axis flux linkage of the inverse"})
    for name, table in (("inverse_i_d", inverse.i_d), ("inverse_i_q", inverse.i_q)):
        meaning = f"{name[-1]}-axis current against flux linkage"
        dataset[name] = (("flux_d", "flux_q"), table, {"units": "A", "long_name": meaning})
    for name, curve, unit in (("mtpa", products.mtpa, "A"), ("mtpv", products.mtpv, "Wb")):
        if curve is not None:
            for field, (values, field_unit) in _columns(curve, unit).items():
                dataset[f"{name}_{field}"] = ((f"{name}_row",), values, {"units": field_unit})
    return FileContent(bytes(dataset.to_netcdf(engine="h5netcdf")), products.measured_percent)


def csv_file(products: Products) -> FileContent:
    """One row per measured grid point, one header row, units at the end of the column names."""
    flux_map, known = products.flux_map, products.surface.known
    rows, columns = np.nonzero(known)
    table = {"i_d_a": flux_map.i_d[rows], "i_q_a": flux_map.i_q[columns]}
    table |= {f"{name}_{unit}": getattr(flux_map, name)[known] for name, unit in CSV_UNITS.items()}
    suffixes = {"Nm": "_nm", "H": "_h", "1": "", "rad": ""}
    for name, (values, unit, _) in _grids(products).items():
        suffix = "" if name.endswith(suffixes[unit]) else suffixes[unit]
        table[f"{name}{suffix}"] = values[known]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*table, "recording"])
    cells = [["" if np.isnan(v) else repr(float(v)) for v in column] for column in table.values()]
    writer.writerows((*row, products.recording) for row in zip(*cells, strict=True))
    note = ("unmeasured points are omitted",) if not known.all() else ()
    return FileContent(text.getvalue().encode("utf-8"), products.measured_percent, notes=note)


def npz_file(products: Products) -> FileContent:
    """Complex `i_s_dq` and `psi_s_dq` as motulator's `MagneticModel` takes them, `tau_M`, and all other fields.

    And `inverse_i_s_dq` over `inverse_flux_d`, `inverse_flux_q`, continued where `inverse_measured` is false.

    Shape (d, q), i_d along the rows, where the map has no holes. With holes the arrays are flat and hold the measured
    points only: motulator's `invert` refuses NaN and takes scattered points.
    """
    flux_map, known = products.flux_map, products.surface.known
    i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
    grids = {"i_s_dq": i_d + 1j * i_q, "psi_s_dq": flux_map.psi_d + 1j * flux_map.psi_q, "tau_M": products.torque_nm}
    grids |= {name: getattr(flux_map, name) for name in CSV_UNITS if not name.startswith("psi") or "std" in name}
    whole = bool(known.all())
    content: dict[str, Any] = {name: values if whole else values[known] for name, values in grids.items()}
    inverse = products.inverse
    filled_d, filled_q = inverse.filled()
    content |= {"inverse_flux_d": inverse.psi_d, "inverse_flux_q": inverse.psi_q}
    content |= {"inverse_i_s_dq": filled_d + 1j * filled_q, "inverse_measured": inverse.measured}
    texts = {"method": flux_map.method, "motor": products.motor.name, "recording": products.recording}
    texts["notes"] = "\n".join(products.notes)
    content |= {name: np.array(text) for name, text in texts.items()}
    for name, curve, unit in (("mtpa", products.mtpa, "A"), ("mtpv", products.mtpv, "Wb")):
        if curve is not None:
            content |= {f"{name}_{field}": values for field, (values, _) in _columns(curve, unit).items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **content)
    note = () if whole else ("flat arrays of the measured points, because the map has holes",)
    return FileContent(buffer.getvalue(), products.measured_percent, notes=note)


def _grids(products: Products) -> dict[str, tuple[Array, str, str]]:
    salient = products.saliency
    return {
        "torque_nm": (products.torque_nm, "Nm", "torque 3/2 n (psi_d i_q - psi_q i_d)"),
        "l_max": (salient.l_max, "H", "largest incremental inductance of all directions"),
        "l_min": (salient.l_min, "H", "least incremental inductance of all directions"),
        "saliency_ratio": (salient.ratio, "1", "l_max / l_min"),
        "saliency_angle_rad": (salient.angle_rad, "rad", "from the d axis to the axis of least inductance"),
    }


def _columns(curve: Trajectory, unit: str) -> dict[str, tuple[Array, str]]:
    return {
        "magnitude": (curve.magnitude, unit),
        "i_d": (curve.i_dq[:, 0], "A"),
        "i_q": (curve.i_dq[:, 1], "A"),
        "psi_d": (curve.psi_dq[:, 0], "Wb"),
        "psi_q": (curve.psi_dq[:, 1], "Wb"),
        "torque": (curve.torque_nm, "Nm"),
        "interior": (curve.interior.astype(np.float64), "1"),
    }
