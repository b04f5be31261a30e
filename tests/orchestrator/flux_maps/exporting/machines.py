"""Flux maps whose every number is known in closed form, and the measured ones that ship with the simulated drive."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.flux_maps import load_map
from protocols import FluxMap, Motor

Array = NDArray[np.float64]

PSI_M, L_D, L_Q, POLE_PAIRS = 0.3, 0.043, 0.069, 2
MOTOR = Motor(name="pm400", pole_pairs=POLE_PAIRS, stator_resistance_ohm=4.25, pm_flux_wb=PSI_M)
SHIPPED = ("baldor-5k6", "beckhoff-am8141-400rpm", "beckhoff-am8141-800rpm", "ipm-femm-100c", "ipm-femm-60c")
CUBIC_D, CROSS, CUBIC_Q = 300.0, 200.0, 100.0


def shipped_path(name: str) -> Path:
    return Path(str(files("plugins.drives.simulated"))) / "maps" / f"{name}.csv"


def shipped(name: str) -> FluxMap:
    return load_map(shipped_path(name))


def flux_map(i_d: Array, i_q: Array, psi: Array, inductance: Array) -> FluxMap:
    """A map from arrays of shape (d, q, 2) and (d, q, 2, 2), with made-up standard deviations."""
    tables = {"psi_d": psi[..., 0], "psi_q": psi[..., 1]}
    tables |= {"l_dd": inductance[..., 0, 0], "l_dq": inductance[..., 0, 1], "l_qq": inductance[..., 1, 1]}
    tables |= {f"{name}_std": 0.001 * np.abs(table) for name, table in list(tables.items())}
    return FluxMap(method="exact", i_d=i_d, i_q=i_q, **tables)


def linear_map(reach_a: float = 10.0, nodes: int = 21, psi_m: float = PSI_M) -> FluxMap:
    """Constant inductances: everything about it is known in closed form."""
    axis = np.linspace(-reach_a, reach_a, nodes)
    i = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    psi = i * [L_D, L_Q] + [psi_m, 0.0]
    return flux_map(axis, axis, psi, np.broadcast_to(np.diag([L_D, L_Q]), (*psi.shape, 2)).copy())


def saturated_current(psi: Array) -> Array:
    """i = grad H of an even quartic energy, shape (..., 2)."""
    d, q = psi[..., 0] - PSI_M, psi[..., 1]
    i_d = d / L_D + CUBIC_D * d**3 + CROSS * d * q**2
    i_q = q / L_Q + CUBIC_Q * q**3 + CROSS * d**2 * q
    return np.stack((i_d, i_q), axis=-1)


def saturated_energy(psi: Array) -> Array:
    d, q = psi[..., 0] - PSI_M, psi[..., 1]
    quadratic, quartic = d**2 / (2 * L_D) + q**2 / (2 * L_Q), CUBIC_D * d**4 / 4 + CUBIC_Q * q**4 / 4
    energy: Array = quadratic + quartic + CROSS * d**2 * q**2 / 2
    return energy


def saturated_hessian(psi: Array) -> Array:
    d, q = psi[..., 0] - PSI_M, psi[..., 1]
    cross = 2 * CROSS * d * q
    rows = [
        np.stack((1 / L_D + 3 * CUBIC_D * d**2 + CROSS * q**2, cross), axis=-1),
        np.stack((cross, 1 / L_Q + 3 * CUBIC_Q * q**2 + CROSS * d**2), axis=-1),
    ]
    return np.stack(rows, axis=-2)


def saturated_flux(i: Array) -> Array:
    """The inverse of `saturated_current`, by Newton."""
    psi = i * [L_D, L_Q] * 0.7 + [PSI_M, 0.0]
    for _ in range(60):
        psi = psi - np.linalg.solve(saturated_hessian(psi), (saturated_current(psi) - i)[..., None])[..., 0]
    return psi


def saturated_map(nodes: int = 31, reach_a: float = 3.0) -> FluxMap:
    """The saturated machine, measured inside the circle |i| <= reach only."""
    axis = np.linspace(-reach_a, reach_a, nodes)
    i = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    psi = saturated_flux(i)
    inductance: Array = np.linalg.inv(saturated_hessian(psi)).astype(np.float64)
    outside = np.linalg.norm(i, axis=-1) > reach_a * (1 + 1e-9)
    psi[outside], inductance[outside] = np.nan, np.nan
    return flux_map(axis, axis, psi, inductance)
