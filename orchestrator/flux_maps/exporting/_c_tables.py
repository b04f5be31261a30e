"""The tables of a C header: evenly spaced axes, no holes, and a mask of measured nodes. Renders no text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from orchestrator.flux_maps import fill_smoothly
from orchestrator.flux_maps.exporting._products import Products, lookup_error
from orchestrator.flux_maps.exporting._torque import Trajectory, mtpa, mtpv, saliency
from orchestrator.numerics.types import Array, Mask
from protocols import FluxMap

ROUNDING_RATIO = 1e-9
"""Deviation of a lookup over the largest flux below which it is rounding: the table's nodes are the measured points."""


@dataclass(frozen=True)
class Axis:
    """Evenly spaced nodes."""

    name: str
    unit: str
    nodes: Array

    @property
    def step(self) -> float:
        return float(self.nodes[-1] - self.nodes[0]) / (len(self.nodes) - 1)


@dataclass(frozen=True)
class Table:
    """Values over one or two axes."""

    name: str
    unit: str
    meaning: str
    values: Array
    axes: tuple[Axis, ...]


@dataclass(frozen=True)
class MaskTable:
    """A mask of measured nodes."""

    name: str
    meaning: str
    values: Mask


@dataclass(frozen=True)
class HeaderTables:
    """The content of a header."""

    tables: tuple[Table, ...]
    masks: tuple[MaskTable, ...]
    notes: tuple[str, ...]

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Each axis once, in order of first use."""
        return tuple({axis.name: axis for table in self.tables for axis in table.axes}.values())

    @property
    def measured(self) -> Mask:
        """All masks, end to end."""
        return np.concatenate([mask.values.ravel() for mask in self.masks])


def header_tables(products: Products) -> HeaderTables:
    """Flux, inductances and saliency angle over current, current over flux, MTPA and MTPV."""
    surface = products.surface
    d, q = Axis("i_d", "a", _even(surface.i_d)), Axis("i_q", "a", _even(surface.i_q))
    grid = np.stack(np.meshgrid(d.nodes, q.nodes, indexing="ij"), axis=-1).reshape(-1, 2)
    psi_d, psi_q = surface.psi(grid).T.reshape(2, len(d.nodes), len(q.nodes))
    mask = surface.inside(grid).reshape(psi_d.shape)
    rms, worst = lookup_error(d.nodes, q.nodes, (psi_d, psi_q), surface.currents, surface.fluxes)
    notes = []
    if worst > ROUNDING_RATIO * float(np.abs(surface.fluxes).max()):
        notes.append(
            f"linear lookup of psi deviates from the measured fluxes by {rms:.2g} Wb rms, {worst:.2g} Wb at most"
        )
    tables = [
        Table("psi_d", "wb", "large-signal d-axis flux linkage", psi_d, (d, q)),
        Table("psi_q", "wb", "large-signal q-axis flux linkage", psi_q, (d, q)),
    ]
    tables += _inductances(products.flux_map, d, q)

    inverse = products.inverse
    f, g = Axis("flux_d", "wb", inverse.psi_d), Axis("flux_q", "wb", inverse.psi_q)
    i_d, i_q = inverse.filled()
    rms, worst = lookup_error(f.nodes, g.nodes, (i_d, i_q), surface.fluxes, surface.currents)
    notes.append(f"linear lookup of i deviates from the measured currents by {rms:.2g} A rms, {worst:.2g} A at most")
    tables += [
        Table("i_d", "a", "d-axis current against flux linkage", i_d, (f, g)),
        Table("i_q", "a", "q-axis current against flux linkage", i_q, (f, g)),
    ]
    tables += _curves(products)
    masks = (
        MaskTable("measured_i", "nodes of the tables over current", mask),
        MaskTable("measured_psi", "nodes of the tables over flux linkage", inverse.measured),
    )
    return HeaderTables(tuple(tables), masks, tuple(notes))


def _even(axis: Array, max_nodes: int = 33) -> Array:
    """The axis itself where it is short and evenly spaced, else evenly spaced nodes up to a header's limit."""
    # 33 nodes are 2 kB a table in Q15, 4 kB in float. The inverse has its own 51: 5 and 10 kB.
    count = min(len(axis), max_nodes)
    even = np.linspace(axis[0], axis[-1], count)
    return axis if len(axis) == count and np.allclose(axis, even, rtol=0.0, atol=1e-6 * np.ptp(axis)) else even


def _inductances(flux_map: FluxMap, d: Axis, q: Axis) -> list[Table]:
    """Inductance tables and the saliency angle; none where the map has no inductances."""
    from scipy.interpolate import RegularGridInterpolator

    if np.isfinite(flux_map.l_dd + flux_map.l_dq + flux_map.l_qq).sum() < 3:
        return []
    axes = (np.asarray(flux_map.i_d, dtype=np.float64), np.asarray(flux_map.i_q, dtype=np.float64))
    low, high = np.array([axis[[0, -1]] for axis in axes]).T
    places = np.clip(np.stack(np.meshgrid(d.nodes, q.nodes, indexing="ij"), axis=-1), low, high)
    inductances = {}
    for name in ("l_dd", "l_dq", "l_qq"):
        filled = fill_smoothly(*axes, np.asarray(getattr(flux_map, name), dtype=np.float64), name)
        inductances[name] = np.asarray(RegularGridInterpolator(axes, filled)(places))
    angle = saliency(flux_map.model_copy(update=inductances)).angle_rad
    slopes = {"l_dd": "dpsi_d/di_d", "l_dq": "dpsi_d/di_q", "l_qq": "dpsi_q/di_q"}
    tables = [Table(n, "h", f"incremental inductance {slopes[n]}", values, (d, q)) for n, values in inductances.items()]
    meaning = "angle from the d axis to the axis of least incremental inductance, electrical"
    return [*tables, Table("saliency_angle", "rad", meaning, angle, (d, q))]


def _curves(products: Products) -> list[Table]:
    """MTPA and MTPV where the greatest torque lies inside the measured region; none where it never does."""
    tables: list[Table] = []
    kinds: tuple[tuple[str, str, Trajectory | None, Callable[..., Trajectory]], ...] = (
        ("mtpa", "a", products.mtpa, mtpa),
        ("mtpv", "wb", products.mtpv, mtpv),
    )
    for name, unit, coarse, curve_of in kinds:
        stretch = _interior(coarse)
        if coarse is None or stretch is None:
            continue
        nodes = np.linspace(*stretch, 33)
        curve = curve_of(products.flux_map, products.motor.pole_pairs, nodes)
        axis = Axis(f"{name}_{'current' if unit == 'a' else 'flux'}", unit, nodes)
        columns = (("i_d", "a", curve.i_dq[:, 0]), ("i_q", "a", curve.i_dq[:, 1]), ("torque", "nm", curve.torque_nm))
        for column, column_unit, values in columns:
            meaning = f"{column} of greatest torque {'per ampere' if unit == 'a' else 'per volt'}"
            tables.append(Table(f"{name}_{column}", column_unit, meaning, values, (axis,)))
    return tables


def _interior(curve: Trajectory | None) -> tuple[float, float] | None:
    """The longest run of interior rows of a trajectory, as magnitudes; None where it is shorter than two."""
    if curve is None:
        return None
    edges = np.flatnonzero(np.diff(np.concatenate(([0], curve.interior.astype(int), [0]))))
    runs = edges.reshape(-1, 2)
    first, last = max(runs, key=lambda run: int(run[1] - run[0]), default=(0, 0))
    if last - first < 2:
        return None
    return float(curve.magnitude[first]), float(curve.magnitude[last - 1])
