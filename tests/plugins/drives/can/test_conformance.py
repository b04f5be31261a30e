"""The CAN drive under the kit: the emulated drive is a process at the other end of python-can's serial interface."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest

from orchestrator.testing import DriveConformance
from plugins.drives.can import CanDrive, CanOptions
from protocols import Drive, DriveSetup, DriveState, Hold, Limits, Motor
from tests.support.emulator import emulator
from tests.support.tiny import MOTOR

GROUP, UDP_PORT = "239.74.163.91", 43191


def test_a_hold_over_can_is_captured_whole(tmp_path: Path) -> None:
    channel = tmp_path / "bus"
    with emulator(tmp_path, f"serial:{channel}", "--speed", "max", link="--can"):
        options = CanOptions(interface="serial", channel=str(channel))
        drive = CanDrive(DriveSetup(motor=Motor(**MOTOR), options=options, seed=1))
        drive.connect()
        drive.arm(Limits(current_a=4.0, voltage_v=100.0))
        hold = Hold(current_d_a=1.0, current_q_a=-0.5, settle_s=0.4, duration_s=0.05)
        blocks = []
        for block in drive.execute(hold):
            drive.heartbeat()
            blocks.append(block)
        drive.ramp_down()
        drive.disarm()
        assert drive.telemetry().state is DriveState.DISARMED
        drive.close()
    i_ab = np.concatenate([block.i_ab for block in blocks])
    assert len(i_ab) == 500
    np.testing.assert_allclose(i_ab.mean(axis=0), (1.0, -0.5), atol=0.02)


@pytest.mark.slow
class TestClassicCan(DriveConformance):
    """Classic frames, no losses."""

    capture: ClassVar[Literal["raw", "demodulated"]] = "raw"
    words: ClassVar[tuple[str, ...]] = ("--speed", "max", "--watchdog", "0.6")
    bus: ClassVar[Path]

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _emulated(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        folder = tmp_path_factory.mktemp("emulator")
        with emulator(folder, f"serial:{folder / 'bus'}", *cls.words, link="--can"):
            cls.bus = folder / "bus"
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return CanDrive(setup)

    def setup(self) -> DriveSetup:
        options = CanOptions(interface="serial", channel=str(self.bus), capture=self.capture, telemetry_period_s=0.15)
        return DriveSetup(motor=Motor(**MOTOR), options=options, seed=1)


@pytest.mark.slow
class TestClassicCanDemodulated(TestClassicCan):
    """What classic CAN is fast enough for in real time: ripple rows."""

    words = ("--speed", "1", "--watchdog", "0.6")
    capture = "demodulated"


@pytest.mark.slow
@pytest.mark.skipif(find_spec("msgpack") is None, reason="python-can's udp_multicast needs msgpack")
class TestCanFd(DriveConformance):
    """Frames of 64 bytes over multicast on loopback, which loses some."""

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _emulated(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        words = (
            f"udp_multicast:{GROUP}",
            "--fd",
            "--can-set",
            f"port={UDP_PORT}",
            "--speed",
            "max",
            "--watchdog",
            "0.6",
        )
        with emulator(tmp_path_factory.mktemp("emulator"), *words, "--rate", "600000", link="--can"):
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return CanDrive(setup)

    def setup(self) -> DriveSetup:
        options = CanOptions(
            interface="udp_multicast", channel=GROUP, fd=True, settings={"port": UDP_PORT}, telemetry_period_s=0.15
        )
        return DriveSetup(motor=Motor(**MOTOR), options=options, seed=1)
