"""The drive `odrive` under the kit: the firmware's ASCII protocol, an emulated board behind a pty."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest

from orchestrator.testing import DriveConformance
from plugins.drives.odrive import OdriveDrive, OdriveOptions
from protocols import Drive, DriveSetup, Motor
from tests.plugins.drives.odrive.emulator import Board, on_a_line

MOTOR = Motor(name="D5065", pole_pairs=7, rated_current_rms_a=8.0, stator_resistance_ohm=0.2)


@pytest.mark.slow
class TestOdrive(DriveConformance):
    """Everything that is checked of a drive that claims `hold`."""

    angle_tolerance_rad = 0.06
    board: ClassVar[Board]
    port: ClassVar[str]

    @pytest.fixture(autouse=True)
    @classmethod
    def _emulated(cls) -> Iterator[None]:
        with on_a_line() as (cls.board, cls.port):
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return OdriveDrive(setup)

    def setup(self) -> DriveSetup:
        return DriveSetup(motor=MOTOR, options=OdriveOptions(port=self.port, watchdog_s=0.6), seed=1)

    def bridge_is_on(self, drive: Drive) -> bool:
        return self.board.armed
