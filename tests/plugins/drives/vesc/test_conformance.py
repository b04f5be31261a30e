"""The drive `vesc` under the kit: the firmware's own protocol, an emulated board behind a pty."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest

from orchestrator.testing import DriveConformance
from plugins.drives.vesc import VescDrive, VescOptions
from protocols import Drive, DriveSetup, Motor
from tests.plugins.drives.vesc.emulator import Firmware, on_a_line

MOTOR = Motor(
    name="48 V servo",
    pole_pairs=7,
    rated_current_rms_a=5.0,
    stator_resistance_ohm=0.2,
    d_inductance_h=250e-6,
    q_inductance_h=400e-6,
)


@pytest.mark.slow
class TestVesc(DriveConformance):
    """Everything that is checked of a drive that holds, and injects at zero current."""

    voltage_tolerance = 0.06
    """Its current control works against the tone, by what the motor's inductance leaves it."""
    angle_tolerance_rad = 0.1
    """Its capture begins with the nearest row at which the wave does."""
    board: ClassVar[Firmware]
    port: ClassVar[str]

    @pytest.fixture(autouse=True)
    @classmethod
    def _emulated(cls) -> Iterator[None]:
        with on_a_line() as (cls.board, cls.port):
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return VescDrive(setup)

    def setup(self) -> DriveSetup:
        return DriveSetup(motor=MOTOR, options=VescOptions(port=self.port, watchdog_s=0.5), seed=1)
