"""The CAN drive under the kit: the emulated drive is a process on the same bus, which is multicast on this machine."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest

from orchestrator.testing import DriveConformance
from plugins.commands.emulator._can_ports import SerialCanPort
from plugins.drives.can import CanDrive, CanOptions
from protocols import Drive, DriveSetup, DriveState, Hold, Limits, Motor
from tests.plugins.commands.emulator.buses import emulated_on
from tests.support.emulator import Emulator, emulator, free_port, with_interlocks
from tests.support.tiny import MOTOR

GROUP = "239.74.163.91"
ROOMY = ("--memory-rows", "32768")
"""Memory for a whole capture: a busy machine may be behind by more than a microcontroller holds."""
HAS_MULTICAST = find_spec("msgpack") is not None


def slowly(kit: type[OnABus]) -> type[OnABus]:
    """Marks a kit as slow, and skips it where python-can's multicast bus lacks what it needs."""
    return pytest.mark.slow(pytest.mark.skipif(not HAS_MULTICAST, reason="udp_multicast needs msgpack")(kit))


def test_a_hold_over_python_cans_serial_interface_is_captured_whole(tmp_path: Path) -> None:
    channel = tmp_path / "bus"
    with emulated_on(SerialCanPort(channel), seed=1, speed=None):
        options = CanOptions(interface="serial", channel=str(channel), telemetry_period_s=0.15)
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


class OnABus(DriveConformance):
    """python-can's `udp_multicast`, which keeps its frames on this machine and loses what nobody has fetched."""

    # Both ends share a machine with everything else that runs: three times the patience that a bench needs.
    words: ClassVar[tuple[str, ...]] = ("--speed", "max")
    capture: ClassVar[Literal["raw", "demodulated"]] = "raw"
    fd: ClassVar[bool] = False
    settings: ClassVar[dict[str, int]]
    switches: ClassVar[Path]
    machine: ClassVar[Emulator]

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _emulated(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        cls.settings = {"port": free_port(), "hop_limit": 0}
        given = [word for key, value in cls.settings.items() for word in ("--can-set", f"{key}={value}")]
        bus = (f"udp_multicast:{GROUP}", *(["--fd"] if cls.fd else []), *given)
        folder = tmp_path_factory.mktemp("emulator")
        cls.switches = folder / "switches"
        words = (*bus, "--watchdog", "0.6", *cls.words, *with_interlocks(cls.switches))
        with emulator(folder, *words, link="--can") as cls.machine:
            yield

    def make_drive(self, setup: DriveSetup) -> Drive:
        return CanDrive(setup)

    def bridge_is_on(self, drive: Drive) -> bool:
        return self.machine.is_energised()

    def open_interlocks(self, drive: Drive, names: tuple[str, ...]) -> bool:
        self.switches.write_text("\n".join(names))
        return True

    def setup(self) -> DriveSetup:
        options = CanOptions(
            interface="udp_multicast",
            channel=GROUP,
            fd=self.fd,
            settings=self.settings,
            capture=self.capture,
            telemetry_period_s=0.15,
        )
        return DriveSetup(motor=Motor(**MOTOR), options=options, seed=1)


@slowly
class TestClassicCan(OnABus):
    """Six bytes a frame."""


@slowly
class TestClassicCanDemodulated(OnABus):
    """Injections as ripple rows, which classic CAN is fast enough for."""

    capture = "demodulated"


@slowly
class TestCanFd(OnABus):
    """Frames of 64 bytes."""

    fd = True


@slowly
class TestCanFdInRealTime(OnABus):
    """Rows come while they are captured, at the pace of a bus of 1/5 Mbit/s."""

    words = ("--speed", "1", "--rate", "125000")
    fd = True


@slowly
class TestCanFdDemodulated(OnABus):
    """Ripple rows in long frames."""

    words = ("--speed", "1")
    capture = "demodulated"
    fd = True


@slowly
class TestOnABadBus(OnABus):
    """One frame in a hundred is lost, comes twice or out of order, each way; what is damaged the controllers drop."""

    words = ("--speed", "1", *ROOMY, "--drop", "0.01", "--duplicate", "0.01", "--reorder", "0.01")
    fd = True
