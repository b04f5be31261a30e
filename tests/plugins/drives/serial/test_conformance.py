"""The serial drive under the kit that third parties use: the emulated drive is a process at the other end of a pty."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Literal

import pytest

from orchestrator.testing import DriveConformance
from plugins.drives.serial import SerialDrive, SerialOptions
from protocols import Drive, DriveSetup, Motor
from tests.support.emulator import Emulator, emulator, with_interlocks
from tests.support.tiny import MOTOR


class TestSerialDrive(DriveConformance):
    """Raw capture; the emulator's time passes while a program runs, as fast as it can."""

    # Both ends share a machine with everything else that runs: three times the patience that a bench needs.
    words: ClassVar[tuple[str, ...]] = ("--speed", "max", "--watchdog", "0.6")
    switches: ClassVar[Path]
    capture: ClassVar[Literal["raw", "demodulated"]] = "raw"
    line: ClassVar[Path]
    machine: ClassVar[Emulator]

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _emulated(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        folder = tmp_path_factory.mktemp("emulator")
        cls.switches = folder / "switches"
        with emulator(folder, *cls.words, *with_interlocks(cls.switches)) as cls.machine:
            cls.line = folder / "line"
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return SerialDrive(setup)

    def bridge_is_on(self, drive: Drive) -> bool:
        return self.machine.is_energised()

    def open_interlocks(self, drive: Drive, names: tuple[str, ...]) -> bool:
        self.switches.write_text("\n".join(names))
        return True

    def setup(self) -> DriveSetup:
        options = SerialOptions(port=str(self.line), capture=self.capture, telemetry_period_s=0.15)
        return DriveSetup(motor=Motor(**MOTOR), options=options, seed=1)


@pytest.mark.slow
class TestInRealTime(TestSerialDrive):
    """Settling takes its time, and rows come while they are captured."""

    words = ("--speed", "1", "--watchdog", "0.6")


@pytest.mark.slow
class TestDemodulated(TestSerialDrive):
    """Injections as ripple rows."""

    words = ("--speed", "1", "--watchdog", "0.6")
    capture = "demodulated"


@pytest.mark.slow
class TestOnABadLine(TestSerialDrive):
    """One frame in a hundred is lost, comes twice, out of order or damaged, each way."""

    words = (
        "--speed",
        "4",
        "--watchdog",
        "0.6",
        "--drop",
        "0.01",
        "--duplicate",
        "0.01",
        "--reorder",
        "0.01",
        "--corrupt",
        "0.01",
    )
