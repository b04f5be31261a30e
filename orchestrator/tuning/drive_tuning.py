"""The tuning of a drive for one motor: everything computed, nothing written."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orchestrator.flux_maps import USES, audit_map
from orchestrator.numerics.types import Array
from orchestrator.tuning.benefits import Benefits, benefits_of
from orchestrator.tuning.compensation import Compensation
from orchestrator.tuning.current_control import CurrentControl, current_control
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from orchestrator.tuning.references import CurrentReferences, current_references, flux_limit, largest_torque
from orchestrator.tuning.sensorless import Sensorless, sensorless_limits
from protocols import FluxMap, InputError

NEEDED_USES = ("mtpa", "observer")
"""Uses of a map that an audit has to leave intact."""
SPEED_NODES = 201
"""Points of the torque curve."""
PICTURED_RATIO, PICTURED_NODES = 2.0, 41
"""Speeds of the pictured torque curve: over the base speed, which may be above the largest one, and their number."""


@dataclass(frozen=True)
class DriveTuning:
    """References, control, compensation and sensorless limits of one motor in one drive."""

    machine: Machine
    limits: DriveLimits
    references: CurrentReferences
    control: CurrentControl
    compensation: Compensation
    sensorless: Sensorless

    @cached_property
    def speeds_rad_s(self) -> Array:
        """Electrical speeds of the torque curve [rad/s], shape (n,)."""
        return np.linspace(0.0, self.limits.speed_rad_s, SPEED_NODES)

    @cached_property
    def torque_curve_nm(self) -> Array:
        """Largest torque at each speed [Nm], shape (n,); 0 beyond the largest reachable speed."""
        psi = flux_limit(self.limits, self.machine.r_s_ohm, self.limits.current_a, self.speeds_rad_s)
        torque = np.interp(psi, self.references.psi_limit_wb, self.references.torque_limit_nm)
        reachable = psi >= self.references.psi_limit_wb[0] * (1.0 - 1e-9)
        return np.where(reachable, torque, 0.0)

    @cached_property
    def whole_torque_curve(self) -> tuple[Array, Array]:
        """Speeds [rad/s] and largest torques [Nm] up to twice the base speed, as far as there is any torque."""
        speeds = np.linspace(0.0, max(self.limits.speed_rad_s, PICTURED_RATIO * self.base_speed_rad_s), PICTURED_NODES)
        psi = flux_limit(self.limits, self.machine.r_s_ohm, self.limits.current_a, speeds)
        levels = np.minimum(psi, self.references.psi_limit_wb[-1])
        torques = largest_torque(self.machine, self.limits, levels)
        shown = max(int(np.searchsorted(-torques, 0.0)) + 1, int(np.searchsorted(speeds, self.limits.speed_rad_s)) + 1)
        return speeds[:shown], torques[:shown]

    @cached_property
    def benefits(self) -> Benefits:
        return benefits_of(self.machine, self.limits, self.references, self.control, self.compensation)

    @property
    def largest_torque_nm(self) -> float:
        return float(self.references.torque_limit_nm[-1])

    @property
    def base_speed_rad_s(self) -> float:
        """Electrical speed up to which the largest torque is available [rad/s], of any speed."""
        return self._speed_of(float(self.references.psi_limit_wb[-1]))

    @property
    def largest_speed_rad_s(self) -> float:
        """Largest speed that the references reach [rad/s]: that of the limits, or less."""
        if self.references.reaches_speed:
            return self.limits.speed_rad_s
        return self._speed_of(float(self.references.psi_limit_wb[0]))

    def rpm(self, speed_rad_s: float) -> float:
        """An electrical speed in mechanical turns per minute."""
        return speed_rad_s / self.machine.pole_pairs * 30.0 / math.pi

    def _speed_of(self, psi_wb: float) -> float:
        at_one = float(flux_limit(self.limits, self.machine.r_s_ohm, self.limits.current_a, 1.0))
        return at_one / psi_wb


def tune(
    machine: Machine, limits: DriveLimits, compensation: Compensation, injection: FluxMap | None = None
) -> DriveTuning:
    """Tune a drive.

    Parameters
    ----------
    machine : Machine
    limits : DriveLimits
    compensation : Compensation
        Of a diagnosed model's effects, or `no_compensation`.
    injection : FluxMap, optional
        Map with inductances that a ripple measured, for sensorless control.

    Raises
    ------
    InputError
        Where the map's audit finds a fault that spoils torque or feed-forward, or the map does not suffice.
    """
    audit = audit_map(machine.flux_map, machine.motor)
    for fault in audit.faults:
        spoilt = [USES[use] for use in NEEDED_USES if use in fault.spoils]
        if spoilt:
            text = f"{fault.remark.text}; this spoils {' and '.join(spoilt)} (`fluxbench audit`)"
            raise InputError("flux map", "", text)
    references = current_references(machine, limits)
    control = current_control(machine, limits, compensation.delay_s)
    least_currents = references.i_dq_a[-1, 1:]
    sensorless = sensorless_limits(
        machine, compensation, limits.current_a, least_currents, injection=injection, table=control.inductance_at
    )
    return DriveTuning(machine, limits, references, control, compensation, sensorless)


def no_compensation(current_a: float) -> Compensation:
    """The compensation of a drive without known effects."""
    zero = np.zeros(3)
    return Compensation(
        current_a=np.array([-current_a, 0.0, current_a]),
        lost_v=zero,
        lost_per_bus_v=zero,
        lost_std_v=zero,
        bias_ab_v=np.zeros(2),
        bias_std_v=0.0,
        current_gain=np.eye(2),
        current_offset_a=np.zeros(2),
        angle_rad=0.0,
        voltage_delay_s=0.0,
        current_delay_s=0.0,
        delay_std_s=0.0,
        sources=(),
        left_out=(),
    )
