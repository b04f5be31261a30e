"""The CAN bus: batches, strangers' frames, damaged frames, and a bus that goes down."""

from __future__ import annotations

import os
import time
import tty
from collections.abc import Iterator

import can
import pytest

from plugins.drives.can import CanDrive, CanOptions
from plugins.drives.can._port import CanPort
from plugins.link import link_errors
from plugins.wire import CAN_FD_LAYOUT, CLASSIC_LAYOUT, Frame
from protocols import DriveFault, DriveSetup, FaultCause, InputError, Motor
from tests.support.tiny import MOTOR

FRAME = Frame(0x80, bytes(range(8)))


@pytest.fixture
def pair() -> Iterator[tuple[CanPort, can.BusABC]]:
    """A port on python-can's serial interface, and a bus at the other end of the pseudo-terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    port = CanPort("serial", os.ttyname(slave), 1_000_000)
    with os.fdopen(master, "r+b", buffering=0):
        yield port, _Peer(master)
    port.close()
    os.close(slave)


class _Peer(can.BusABC):
    """Writes python-can's serial format to a file descriptor."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._is_shutdown = True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        head = b"\xaa" + bytes(4) + bytes([msg.dlc]) + msg.arbitration_id.to_bytes(4, "little")
        os.write(self._fd, head + bytes(msg.data) + b"\xbb")

    def raw(self, data: bytes) -> None:
        os.write(self._fd, data)

    def read(self) -> bytes:
        return os.read(self._fd, 1000)


def message(frame: Frame, **more: bool) -> can.Message:
    return can.Message(arbitration_id=frame.frame_id, data=frame.payload, **{"is_extended_id": False, **more})


def test_what_is_there_comes_in_batches(pair: tuple[CanPort, _Peer]) -> None:
    port, peer = pair
    for _ in range(50):
        peer.send(message(FRAME))
    batches = [port.receive(1.0)]
    while sum(map(len, batches)) < 50:
        batches.append(port.receive(1.0))
    assert [frame for batch in batches for frame in batch] == [FRAME] * 50
    assert len(batches) < 10
    assert port.receive(0.01) == []


def test_a_batch_ends_after_a_while_however_slow_the_interface_is() -> None:
    with can.Bus(channel="slow", interface="virtual", ignore_config=True) as other:
        port = CanPort("virtual", "slow", 1_000_000)
        for _ in range(100):
            other.send(message(FRAME))
        receive = port._bus.recv

        def slowly(timeout: float | None = None) -> can.Message | None:
            begun = time.thread_time()
            while time.thread_time() < begun + 2e-3:
                pass
            return receive(timeout)

        port._bus.recv = slowly  # type: ignore[method-assign]
        assert 1 <= len(port.receive(1.0)) <= 10
        port.close()


def test_control_frames_are_classic_on_every_bus(pair: tuple[CanPort, _Peer]) -> None:
    port, peer = pair
    assert port.send([FRAME], 0.1)
    assert peer.read()[5] == 8
    with can.Bus(channel="classic", interface="virtual", ignore_config=True) as other:
        fd = CanPort("virtual", "classic", 1_000_000, fd=True)
        assert fd.send([FRAME], 0.1)
        received = other.recv(1.0)
        assert received is not None
        assert not received.is_fd
        fd.close()


def test_strangers_frames_are_passed_over() -> None:
    with can.Bus(channel="strangers", interface="virtual", ignore_config=True) as other:
        port = CanPort("virtual", "strangers", 1_000_000)
        other.send(message(FRAME, is_extended_id=True))
        other.send(message(Frame(0x80, b""), is_remote_frame=True))
        other.send(message(Frame(0x80, b""), is_error_frame=True))
        other.send(message(FRAME))
        got: list[Frame] = []
        for _ in range(5):
            got += port.receive(0.05)
        assert got == [FRAME]
        port.close()


def test_a_port_speaks_and_hears_for_its_own_node_alone() -> None:
    with can.Bus(channel="nodes", interface="virtual", ignore_config=True) as other:
        port = CanPort("virtual", "nodes", 1_000_000, node=2)
        assert port.where == "virtual:nodes node 2"
        assert port.send([FRAME], 0.1)
        received = other.recv(1.0)
        assert received is not None
        assert received.arbitration_id == FRAME.frame_id + 2
        for node in range(4):
            other.send(message(Frame(FRAME.frame_id + node, bytes([node]))))
        got: list[Frame] = []
        for _ in range(5):
            got += port.receive(0.05)
        assert got == [Frame(FRAME.frame_id, b"\2")]
        port.close()


def test_a_damaged_frame_is_dropped_and_the_next_ones_come(pair: tuple[CanPort, _Peer]) -> None:
    port, peer = pair
    peer.send(message(FRAME))
    peer.raw(b"\xaa" + bytes(4) + b"\x09" + bytes(4))  # nine bytes of data there cannot be
    peer.send(message(FRAME))
    got: list[Frame] = []
    for _ in range(20):
        with link_errors("bus"):
            got += port.receive(0.05)
    assert got == [FRAME, FRAME]


def test_a_bus_that_goes_down_is_a_lost_link() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    port = CanPort("serial", os.ttyname(slave), 1_000_000)
    os.close(slave)
    os.close(master)
    with pytest.raises(DriveFault) as fault, link_errors(port.where):
        list(iter(lambda: port.receive(0.05), None))
    assert fault.value.cause is FaultCause.LINK_LOST
    port.close()


def test_rates_and_layouts_are_those_of_the_bus() -> None:
    classic, fd = CanPort("virtual", "a", 500_000), CanPort("virtual", "b", 500_000, fd=True)
    assert (classic.layout(1020), fd.layout(1020)) == (CLASSIC_LAYOUT, CAN_FD_LAYOUT)
    assert classic.bulk_rate(CLASSIC_LAYOUT) is None
    for port, kilobytes in ((classic, 17.8), (fd, 230.8)):
        port._rates = (500_000, 5_000_000)
        assert port.bulk_rate(port.layout(0)) == pytest.approx(1e3 * kilobytes, rel=0.02)
        port.close()


def drive_on(interface: str) -> CanDrive:
    options = CanOptions(interface=interface, channel="nowhere0")
    return CanDrive(DriveSetup(motor=Motor(**MOTOR), options=options, seed=1))


def test_a_bus_that_is_not_there_is_one_clear_line() -> None:
    drive = drive_on("socketcan")
    with pytest.raises(DriveFault) as fault:
        drive.connect()
    assert fault.value.cause is FaultCause.LINK_LOST
    assert "\n" not in str(fault.value)
    drive.close()


def test_an_interface_that_python_can_does_not_know_is_named() -> None:
    with pytest.raises(InputError, match="no-such-interface:nowhere0: CAN interface 'no-such-interface' not supported"):
        drive_on("no-such-interface").connect()
