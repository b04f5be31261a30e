"""An ECU whose messages are altered on the way: each ends in a fault with one line, in time, and nothing is printed."""

from __future__ import annotations

import random
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

pytest.importorskip("pyxcp", reason="the XCP master is an optional extra")

from plugins.drives.xcp import XcpDrive
from protocols import DriveFault, DriveSetup, Hold, Limits, Motor
from tests.plugins.drives.xcp.built import Program, build, running
from tests.support.tiny import MOTOR

LIMITS = Limits(current_a=4.0, voltage_v=150.0)
HOLD = Hold(current_d_a=1.0, current_q_a=0.5, settle_s=0.1, duration_s=0.3)
RESPONSE, ERROR, EVENT = 0xFF, 0xFE, 0xFD
Alter = Callable[[bytes], list[bytes]]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Program:
    return build(tmp_path_factory.mktemp("built"), 1_000_000_000)


@contextmanager
def between(port: int, alter: list[Alter]) -> Iterator[int]:
    """A port in front of the ECU's that sends on what the last of `alter` makes of its datagrams."""
    host_side, ecu_side = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    over = threading.Event()
    host_side.bind(("127.0.0.1", 0))
    ecu_side.connect(("127.0.0.1", port))
    for one in (host_side, ecu_side):
        one.settimeout(0.05)
    hosts: list[tuple[str, int]] = []

    def to_ecu() -> None:
        while not over.is_set():
            with suppress(OSError):
                data, host = host_side.recvfrom(65536)
                hosts[:] = [host]
                ecu_side.send(data)

    def to_host() -> None:
        while not over.is_set():
            with suppress(OSError):
                for datagram in alter[-1](ecu_side.recv(65536)):
                    host_side.sendto(datagram, hosts[0])

    threads = [threading.Thread(target=work, daemon=True) for work in (to_ecu, to_host)]
    for thread in threads:
        thread.start()
    try:
        yield host_side.getsockname()[1]
    finally:
        over.set()
        for thread in threads:
            thread.join()
        host_side.close()
        ecu_side.close()


def framed(like: bytes, message: bytes) -> bytes:
    """A message with its length, and the counter of another."""
    return len(message).to_bytes(2, "little") + like[2:4] + message


def honest(datagram: bytes) -> list[bytes]:
    return [datagram]


def answers(message: bytes) -> Alter:
    def alter(datagram: bytes) -> list[bytes]:
        return [framed(datagram, message)] if datagram[4] == RESPONSE else [datagram]

    return alter


def garbage(datagram: bytes) -> list[bytes]:
    return [random.Random(datagram).randbytes(1 + datagram[2] % 60)]


def flood_of_messages(datagram: bytes) -> list[bytes]:
    rng = random.Random(datagram)
    return [datagram, *(framed(datagram, rng.randbytes(8)) for _ in range(50))]


def flood_of_answers(datagram: bytes) -> list[bytes]:
    return [datagram, *[framed(datagram, bytes([RESPONSE, 1, 2]))] * 50]


def huge_length(datagram: bytes) -> list[bytes]:
    return [b"\xff\xff" + datagram[2:]]


def arm_and_hold(drive: XcpDrive) -> None:
    drive.arm(LIMITS)
    list(drive.execute(HOLD))


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    ("alter", "message"),
    [
        (answers(bytes([ERROR, 0x2B])), "the ECU answers with the error 0x2b, which XCP does not define"),
        (answers(bytes([ERROR, 0x29])), "the ECU answers with the error ERR_SEQUENCE"),
        (answers(bytes([RESPONSE])), r"cannot be read \(0 octets answer a request for 88\)"),
        pytest.param(garbage, "drive fault (link_lost|wrong_data|no_answer)", marks=pytest.mark.slow),
        (flood_of_messages, "drive fault (link_lost|wrong_data|no_answer)"),
        (flood_of_answers, "drive fault (link_lost|wrong_data|no_answer)"),
        pytest.param(huge_length, "no (row for 2 s|answer)", marks=pytest.mark.slow),
    ],
)
def test_altered_messages_are_a_lost_link_with_its_reason(
    alter: Alter, message: str, program: Program, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    ways: list[Alter] = [honest]
    with running(program, tmp_path, "udp") as ecu, between(ecu.options.port, ways) as port:
        options = ecu.options.model_copy(update={"port": port, "timeout_s": 2.0})
        drive = XcpDrive(DriveSetup(motor=Motor(**MOTOR), options=options, seed=1))
        drive.connect()
        ways.append(alter)
        with pytest.raises(DriveFault, match=message) as fault:
            arm_and_hold(drive)
        drive.close()
    assert "\n" not in str(fault.value)
    assert "".join(capfd.readouterr()) == ""


def test_events_between_the_rows_are_passed_over_in_silence(
    program: Program, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def with_events(datagram: bytes) -> list[bytes]:
        return [datagram, framed(datagram, bytes([EVENT, 0x77, 1])), framed(datagram, bytes([EVENT]))]

    with running(program, tmp_path, "udp") as ecu, between(ecu.options.port, [with_events]) as port:
        options = ecu.options.model_copy(update={"port": port})
        drive = XcpDrive(DriveSetup(motor=Motor(**MOTOR), options=options, seed=1))
        drive.connect()
        drive.arm(LIMITS)
        rows = sum(map(len, drive.execute(HOLD)))
        drive.disarm()
        drive.close()
    assert rows == round(HOLD.duration_s * 10_000.0)
    assert "".join(capfd.readouterr()) == ""
