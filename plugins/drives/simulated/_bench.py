"""The test bench: its brake, the rotor's rest angle and the misalignment by the brake."""

from __future__ import annotations

import math

import numpy as np

from plugins.drives.simulated._simulator import Simulator
from plugins.drives.simulated._state import THETA, PlantParameters
from plugins.drives.simulated.options import Plant


class Bench:
    """Brake and rotor of one plant."""

    def __init__(self, plant: Plant, seed: int) -> None:
        self._plant, self._seed = plant, seed % 2**64
        self.braked = plant.brake.start == "engaged" and plant.brake.works

    @property
    def _misalignment(self) -> float:
        effect = self._plant.effects.rotor_misalignment
        return 0.0 if effect is None else effect.angle_rad

    def rest_angle(self) -> float:
        """Rotor angle at the start [rad]: 0 with the brake engaged, random where it is released."""
        rest = self._plant.rotor.rest_angle_rad
        if self.braked:
            return (rest or 0.0) + self._misalignment
        if rest is not None:
            return rest
        return float(np.random.default_rng([self._seed, 4]).uniform(-math.pi, math.pi))

    def mechanics(self, simulator: Simulator) -> PlantParameters:
        """The plant's parameters with the brake's present state."""
        plant = simulator.plant
        return plant.locked(self._plant.brake.slip_torque_nm) if self.braked else plant.parameters

    def set_brake(self, engaged: bool, simulator: Simulator) -> None:
        """Engage or release the brake; engaging turns the shaft by the misalignment."""
        engaged = engaged and self._plant.brake.works
        if engaged == self.braked:
            return
        self.braked = engaged
        if engaged:
            simulator.turn_to(float(simulator.memory.state[THETA]) + self._misalignment)
        simulator.hold_rotor(self.mechanics(simulator))
