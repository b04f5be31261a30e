"""The moteus drive under the kit: official library, text protocol of the fdcanusb, an emulated board behind a pty."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import pytest

from orchestrator.testing import DriveConformance

pytest.importorskip("moteus", reason="the official library of moteus is an optional extra")

from plugins.drives.moteus import MoteusDrive, MoteusOptions
from protocols import Drive, DriveSetup, Motor
from tests.plugins.drives.moteus.emulator import Fdcanusb, fdcanusb

MOTOR = Motor(name="mj5208", pole_pairs=7, rated_current_rms_a=5.0, stator_resistance_ohm=0.4)


@pytest.mark.slow
class TestMoteus(DriveConformance):
    """Everything that is checked of a drive that claims `hold`."""

    port: ClassVar[Fdcanusb]

    @pytest.fixture(autouse=True)
    @classmethod
    def _emulated(cls) -> Iterator[None]:
        with fdcanusb() as cls.port:
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return MoteusDrive(setup)

    def setup(self) -> DriveSetup:
        return DriveSetup(
            motor=MOTOR, options=MoteusOptions(port=self.port.path, sampling_frequency_hz=40.0, watchdog_s=0.6), seed=1
        )
