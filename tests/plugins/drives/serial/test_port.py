"""The serial line: what comes through it, and what happens when the other end stops, leaves, or was never there."""

from __future__ import annotations

import os
import socket
import threading
import time
import tty
from collections.abc import Iterator

import pytest
import serial

from plugins.drives.serial import SerialDrive, SerialOptions
from plugins.drives.serial._port import SerialPort
from plugins.link import link_errors
from plugins.wire import Frame, SerialDecoder, to_serial
from protocols import DriveFault, DriveSetup, FaultCause, InputError, Motor
from tests.support.tiny import MOTOR

FRAME = Frame(0x80, b"\x00\x01\x02\x00\x04\x05\x06\x07")


@pytest.fixture
def pty() -> Iterator[tuple[int, str]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)


def test_frames_go_through_in_both_directions(pty: tuple[int, str]) -> None:
    master, path = pty
    port = SerialPort(path, 115200)
    assert port.send([FRAME, FRAME], 0.1)
    assert SerialDecoder().feed(os.read(master, 1000)) == [FRAME, FRAME]
    os.write(master, to_serial(FRAME) * 3)
    assert port.receive(1.0) == [FRAME] * 3
    assert port.receive(0.01) == []
    port.close()
    os.close(master)


def test_a_stopped_peer_swallows_bytes_but_does_not_hold_the_host(pty: tuple[int, str]) -> None:
    master, path = pty
    port = SerialPort(path, 115200)
    large = Frame(0x118, bytes(4000))
    begun = time.monotonic()
    while port.send([large], 0.05):
        assert time.monotonic() - begun < 5.0
    assert not port.send([large], 0.0)
    os.set_blocking(master, False)
    decoder, got = SerialDecoder(), []
    while True:
        try:
            got += decoder.feed(os.read(master, 65536))
        except BlockingIOError:
            break
    assert port.send([FRAME], 0.1)
    got += decoder.feed(os.read(master, 65536))
    assert got[-1] == FRAME, "a frame that was cut off spoils the next one"
    port.close()
    os.close(master)


def test_a_dead_peer_is_a_lost_link(pty: tuple[int, str]) -> None:
    master, path = pty
    port = SerialPort(path, 115200)
    os.close(master)
    with pytest.raises(DriveFault) as fault, link_errors(path):
        port.receive(0.1)
    assert fault.value.cause is FaultCause.LINK_LOST
    port.close()


def test_a_port_is_opened_once_only(pty: tuple[int, str]) -> None:
    master, path = pty
    port = SerialPort(path, 115200)
    with pytest.raises(DriveFault), link_errors(path):
        SerialPort(path, 115200)
    port.close()
    os.close(master)


def test_dtr_is_set_before_opening(monkeypatch: pytest.MonkeyPatch) -> None:
    events: list[str] = []

    class Spy(serial.Serial):  # type: ignore[misc,unused-ignore]
        def open(self) -> None:
            events.append(f"opened with DTR {self.dtr}, exclusive {self.exclusive}")
            raise serial.SerialException("enough")

    monkeypatch.setattr(serial, "Serial", Spy)
    for level in (True, False):
        with pytest.raises(serial.SerialException):
            SerialPort("/dev/null", 9600, dtr=level)
    assert events == ["opened with DTR True, exclusive True", "opened with DTR False, exclusive True"]


def test_a_socket_carries_frames_and_its_end_is_noticed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        accepted: list[socket.socket] = []
        thread = threading.Thread(target=lambda: accepted.append(server.accept()[0]))
        thread.start()
        port = SerialPort(f"socket://127.0.0.1:{server.getsockname()[1]}", 115200)
        thread.join()
        with accepted[0] as peer:
            assert port.send([FRAME], 0.1)
            assert SerialDecoder().feed(peer.recv(1000)) == [FRAME]
            peer.sendall(to_serial(FRAME) * 100)
            got: list[Frame] = []
            while len(got) < 100:
                got += port.receive(1.0)
        with pytest.raises(ConnectionError):
            port.receive(1.0)
        port.close()


@pytest.mark.parametrize("port", ["/dev/nothing-here", "socket://127.0.0.1:1"])
def test_a_port_that_is_not_there_is_one_clear_line(port: str) -> None:
    drive = SerialDrive(DriveSetup(motor=Motor(**MOTOR), options=SerialOptions(port=port), seed=1))
    with pytest.raises(DriveFault) as fault:
        drive.connect()
    assert fault.value.cause is FaultCause.LINK_LOST
    assert "\n" not in str(fault.value)
    assert "; `fluxbench probe` lists the drives on this machine's ports" in str(fault.value)
    if port.startswith("/dev"):
        assert f"the drive's link: could not open port {port}: No such file or directory;" in str(fault.value)
    drive.disarm()
    drive.close()


def test_the_lines_rate_limits_captures_on_real_lines_only(pty: tuple[int, str]) -> None:
    master, path = pty
    port = SerialPort(path, 115200)
    assert port.bulk_rate(port.layout(1020)) is None
    port.close()
    os.close(master)


def test_a_socket_without_a_port_is_refused() -> None:
    with pytest.raises(InputError, match="expected socket://host:port"):
        SerialPort("socket://nowhere", 115200)
