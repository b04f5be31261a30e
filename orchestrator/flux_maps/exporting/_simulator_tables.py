"""Flux maps as text tables of circuit and system simulators: Modelica, PLECS and LTspice. Decides no content."""

from __future__ import annotations

import numpy as np

from orchestrator.flux_maps.exporting._c_tables import Axis, HeaderTables, Table, header_tables
from orchestrator.flux_maps.exporting._products import FileContent, Products, lookup_error
from orchestrator.numerics.types import Array

_PAIRS = (("psi_d", "psi_q"), ("i_d", "i_q"))
"""Fluxes over currents, and currents over fluxes."""
_UNITS = {"a": "A", "wb": "Wb"}


def modelica_file(products: Products) -> FileContent:
    """`flux_map_modelica.txt`: one file for `CombiTable2Ds` (tableOnFile), a matrix each of psi_d, psi_q, i_d and i_q.

    Rows of u1 (d), columns of u2 (q), as the Modelica Standard Library 4 describes "Tables in files".
    """
    held = header_tables(products)
    lines = ["#1", *(f"# {line}" for line in _opening(products, held))]
    for table in _tables(held):
        rows, columns = (axis.nodes for axis in table.axes)
        matrix = np.vstack((np.concatenate(([0.0], columns)), np.column_stack((rows, table.values))))
        lines += [
            f"# {table.meaning} [{_UNITS[table.unit]}] over {_over(table)}",
            f"double {table.name}({matrix.shape[0]},{matrix.shape[1]})",
        ]
        lines += [" ".join(f"{value:.9g}" for value in row) for row in matrix]
    return _written(held, lines)


def plecs_file(products: Products) -> FileContent:
    """`flux_map_plecs.m`: initialisation commands of PLECS (MATLAB, Octave): axes and tables of 2D-Table blocks."""
    held = header_tables(products)
    name, motor = products.symbol, products.motor
    lines = [f"% {line}" for line in _opening(products, held)]
    lines += [f"{name}.p = {motor.pole_pairs};"]
    if motor.stator_resistance_ohm is not None:
        lines += [f"{name}.R_s = {motor.stator_resistance_ohm:.9g};"]
    lines += [f"{name}.{axis.name} = [{' '.join(f'{node:.9g}' for node in axis.nodes)}];" for axis in _axes(held)]
    for table in _tables(held):
        rows = ["    " + " ".join(f"{value:.9g}" for value in row) + ";" for row in table.values]
        lines += [
            f"{name}.{table.name}_table = [  % {table.meaning} [{_UNITS[table.unit]}] over {_over(table)}",
            *rows,
            "];",
        ]
    return _written(held, lines)


def ltspice_file(products: Products, max_nodes: int = 17) -> FileContent:
    """`flux_map_ltspice.lib`: the machine as a subcircuit in the dq frame, its currents looked up over its fluxes.

    LTspice has tables of one variable only. Of two, a bilinear one is a sum over the nodes of q: a hat function there
    times the table over d. At most 17 nodes along each axis keep it fast.
    """
    held, motor = header_tables(products), products.motor
    inverse = products.inverse
    axes = [np.linspace(axis[0], axis[-1], min(max_nodes, len(axis))) for axis in (inverse.psi_d, inverse.psi_q)]
    tables = [_resampled((inverse.psi_d, inverse.psi_q), table, axes) for table in inverse.filled()]
    surface = products.surface
    rms, worst = lookup_error(axes[0], axes[1], (tables[0], tables[1]), surface.fluxes, surface.currents)
    rest = products.rest_wb or 0.0
    lines = [f"* {line}" for line in _opening(products, held)]
    lines += [
        "* Nodes: v_d, v_q, electrical speed [rad/s] in; i_d, i_q [A], torque [Nm] out, all as voltages against 0.",
        f".subckt {products.symbol}_dq vd vq we id iq te",
        f".param R_s={motor.stator_resistance_ohm or 0.0:.9g} p={motor.pole_pairs} psi_m={rest:.9g}",
        "Bd 0 psid I=V(vd)-R_s*V(id)+V(we)*V(psiq)",
        "Bq 0 psiq I=V(vq)-R_s*V(iq)-V(we)*V(psid)",
        "Cd psid 0 1 IC={psi_m}",
        "Cq psiq 0 1 IC=0",
        *(_sum_of_hats(name, axes, table) for name, table in zip(("id", "iq"), tables, strict=True)),
        "Bte te 0 V=1.5*p*(V(psid)*V(iq)-V(psiq)*V(id))",
        f".ends {products.symbol}_dq",
    ]
    note = f"its 17 x 17 lookup of i deviates from the measured currents by {rms:.2g} A rms, {worst:.2g} A at most"
    return _written(held, lines, note)


def _sum_of_hats(name: str, axes: list[Array], table: Array) -> str:
    d, q = axes
    terms = []
    for k in range(len(q)):
        beside = [(q[m], float(m == k)) for m in (k - 1, k, k + 1) if 0 <= m < len(q)]
        hat = ",".join(f"{x:.7g},{y:g}" for x, y in beside)
        along = ",".join(f"{x:.7g},{y:.7g}" for x, y in zip(d, table[:, k], strict=True))
        terms.append(f"table(V(psiq),{hat})*table(V(psid),{along})")
    return f"B{name} {name} 0 V=" + "\n+ +".join(terms)


def _resampled(axes: tuple[Array, Array], table: Array, to: list[Array]) -> Array:
    from scipy.interpolate import RegularGridInterpolator

    places = np.stack(np.meshgrid(*to, indexing="ij"), axis=-1)
    return np.asarray(RegularGridInterpolator(axes, table)(places), dtype=np.float64)


def _opening(products: Products, held: HeaderTables) -> list[str]:
    lines = [
        f"Flux map of {products.motor.name} (method {products.flux_map.method}), written by fluxbench.",
        f"Recording: {products.recording or 'unknown'}.",
        "SI units; peak-valued dq vectors (amplitude-invariant), electrical angles, magnet on d.",
        "Beyond the measured region the tables are continued by least curvature.",
        *products.notes,
        *held.notes,
    ]
    return [" ".join(line.encode("ascii", "replace").decode().split()) for line in lines]


def _tables(held: HeaderTables) -> list[Table]:
    wanted = [name for pair in _PAIRS for name in pair]
    return [table for table in held.tables if table.name in wanted]


def _axes(held: HeaderTables) -> list[Axis]:
    return list({axis.name: axis for table in _tables(held) for axis in table.axes}.values())


def _over(table: Table) -> str:
    return ", ".join(f"{axis.name} [{_UNITS[axis.unit]}]" for axis in table.axes)


def _written(held: HeaderTables, lines: list[str], *notes: str) -> FileContent:
    filled = int((~held.measured).sum())
    content = ("\n".join(lines) + "\n").encode("ascii")
    return FileContent(content, 100.0 * float(held.measured.mean()), filled_nodes=filled, notes=(*held.notes, *notes))
