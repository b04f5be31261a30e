"""A motor as its flux map describes it: flux, inductance, torque and their errors at any current. Tunes nothing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orchestrator.flux_maps import (
    MapSurface,
    fill_smoothly,
    magnet_basis,
    magnet_is_copied,
    resistance_basis,
)
from orchestrator.numerics.types import Array, Mask
from protocols import FluxMap, InputError, Motor

WHERE = "flux map"
MAX_MAGNET_PER_K = 0.01
"""Largest relative change of a magnet's flux [1/K]: ferrites lose 0.002, neodymium 0.0011."""
MIN_MOTORING_SHARE = 1e-6
"""Part of the largest current that i_q has to reach in the map: only rounding stays below it."""


@dataclass(frozen=True)
class Machine:
    """A motor as its flux map describes it.

    Vectors are peak-valued (amplitude-invariant), angles electrical, T = 3/2 n (psi_d i_q - psi_q i_d).

    Attributes
    ----------
    motor : Motor
    flux_map : FluxMap
    r_s_ohm, r_s_std_ohm : float
        Resistance of a phase and its standard deviation [ohm].
    winding_c : float, optional
        Temperature of the winding at which the resistance holds, and of the magnet at which the map does [°C]; without,
        it is assumed to be `ROOM_C`.
    magnet_per_k : float, optional
        Change of the magnet's flux over its temperature, relative to it [1/K]; without, its temperature is no argument.
    """

    motor: Motor
    flux_map: FluxMap
    r_s_ohm: float
    r_s_std_ohm: float
    winding_c: float | None = None
    magnet_per_k: float | None = None

    def __post_init__(self) -> None:
        if self.magnet_per_k is not None:
            if not abs(self.magnet_per_k) <= MAX_MAGNET_PER_K:
                most, given = 100.0 * MAX_MAGNET_PER_K, 100.0 * self.magnet_per_k
                raise InputError("magnet", "magnet_percent_per_k", f"expected {most:g} %/K at most, not {given:g} %/K")
            if not self.motor.pm_flux_wb:
                raise InputError("motor", "pm_flux_wb", "unknown or zero: a magnet's temperature needs its flux")
        if not self.r_s_ohm > 0.0:
            raise InputError(WHERE, "r_s_ohm", f"expected a positive resistance, not {self.r_s_ohm:g} ohm")
        if not (self.surface.currents[:, 1] > MIN_MOTORING_SHARE * self.largest_current_a).any():
            raise InputError(WHERE, "i_q", "no measured point with i_q > 0: there is no torque to ask for")

    @cached_property
    def surface(self) -> MapSurface:
        return MapSurface(self.flux_map)

    @cached_property
    def rest_flux_wb(self) -> float:
        """psi_d without current [Wb]."""
        return float(self.psi(np.zeros((1, 2)))[0, 0])

    @property
    def magnet_is_nameplates(self) -> bool:
        """Whether the flux without current is the nameplate's, as in each map of a rotor that stood still."""
        return magnet_is_copied(self.motor, self.rest_flux_wb)

    @property
    def basis(self) -> tuple[str, ...]:
        """What every figure rests on, a sentence each: R_s with its temperature, and a flux that was not measured."""
        resistance = f"R_s: {resistance_basis(self.r_s_ohm, self.winding_c)}"
        if not self.magnet_is_nameplates:
            return (resistance,)
        return resistance, f"magnet's flux: {magnet_basis(self.rest_flux_wb)}"

    @property
    def pole_pairs(self) -> int:
        return self.motor.pole_pairs

    @cached_property
    def largest_current_a(self) -> float:
        """Largest |i| that was measured [A]."""
        return float(np.linalg.norm(self.surface.currents, axis=1).max())

    def psi(self, i_dq: Array) -> Array:
        """Flux linkage [Wb], shape (n, 2), at currents of shape (n, 2) [A]."""
        return self.surface.psi(i_dq)

    def inductance(self, i_dq: Array) -> Array:
        """Incremental inductance dpsi/di [H], symmetric, shape (n, 2, 2)."""
        slopes = self.surface.jacobian(i_dq)
        return 0.5 * (slopes + slopes.transpose(0, 2, 1))

    def inductance_std(self, i_dq: Array) -> Array:
        """Standard deviations of L_dd, L_dq, L_qq [H], shape (n, 3)."""
        return np.column_stack([self._over_map(name, i_dq) for name in ("l_dd_std", "l_dq_std", "l_qq_std")])

    def psi_std(self, i_dq: Array) -> Array:
        """Standard deviations of both fluxes [Wb], shape (n, 2)."""
        return np.column_stack([self._over_map(name, i_dq) for name in ("psi_d_std", "psi_q_std")])

    def torque_nm(self, i_dq: Array) -> Array:
        """Torque at the shaft without friction [Nm], shape (n,)."""
        return self.torque_of(i_dq, self.psi(i_dq))

    def torque_of(self, i_dq: Array, psi_dq: Array) -> Array:
        """Torque of currents and their fluxes, both of shape (..., 2) [Nm]."""
        torque: Array = 1.5 * self.pole_pairs * (psi_dq[..., 0] * i_dq[..., 1] - psi_dq[..., 1] * i_dq[..., 0])
        return torque

    def inside(self, i_dq: Array) -> Mask:
        """Whether currents lie in the measured region."""
        return self.surface.inside(i_dq)

    def _over_map(self, name: str, i_dq: Array) -> Array:
        """A table of the map at currents, linear between its nodes and held at its ends; zero where it has none."""
        from scipy.interpolate import RegularGridInterpolator

        table = self._filled.get(name)
        if table is None:
            return np.zeros(len(i_dq))
        surface = self.surface
        held = np.clip(i_dq, [surface.i_d[0], surface.i_q[0]], [surface.i_d[-1], surface.i_q[-1]])
        return np.asarray(RegularGridInterpolator((surface.i_d, surface.i_q), table)(held))

    @cached_property
    def _filled(self) -> dict[str, Array]:
        """Tables of standard deviations without holes; raises `InputError` where one is infinite."""
        found = {}
        for name in ("psi_d_std", "psi_q_std", "l_dd_std", "l_dq_std", "l_qq_std"):
            table = np.asarray(getattr(self.flux_map, name), dtype=np.float64)
            if np.isinf(table).any():
                raise InputError(WHERE, name, "a standard deviation is infinite: nothing is known there")
            if np.isfinite(table).sum() >= 3:
                filled = fill_smoothly(self.surface.i_d, self.surface.i_q, table, name)
                found[name] = np.clip(filled, 0.0, float(np.nanmax(table)))
        return found
