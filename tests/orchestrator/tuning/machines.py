"""Flux maps of analytic machines, for tests that know the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orchestrator.numerics.types import Array
from orchestrator.tuning.machine import Machine
from protocols import FluxMap, Motor

Flux = Callable[[Array], Array]
"""Flux linkages (n, 2) [Wb] at currents (n, 2) [A]."""


def linear(l_d_h: float, l_q_h: float, pm_flux_wb: float) -> Flux:
    """A machine without saturation."""
    return lambda i_dq: i_dq * [l_d_h, l_q_h] + [pm_flux_wb, 0.0]


def saturated(pm_flux_wb: float = 0.3, i_scale_a: float = 4.0) -> Flux:
    """A saturated, cross-coupled machine: the gradient of its energy, so that it is reciprocal.

    W / s^2 = 0.072 (sqrt(1 + x^2) - 1) + 0.07 (sqrt(1 + y^2) - 1) - 0.006 x^2 y^2 / (1 + x^2 + y^2) + psi_m x / s,
    x = i_d / s, y = i_q / s.
    """

    def flux(i_dq: Array) -> Array:
        x, y = i_dq.T / i_scale_a
        both = 1.0 + x * x + y * y
        psi_d = 0.072 * x / np.sqrt(1.0 + x * x) - 0.012 * x * y * y * (1.0 + y * y) / both**2
        psi_q = 0.07 * y / np.sqrt(1.0 + y * y) - 0.012 * x * x * y * (1.0 + x * x) / both**2
        return np.column_stack([i_scale_a * psi_d + pm_flux_wb, i_scale_a * psi_q])

    return flux


def flux_map(flux: Flux, reach_a: float, nodes: int = 25, std: float = 0.0) -> FluxMap:
    """A map of it on a square grid, with relative standard deviations."""
    axis = np.linspace(-reach_a, reach_a, nodes)
    at = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    shape = (nodes, nodes)
    psi = flux(at).reshape(*shape, 2)
    step = 1e-4 * reach_a
    columns = [(flux(at + step * e) - flux(at - step * e)).reshape(*shape, 2) / (2.0 * step) for e in np.eye(2)]
    l_dd, l_qq = columns[0][..., 0], columns[1][..., 1]
    l_dq = 0.5 * (columns[0][..., 1] + columns[1][..., 0])
    size = np.full(shape, 1.0)
    return FluxMap(
        method="analytic",
        i_d=axis,
        i_q=axis,
        psi_d=psi[..., 0],
        psi_q=psi[..., 1],
        l_dd=l_dd,
        l_dq=l_dq,
        l_qq=l_qq,
        psi_d_std=size * std * float(np.abs(psi[..., 0]).max()),
        psi_q_std=size * std * float(np.abs(psi[..., 1]).max()),
        l_dd_std=std * l_dd,
        l_dq_std=std * np.abs(l_dq),
        l_qq_std=std * l_qq,
    )


def machine(
    flux: Flux, *, reach_a: float = 4.0, pole_pairs: int = 2, r_s_ohm: float = 1.0, std: float = 0.0
) -> Machine:
    """The machine with a map of it."""
    motor = Motor(name="analytic", pole_pairs=pole_pairs, rated_current_rms_a=2.0, rated_speed_rpm=3000.0)
    return Machine(motor, flux_map(flux, reach_a, std=std), r_s_ohm, 0.01 * r_s_ohm)
