"""A flux map from points: on the rectangular grid that they lie on, or interpolated onto one.

Inductances that are missing are derivatives of the flux; standard deviations that are missing are NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.flux_maps._scattered import distinct_values, on_rectangular_grid
from orchestrator.flux_maps._surface import MapSurface, require_usable
from orchestrator.numerics.types import Array
from protocols import FluxMap, InputError, Remark

CSV_UNITS = {
    "psi_d": "wb",
    "psi_q": "wb",
    "l_dd": "h",
    "l_dq": "h",
    "l_qq": "h",
    "psi_d_std": "wb",
    "psi_q_std": "wb",
    "l_dd_std": "h",
    "l_dq_std": "h",
    "l_qq_std": "h",
}
"""Fields of a flux map, and the unit that ends their column's name."""
TORQUE = "torque_nm"
_COMPUTED = {"l_dd", "l_dq", "l_qq"}


@dataclass(frozen=True)
class MapFile:
    """A flux map, and further content of its file."""

    flux_map: FluxMap
    torque_nm: Array | None = None
    """The file's torque, shape (d, q); NaN where it has none."""
    remarks: tuple[Remark, ...] = ()
    """Notes on the reading, where it is more than a copy of the numbers."""


def gridded(where: str, method: str, columns: Mapping[str, Array], remarks: Sequence[Remark] = ()) -> MapFile:
    """A flux map from points in any order.

    Parameters
    ----------
    where : str
        Name for errors.
    method : str
        The map's method.
    columns : mapping
        Arrays of one size: `i_d`, `i_q` [A], `psi_d`, `psi_q` [Wb], and any other field of a flux map, or `torque_nm`.
    remarks : sequence of Remark
        Notes on the reading so far.

    Raises
    ------
    InputError
        Where the points are too few, not finite, contradict each other, or span no area.
    """
    flat = {name: np.asarray(values, dtype=np.float64).ravel() for name, values in columns.items()}
    sizes = {name: len(values) for name, values in flat.items()}
    if len(set(sizes.values())) != 1:
        raise InputError(where, "", f"arrays of different sizes: {', '.join(f'{n} {k}' for n, k in sizes.items())}")
    if not (np.isfinite(flat["i_d"]).all() and np.isfinite(flat["i_q"]).all()):
        raise InputError(where, "i_d, i_q", "a current is not finite")
    if sizes["i_d"] < 4:
        raise InputError(where, "i_d, i_q", f"{sizes['i_d']} points: too few for a flux map")
    notes = list(remarks)
    if not _is_grid(flat["i_d"], flat["i_q"]):
        flat, remark = on_rectangular_grid(where, flat)
        notes.append(remark)
    i_d, rows = distinct_values(flat["i_d"])
    i_q, places = distinct_values(flat["i_q"])
    if len(np.unique(rows * len(i_q) + places)) < flat["i_d"].size:
        raise InputError(where, "i_d, i_q", "a current occurs twice")
    tables = {name: np.full((len(i_d), len(i_q)), np.nan) for name in (*CSV_UNITS, TORQUE)}
    for name, values in flat.items():
        if name in tables:
            tables[name][rows, places] = values
    torque_nm = tables.pop(TORQUE)
    flux_map = FluxMap(method=method, i_d=i_d, i_q=i_q, **tables)
    require_usable(flux_map, where)
    if not flat.keys() >= _COMPUTED:
        flux_map = flux_map.model_copy(update=_derivatives(flux_map))
    return MapFile(flux_map, torque_nm if np.isfinite(torque_nm).any() else None, tuple(notes))


def _is_grid(i_d: Array, i_q: Array) -> bool:
    """Whether points fill at least a quarter of the nodes that their coordinates span."""
    nodes = [len(distinct_values(axis)[0]) for axis in (i_d, i_q)]
    return min(nodes) >= 2 and nodes[0] * nodes[1] <= 4 * i_d.size


def _derivatives(flux_map: FluxMap) -> dict[str, Array]:
    """Incremental inductances where the flux is known, from the smooth surface; l_dq is the mean of both crosses."""
    surface = MapSurface(flux_map)
    slopes = surface.jacobian(surface.currents)
    values = {"l_dd": slopes[:, 0, 0], "l_dq": 0.5 * (slopes[:, 0, 1] + slopes[:, 1, 0]), "l_qq": slopes[:, 1, 1]}
    tables = {name: np.full(surface.known.shape, np.nan) for name in values}
    for name, column in values.items():
        tables[name][surface.known] = column
    return tables
