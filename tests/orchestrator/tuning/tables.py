"""Tunings of the closed loop's plant, by the project's own code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.tuning.c_code import c_files, source_values
from orchestrator.tuning.c_code_int32 import c_files_int32
from orchestrator.tuning.compensation import Compensation
from orchestrator.tuning.current_control import CurrentControl, current_control
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.machine import Machine
from orchestrator.tuning.references import CurrentReferences, current_references
from protocols import Motor
from tests.orchestrator.tuning.closed_loop import Plant
from tests.orchestrator.tuning.machines import Flux, flux_map

LIMITS = DriveLimits(current_a=20.0, bus_v=300.0, speed_rad_s=3000.0, sampling_hz=1e4, pwm_hz=1e4)
REACH_A = 24.0
NODES = 41


@dataclass(frozen=True)
class Tables:
    """What the C code is rendered from."""

    motor: Motor
    references: CurrentReferences
    control: CurrentControl
    compensation: Compensation
    limits: DriveLimits
    magnet_per_k: float | None = None

    def files(self) -> dict[str, bytes]:
        return c_files(source_values("motor", *self._parts()))

    def int32_files(self) -> dict[str, bytes]:
        return c_files_int32(source_values("motor", *self._parts()))

    def _parts(
        self,
    ) -> tuple[Motor, CurrentReferences, CurrentControl, Compensation, DriveLimits, float | None]:
        return self.motor, self.references, self.control, self.compensation, self.limits, self.magnet_per_k


def tables_of(
    plant: Plant, flux: Flux | None = None, *, std: float = 0.0, limits: DriveLimits = LIMITS, reach_a: float = REACH_A
) -> Tables:
    """Tables from a plant's own map, or from another one, with a relative standard deviation."""
    motor = Motor(name="plant */ Motör", pole_pairs=round(plant.pole_pairs))
    map_of = flux_map(flux or plant.psi, reach_a, nodes=NODES, std=std)
    machine = Machine(motor, map_of, plant.r_s, 0.01 * plant.r_s)
    references, control = current_references(machine, limits), current_control(machine, limits)
    return Tables(motor, references, control, exact_compensation(plant), limits)


def exact_compensation(plant: Plant) -> Compensation:
    """The compensation of a plant's inverter and sensors by their own formulas."""
    current = np.linspace(-REACH_A, REACH_A, 401)
    lost = plant.lost_v(current, 0.0)
    a, b = plant.gain_a, plant.gain_b
    read = np.array([[a, 0.0], [(a - b) / np.sqrt(3.0), b]])
    offset = np.array([plant.offset_a, (plant.offset_a + 2.0 * plant.offset_b) / np.sqrt(3.0)])
    gain = np.linalg.inv(read)
    return Compensation(
        current_a=current,
        lost_v=lost,
        lost_per_bus_v=plant.lost_v(current, 1.0) - lost,
        lost_std_v=np.zeros(401),
        bias_ab_v=np.zeros(2),
        bias_std_v=0.0,
        current_gain=gain,
        current_offset_a=-gain @ offset,
        angle_rad=plant.angle_error,
        voltage_delay_s=0.0,
        current_delay_s=0.0,
        delay_std_s=0.0,
        sources=("dead_time",),
        left_out=(),
    )
