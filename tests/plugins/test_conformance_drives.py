"""The built-in drives under the kit that third parties use."""

from __future__ import annotations

import pytest

from orchestrator.testing import DriveConformance
from plugins.drives.simulated import SimulatedDrive, SimulatedOptions
from protocols import Drive, DriveSetup, Motor


class TestSimulatedDrive(DriveConformance):
    """The 400 W machine of the paper."""

    motor = Motor(
        name="400 W test PMSM",
        pole_pairs=2,
        rated_power_w=400.0,
        rated_voltage_rms_v=139.3,
        rated_current_rms_a=1.66,
        rated_torque_nm=2.12,
        stator_resistance_ohm=4.25,
        d_inductance_h=0.04325,
        q_inductance_h=0.06905,
        pm_flux_wb=0.3,
    )

    def make_drive(self, setup: DriveSetup) -> Drive:
        return SimulatedDrive(setup)

    def setup(self) -> DriveSetup:
        return DriveSetup(motor=self.motor, options=SimulatedOptions(), seed=1)


@pytest.mark.slow
class TestSimulatedServo(TestSimulatedDrive):
    """A 48 V servo of another scale, by its nameplate alone."""

    motor = Motor(
        name="48 V servo",
        pole_pairs=4,
        rated_voltage_rms_v=28.0,
        rated_current_rms_a=7.0,
        rated_torque_nm=0.6,
        stator_resistance_ohm=0.5,
        d_inductance_h=0.0003,
        q_inductance_h=0.0003,
        pm_flux_wb=0.012,
    )
