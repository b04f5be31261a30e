"""Motors of three sizes and drives that stand ready; the plant's loop is compiled once and cached on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plugins.drives.simulated import SimulatedDrive, SimulatedOptions
from protocols import Capture, DriveSetup, Excitation, Limits, Motor

PM400 = Motor(
    name="400 W test PMSM",
    pole_pairs=2,
    rated_voltage_rms_v=139.3,
    rated_current_rms_a=1.66,
    rated_torque_nm=2.12,
    stator_resistance_ohm=4.25,
    d_inductance_h=0.04325,
    q_inductance_h=0.06905,
    pm_flux_wb=0.30,
)
SERVO = Motor(
    name="48 V servo",
    pole_pairs=4,
    rated_voltage_rms_v=24.0,
    rated_current_rms_a=5.0,
    stator_resistance_ohm=0.5,
    d_inductance_h=0.3e-3,
    q_inductance_h=0.32e-3,
    pm_flux_wb=0.012,
)
LARGE = Motor(
    name="28 kW IPM",
    pole_pairs=3,
    rated_voltage_rms_v=200.0,
    rated_current_rms_a=102.5,
    stator_resistance_ohm=0.04,
    d_inductance_h=0.8e-3,
    q_inductance_h=2.0e-3,
    pm_flux_wb=0.25,
)
MOTORS = [pytest.param(m, id=m.name.split()[0] + m.name.split()[1]) for m in (PM400, SERVO, LARGE)]

Bench = Callable[..., SimulatedDrive]


def options_of(**raw: Any) -> SimulatedOptions:
    """Options as a procedure would give them."""
    return SimulatedOptions.model_validate({"watchdog_s": None, "dc_bus_voltage_v": None, **raw})


def rows(drive: SimulatedDrive, excitation: Excitation) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """All of an excitation's currents and voltages, float64."""
    blocks = list(drive.execute(excitation))
    return joined(blocks)


def joined(blocks: list[Capture]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    i = np.concatenate([b.i_ab for b in blocks]).astype(np.float64)
    v = np.concatenate([b.v_ab for b in blocks]).astype(np.float64)
    return i, v


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A connected and armed drive: ``bench(motor=..., effects={...}, brake={...}, **options)``."""
    drives: list[SimulatedDrive] = []

    def make(
        motor: Motor = PM400,
        *,
        effects: dict[str, Any] | None = None,
        seed: int = 1,
        private: Path | None = None,
        armed: bool = True,
        noise: bool = False,
        plant: dict[str, Any] | None = None,
        **raw: Any,
    ) -> SimulatedDrive:
        silent: dict[str, Any] = {} if noise else {"sensors": {"noise_a": 0.0, "quantum_a": 0.0}}
        options = options_of(plant={**silent, **(plant or {}), "effects": effects or {}}, **raw)
        drive = SimulatedDrive(DriveSetup(motor=motor, options=options, seed=seed, private_directory=private))
        capabilities = drive.connect()
        if armed:
            drive.arm(Limits(current_a=capabilities.max_current_a, voltage_v=capabilities.max_voltage_v))
        drives.append(drive)
        return drive

    yield make
    for drive in drives:
        drive.close()
