"""The reference firmware under the drives' kit: as a process, and on a Cortex-M4 that QEMU emulates."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import ClassVar, Literal

import pytest

from orchestrator.testing import DriveConformance
from plugins.drives.can import CanDrive, CanOptions
from plugins.drives.serial import SerialDrive, SerialOptions
from protocols import Drive, DriveSetup, Motor
from tests.plugins.wire.firmware.built import PATIENT, Board, build, cortex_m4, host_board
from tests.support.tiny import MOTOR

WITH_INTERLOCKS = f"{PATIENT} -DFB_HAS_INTERLOCKS=1"


class OnABoard(DriveConformance):
    """A board for all checks."""

    capture: ClassVar[Literal["raw", "demodulated"]] = "raw"
    running: ClassVar[Board]

    @classmethod
    def board(cls, folder: Path) -> AbstractContextManager[Board]:
        raise NotImplementedError

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _running(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        with cls.board(tmp_path_factory.mktemp("board")) as cls.running:
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return SerialDrive(setup)

    def bridge_is_on(self, drive: Drive) -> bool:
        return self.running.is_on

    def open_interlocks(self, drive: Drive, names: tuple[str, ...]) -> bool:
        self.running.open_interlocks(names)
        return True

    def setup(self) -> DriveSetup:
        options = SerialOptions(port=self.running.port, capture=self.capture, telemetry_period_s=0.15)
        return DriveSetup(motor=Motor(**MOTOR), options=options, seed=1)


@pytest.mark.slow
class TestOnTheHost(OnABoard):
    """Twenty seconds a second."""

    speed: ClassVar[float] = 20.0
    extra: ClassVar[str] = WITH_INTERLOCKS

    @classmethod
    def board(cls, folder: Path) -> AbstractContextManager[Board]:
        return host_board(build(folder, "host", cls.extra), folder, cls.speed)


class TestInRealTime(TestOnTheHost):
    """Settling takes its time, and rows come while they are captured."""

    speed = 1.0


class TestDemodulated(TestOnTheHost):
    """Injections as ripple rows."""

    speed = 1.0
    capture = "demodulated"


@pytest.mark.slow
class TestOnClassicCan(TestOnTheHost):
    """Frames in letters, as a serial CAN adapter writes them (`slcan`); in real time."""

    speed = 1.0
    extra = f"{WITH_INTERLOCKS} -DFB_LINK_CAN=1"

    def make_drive(self, setup: DriveSetup) -> Drive:
        return CanDrive(setup)

    def setup(self) -> DriveSetup:
        bus = {"interface": "slcan", "channel": self.running.port, "settings": {"sleep_after_open": 0.0}}
        options = CanOptions.model_validate({**bus, "capture": self.capture, "telemetry_period_s": 0.15})
        return DriveSetup(motor=Motor(**MOTOR), options=options, seed=1)


@pytest.mark.slow
class TestOnClassicCanDemodulated(TestOnClassicCan):
    """Injections as ripple rows, for which classic CAN is fast enough."""

    capture = "demodulated"


@pytest.mark.slow
class TestOnACortexM4(OnABoard):
    """In real time."""

    @classmethod
    def board(cls, folder: Path) -> AbstractContextManager[Board]:
        return cortex_m4(build(folder, "mps2_an386", WITH_INTERLOCKS), folder)
