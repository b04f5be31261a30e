"""Current references: the least current for a torque within a flux limit, as tables without holes.

At an electrical speed omega a voltage limit is a limit of the flux, |psi| <= (v - R_s |i|) / |omega|, so that one table
over torque and flux limit serves every speed and bus voltage (M. Meyer, J. Boecker, doi:10.1109/IECON.2006.347627).
On a circle |i| = r the best point is that of maximum torque (MTPA), or where it exceeds the flux limit the nearest one
that does not (field weakening). Over r its torque rises to the greatest one that the flux limit allows (MTPV) or to
the current limit; inverting it gives the least current for every torque.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orchestrator.formatting.quantities import quantity
from orchestrator.numerics.types import Array
from orchestrator.tuning.limits import VOLTAGE_RESERVE, DriveLimits
from orchestrator.tuning.machine import Machine
from protocols import InputError

MIN_TORQUE_RATIO = 1e-4
"""Largest torque over that of the largest flux across the largest current, below which a machine gives none."""
FLUX_NODES = 17
TORQUE_NODES = 33
RADII = 49
"""Magnitudes of the current at which the torque is maximised, for each flux limit."""
ANGLES = 181
"""Directions of the first scan over half a circle."""
NEAR_ANGLES = 41
"""Directions of a scan around a point that is near: 20 degrees to either side."""
ZOOMS = 9
"""Rounds that each divide the step of the direction by four: 1 degree becomes 4e-6."""
RADIUS_STEPS = 8
"""Secant steps to the radius of a torque, from an interpolated start."""


@dataclass(frozen=True)
class CurrentReferences:
    """Tables of least currents.

    Attributes
    ----------
    psi_limit_wb : array, shape (m,)
        Limits of |psi| [Wb], evenly spaced, increasing; at the last one the flux limits nothing.
    torque_limit_nm : array, shape (m,)
        Largest torque at each [Nm].
    share : array, shape (n,)
        |torque| over the limit, evenly spaced from 0 to 1.
    i_dq_a : array, shape (m, n, 2)
        Least currents [A], i_q >= 0; a negative torque has the opposite i_q.
    reaches_speed : bool
        Whether the largest speed of the limits is reached; else the first flux limit is the least that is possible.
    """

    psi_limit_wb: Array
    torque_limit_nm: Array
    share: Array
    i_dq_a: Array
    reaches_speed: bool

    def at(self, torque_nm: Array, psi_limit_wb: Array) -> Array:
        """References [A], shape (n, 2), linear between the nodes as in the drive; torques are limited."""
        row = np.clip(np.interp(psi_limit_wb, self.psi_limit_wb, np.arange(len(self.psi_limit_wb))), 0.0, None)
        limit = np.interp(psi_limit_wb, self.psi_limit_wb, self.torque_limit_nm)
        share = np.minimum(np.abs(torque_nm) / np.maximum(limit, 1e-30), 1.0)
        column = share * (len(self.share) - 1)
        k = np.minimum(row.astype(np.intp), len(self.psi_limit_wb) - 2)
        j = np.minimum(column.astype(np.intp), len(self.share) - 2)
        u, v = (row - k)[:, None], (column - j)[:, None]
        table = self.i_dq_a
        near = table[k, j] * (1.0 - v) + table[k, j + 1] * v
        far = table[k + 1, j] * (1.0 - v) + table[k + 1, j + 1] * v
        out: Array = near * (1.0 - u) + far * u
        out[:, 1] *= np.where(torque_nm < 0.0, -1.0, 1.0)
        return out


def flux_limit(limits: DriveLimits, r_s_ohm: float, current_a: Array | float, speed_rad_s: Array | float) -> Array:
    """|psi| that the voltage allows at a speed [Wb], with the reserve; infinite at standstill."""
    volts = (1.0 - VOLTAGE_RESERVE) * limits.voltage_v - r_s_ohm * np.asarray(current_a, dtype=np.float64)
    speed = np.abs(np.asarray(speed_rad_s, dtype=np.float64))
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(speed > 0.0, np.maximum(volts, 0.0) / np.where(speed > 0.0, speed, 1.0), np.inf))


def current_references(machine: Machine, limits: DriveLimits) -> CurrentReferences:
    """Least currents over torque and flux limit.

    Raises
    ------
    InputError
        Where no point of the map within the current limit gives torque, or the map has holes there.
    """
    free = _Circles(machine, np.array([np.inf]), limits.current_a)
    _, _, psi_free, torque = free.best()
    full = 1.5 * machine.pole_pairs * float(np.abs(machine.surface.fluxes).max()) * limits.current_a
    if not np.where(np.isfinite(torque), torque, 0.0).max() > MIN_TORQUE_RATIO * full:
        text = f"no measured point within {quantity(limits.current_a, 'A')} peak gives torque, by magnet or saliency"
        raise InputError("flux map", "i_q", text)
    largest = float(np.linalg.norm(psi_free[0, : int(np.nanargmax(torque[0])) + 1], axis=-1).max())
    least = free.least_flux()
    wanted = float(flux_limit(limits, machine.r_s_ohm, limits.current_a, limits.speed_rad_s))
    reaches = wanted >= least
    first = min(max(wanted, least), (1.0 - VOLTAGE_RESERVE) * largest)
    levels = np.linspace(first, largest, FLUX_NODES)
    references = _tables(_Circles(machine, levels, limits.current_a), levels, reaches)
    holes = int((~np.isfinite(references.i_dq_a).all(axis=-1)).sum())
    if holes:
        points = references.i_dq_a.size // 2
        text = f"{holes} of {points} references have no measured point: the map has holes, or lacks currents near zero"
        raise InputError("flux map", "i_d, i_q", text)
    return references


def largest_torque(machine: Machine, limits: DriveLimits, psi_limit_wb: Array) -> Array:
    """Largest torque within the current limit at flux limits [Nm], shape (n,); 0 where a limit allows no point."""
    torque = _Circles(machine, psi_limit_wb, limits.current_a).best()[3]
    largest: Array = np.max(np.where(np.isfinite(torque), torque, 0.0), axis=1)
    return largest


def _tables(circles: _Circles, levels: Array, reaches: bool) -> CurrentReferences:
    radii, _, _, torque = circles.best()
    share = np.linspace(0.0, 1.0, TORQUE_NODES)
    known = np.where(np.isfinite(torque), torque, 0.0)
    best = np.argmax(known, axis=1)
    limit = known[np.arange(len(levels)), best]
    wanted = limit[:, None] * share
    start = np.empty_like(wanted)
    for k, last in enumerate(best):
        rising = np.maximum.accumulate(known[k, : last + 1])
        start[k] = np.interp(wanted[k], rising, radii[k, : last + 1])
    low, high = radii[:, :1], radii[np.arange(len(levels)), best][:, None]
    i_dq = circles.with_torque(wanted, start, low, high)
    i_dq[:, 0] = [[circles.least_current(level), 0.0] for level in levels]
    return CurrentReferences(levels, limit, share, i_dq, reaches)


class _Circles:
    """Points of greatest torque on circles |i| = r within flux limits.

    Parameters
    ----------
    machine : Machine
    levels : array, shape (m,)
        Flux limits [Wb].
    current_a : float
        Largest radius [A].
    """

    def __init__(self, machine: Machine, levels: Array, current_a: float) -> None:
        self.machine, self.levels, self.current_a = machine, levels, current_a
        axis = np.linspace(-current_a, current_a, 2001)
        along_d = np.column_stack([axis, np.zeros_like(axis)])
        known = machine.inside(along_d)
        self._axis, self._flux = axis[known], np.linalg.norm(machine.psi(along_d[known]), axis=1)

    def least_flux(self) -> float:
        """The least |psi| within the current limit, on the d axis [Wb]."""
        if len(self._flux) == 0:
            raise InputError("flux map", "i_d", "no measured point on the d axis: no current without torque")
        return float(self._flux.min())

    def best(self) -> tuple[Array, Array, Array, Array]:
        """Radii (m, r), currents and fluxes (m, r, 2), and torques (m, r); NaN where the flux limit allows no point."""
        first = [abs(self.least_current(level)) for level in self.levels]
        # The torque rises like a root from the least radius.
        radii = np.stack([r + (self.current_a - r) * np.linspace(0.0, 1.0, RADII) ** 2 for r in first])
        return radii, *self.at(radii, np.broadcast_to(self.levels[:, None], radii.shape))

    def at(self, radii: Array, levels: Array, near: Array | None = None) -> tuple[Array, Array, Array]:
        """Currents, fluxes (..., 2) and torques (...) of greatest torque on circles, by a scan and zooms.

        The scan goes over half the circle, or where there are currents `near` (..., 2) around their directions.
        """
        r, limit = radii.reshape(-1), levels.reshape(-1) * (1.0 + 1e-9)
        rows, step = np.arange(len(r)), math.pi / (ANGLES - 1)
        if near is None:
            angles = np.tile(np.linspace(0.0, math.pi, ANGLES), (len(r), 1))
        else:
            i_d, i_q = near.reshape(-1, 2).T
            around = np.arctan2(i_q, i_d)[:, None] + step * (np.arange(NEAR_ANGLES) - NEAR_ANGLES // 2)
            angles = np.clip(around, 0.0, math.pi)
        for zoom in range(ZOOMS + 1):
            i_dq = r[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
            flat = i_dq.reshape(-1, 2)
            psi = self.machine.psi(flat).reshape(i_dq.shape)
            torque = self.machine.torque_of(i_dq, psi)
            allowed = (np.linalg.norm(psi, axis=-1) <= limit[:, None]) & self.machine.inside(flat).reshape(torque.shape)
            best = np.argmax(np.where(allowed, torque, -np.inf), axis=1)
            if zoom < ZOOMS:
                around = angles[rows, best][:, None] + step * np.linspace(-1.0, 1.0, 9)
                angles, step = np.clip(around, 0.0, math.pi), 0.25 * step
        found = allowed[rows, best]
        shape = radii.shape
        currents = np.where(found[:, None], i_dq[rows, best], np.nan).reshape(*shape, 2)
        fluxes = np.where(found[:, None], psi[rows, best], np.nan).reshape(*shape, 2)
        return currents, fluxes, np.where(found, torque[rows, best], np.nan).reshape(shape)

    def with_torque(self, torque_nm: Array, start_a: Array, low_a: Array, high_a: Array) -> Array:
        """Least currents of torques (m, n), shape (m, n, 2), by secant steps of the radius from a start."""
        levels = np.broadcast_to(self.levels[:, None], start_a.shape)
        r_old, r = start_a, np.clip(start_a * (1.0 + 1e-4) + 1e-9, low_a, high_a)
        i_dq, _, old = self.at(r_old, levels)
        for _ in range(RADIUS_STEPS):
            i_new, _, new = self.at(r, levels, near=i_dq)
            closer = np.abs(new - torque_nm) <= np.abs(np.where(np.isfinite(old), old, np.inf) - torque_nm)
            i_dq = np.where(closer[..., None] & np.isfinite(i_new), i_new, i_dq)
            slope = new - old
            usable = np.isfinite(slope) & (np.abs(slope) > 0.0)
            step = np.where(usable, (torque_nm - new) * (r - r_old) / np.where(usable, slope, 1.0), 0.0)
            r_old, old = r, new
            r = np.clip(r + step, low_a, high_a)
        return i_dq

    def least_current(self, level: float) -> float:
        """The i_d of least magnitude whose flux, at i_q = 0, is within a limit [A]."""
        allowed = self._flux <= level * (1.0 + 1e-9)
        if not allowed.any():
            return self.current_a
        k = int(np.argmin(np.where(allowed, np.abs(self._axis), np.inf)))
        before = k + 1 if self._axis[k] < 0.0 else k - 1
        if not 0 <= before < len(self._axis) or allowed[before]:
            return float(self._axis[k])
        near, far = self._flux[k], self._flux[before]
        return float(self._axis[k] + (self._axis[before] - self._axis[k]) * (level - near) / (far - near))
