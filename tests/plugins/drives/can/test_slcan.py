"""A CAN bus behind a serial adapter: the letters are those of python-can, and what is damaged is no frame."""

from __future__ import annotations

import os
import select
import time
import tty
from collections.abc import Iterator

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plugins.drives.can import CanDrive, CanOptions
from plugins.drives.can._port import CanPort, classic_rate
from plugins.drives.can._slcan import SlcanPort
from plugins.wire import CLASSIC_LAYOUT, Frame
from protocols import DriveSetup, InputError, Motor
from tests.support.tiny import MOTOR

AWAKE = {"sleep_after_open": 0.0}
RATE = classic_rate(1_000_000)
FRAMES = [Frame(0x80, bytes(range(8))), Frame(0x10, b""), Frame(0x0B0, b"\x01\xff\r")]
frames = st.builds(Frame, st.integers(0, 0x1FF).map(lambda k: 4 * k), st.binary(max_size=8))


class Adapter:
    """The other end of a pseudo-terminal."""

    def __init__(self) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)

    def received(self) -> bytes:
        """Everything that comes before a pause: a terminal hands it on in pieces."""
        data = b""
        while select.select([self.master], [], [], 0.005)[0]:
            data += os.read(self.master, 65536)
        return data

    def write(self, letters: bytes) -> None:
        os.write(self.master, letters)

    def close(self) -> None:
        os.close(self.master)
        os.close(self._slave)


def received(port: SlcanPort, count: int) -> list[Frame]:
    """So many frames: a terminal hands letters on in pieces, and a piece may have none."""
    found: list[Frame] = []
    until_s = time.monotonic() + 5.0
    while len(found) < count and time.monotonic() < until_s:
        found += port.receive(0.1)
    return found


@pytest.fixture(scope="module")
def adapter() -> Iterator[Adapter]:
    made = Adapter()
    yield made
    made.close()


@pytest.fixture(scope="module")
def port(adapter: Adapter) -> Iterator[SlcanPort]:
    made = SlcanPort(adapter.path, 1_000_000, RATE, settings=AWAKE)
    assert adapter.received() == b"\rC\rS8\rO\r"
    yield made
    made.close()
    assert adapter.received() == b"\rC\r"


@pytest.fixture(scope="module")
def oracle() -> Iterator[tuple[Adapter, can.BusABC]]:
    """python-can's own interface, at a line of its own."""
    made = Adapter()
    bus = can.Bus(interface="slcan", channel=made.path, sleep_after_open=0.0, ignore_config=True)
    made.received()
    yield made, bus
    bus.shutdown()
    made.close()


@settings(deadline=None, max_examples=30)
@given(st.lists(frames, min_size=1, max_size=9))
def test_what_python_can_says_is_received(
    adapter: Adapter, port: SlcanPort, oracle: tuple[Adapter, can.BusABC], frames: list[Frame]
) -> None:
    line, bus = oracle
    for frame in frames:
        bus.send(can.Message(arbitration_id=frame.frame_id, data=frame.payload, is_extended_id=False))
    adapter.write(line.received())
    assert received(port, len(frames)) == frames


@settings(deadline=None, max_examples=30)
@given(st.lists(frames, min_size=1, max_size=9))
def test_what_is_stated_python_can_hears(
    adapter: Adapter, port: SlcanPort, oracle: tuple[Adapter, can.BusABC], frames: list[Frame]
) -> None:
    line, bus = oracle
    assert port.send(frames, 0.1)
    line.write(adapter.received())
    found: list[can.Message] = []
    until_s = time.monotonic() + 5.0
    while len(found) < len(frames) and time.monotonic() < until_s:
        found += [m for m in [bus.recv(0.01)] if m is not None]
    assert [Frame(m.arbitration_id, bytes(m.data)) for m in found] == frames


def test_a_frame_that_comes_in_two_parts_is_one(adapter: Adapter, port: SlcanPort) -> None:
    letters = port.as_written(FRAMES)
    for cut in range(1, len(letters)):
        adapter.write(letters[:cut])
        first = port.receive(1.0)
        adapter.write(letters[cut:])
        assert first + received(port, len(FRAMES) - len(first)) == FRAMES


def test_answers_strangers_and_damaged_letters_are_no_frames(adapter: Adapter, port: SlcanPort) -> None:
    adapter.write(
        b"z\r\a\rV1013\rT000000801AA\rr0800\rt08\rt0802AA\rt0801GG\rtXYZ0\rt0811BB\rt080900112233445566778899\r"
    )
    adapter.write(b"t0801CC\r")
    assert received(port, 1) == [Frame(0x80, b"\xcc")]


def test_a_drive_s_node_is_on_its_frames_and_no_other_is_received() -> None:
    line = Adapter()
    port = SlcanPort(line.path, 500_000, RATE, node=2, settings=AWAKE)
    assert line.received() == b"\rC\rS6\rO\r"
    assert port.send(FRAMES[:1], 0.1)
    assert line.received().strip() == b"t08280001020304050607"
    line.write(b"t0800\rt0820\rt0110\r")
    assert received(port, 2) == [Frame(0x80, b""), Frame(0x10, b"")]  # EStop is everybody's
    port.close()
    line.close()


def test_an_adapter_that_takes_nothing_is_stated_not_to() -> None:
    line = Adapter()
    port = SlcanPort(line.path, 1_000_000, RATE, settings=AWAKE)
    while port.send(FRAMES * 20, 0.02):
        pass
    line.received()
    assert port.send(FRAMES[:1], 0.1)
    assert line.received().endswith(b"\rt08080001020304050607\r"), "what was cut off is not ended"
    port.close()
    line.close()


@pytest.mark.parametrize(
    ("channel", "bitrate", "own", "what"),
    [("/dev/pts/0", 300_000, {}, "bitrate"), ("/dev/pts/0@fast", 500_000, {}, "settings.tty_baudrate")],
)
def test_what_no_adapter_understands_is_refused(channel: str, bitrate: int, own: dict[str, float], what: str) -> None:
    with pytest.raises(InputError, match=what):
        SlcanPort(channel, bitrate, RATE, settings=own)


@pytest.mark.parametrize(("more", "kind"), [({}, SlcanPort), ({"listen_only": False}, CanPort)])
def test_settings_that_are_not_heeded_here_are_left_to_python_can(more: dict[str, bool], kind: type) -> None:
    line = Adapter()
    options = CanOptions(interface="slcan", channel=line.path, settings={**AWAKE, **more})
    opened = CanDrive(DriveSetup(motor=Motor(**MOTOR), options=options, seed=1)).open_port()
    assert type(opened) is kind
    assert opened.layout(0) is CLASSIC_LAYOUT
    assert opened.bulk_rate(CLASSIC_LAYOUT) == pytest.approx(RATE)
    opened.close()
    line.close()


@given(st.binary(max_size=300).filter(lambda noise: b"\r" not in noise and b"\a" not in noise), frames)
@settings(max_examples=15)
def test_noise_that_ends_no_answer_is_not_kept_and_the_next_frame_comes(noise: bytes, frame: Frame) -> None:
    adapter = Adapter()
    port = SlcanPort(adapter.path, 1_000_000, RATE, settings=AWAKE)
    try:
        for _ in range(20):
            adapter.write(noise)
            port.receive(0.001)
        assert len(port._rest) <= 64
        adapter.write(b"\r" + port._encode([frame]))
        assert received(port, 1) == [frame]
    finally:
        port.close()
        adapter.close()
