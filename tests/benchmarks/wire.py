"""How fast captures come over links, and how long a request takes: both ends as on a bench; prints, judges nothing."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import statistics
import time
import tty
from collections.abc import Iterator, Sequence
from importlib.util import find_spec

import numpy as np

from plugins.commands.emulator._can_ports import CanPort as EmulatedPort
from plugins.commands.emulator._line import NO_LOSSES, Lossy, Outbox
from plugins.drives.can._port import CanPort
from plugins.drives.serial._port import SerialPort
from plugins.link import Host, Link, Port
from plugins.link._reading import read_whole
from plugins.wire import (
    CAN_FD_LAYOUT,
    Answer,
    BlockLayout,
    CaptureSource,
    Frame,
    ParameterRead,
    ParameterValue,
    ReadBlock,
    SerialDecoder,
    all_to_serial,
    decode,
    encode,
    serial_blocks,
)

SERIAL_BYTES, FD_BYTES = 8_000_000, 2_000_000
BLOCK_BYTES = 1020
ROUND_TRIPS = 500
GROUP, UDP_PORT = "239.74.163.77", 43277
BUS_SETTINGS = {"port": UDP_PORT, "hop_limit": 0}
"""Without a hop limit of 0 every frame goes out of the machine's network card as well."""


def capture(size: int) -> bytes:
    """What is uploaded."""
    return np.random.default_rng(1).bytes(size)


def answers(source: CaptureSource, layout: BlockLayout, frames: Sequence[Frame]) -> Iterator[list[Frame]]:
    """The device: blocks and registers, nothing else."""
    for frame in frames:
        message = decode(*frame)
        if isinstance(message, ReadBlock):
            answer = source.answer(message, layout)
            if isinstance(answer, Answer):
                blocks = [Frame(layout.frame_id, payload) for payload in answer.payloads]
                for first in range(0, len(blocks), 64):
                    yield blocks[first : first + 64]
                yield [encode(answer.end)]
        elif isinstance(message, ParameterRead):
            yield [encode(ParameterValue(message.session, message.seq, message.parameter, 1.0))]


def serve_line(fd: int, size: int) -> None:
    """The device on a pseudo-terminal's master."""
    layout, decoder = serial_blocks(BLOCK_BYTES), SerialDecoder()
    source = CaptureSource.complete_with(1, capture(size))
    while True:
        try:
            frames = decoder.feed(os.read(fd, 65536))
        except OSError:
            return
        for batch in answers(source, layout, frames):
            data = all_to_serial(batch)
            while data:
                data = data[os.write(fd, data) :]


def serve_bus(size: int) -> None:
    """The device on CAN FD: the emulator's own port and queue. It is handed back all that it sends, too."""
    port = EmulatedPort(
        "udp_multicast", GROUP, fd=True, bitrate=1_000_000, data_bitrate=5_000_000, settings=BUS_SETTINGS
    )
    outbox = Outbox(port, Lossy(NO_LOSSES, "", port.damage), None)
    source = CaptureSource.complete_with(1, capture(size))
    while True:
        frames = port.receive(0.02 if outbox.empty else 0.0)
        for batch in answers(source, CAN_FD_LAYOUT, frames):
            outbox.put_bulk(batch)
        outbox.pump(time.monotonic())


def measured(label: str, port: Port, size: int) -> None:
    """Print the rate of one upload, and round trips."""
    link = Link(port, telemetry_s=10.0)
    host = Host(link, answer_s=2.0)
    host.read("protocol_major")
    begun = time.perf_counter()
    data = read_whole(host, 1, size, link.port.layout(BLOCK_BYTES))
    spent = time.perf_counter() - begun
    assert data == capture(size)
    trips = []
    for _ in range(ROUND_TRIPS):
        begun = time.perf_counter()
        host.read("protocol_major")
        trips.append(1e3 * (time.perf_counter() - begun))
    link.close()
    p99 = statistics.quantiles(trips, n=100)[98]
    median = statistics.median(trips)
    print(f"{label:34s} {size / spent / 1e6:6.2f} MB/s   round trip {median:.3f} ms, p99 {p99:.3f} ms")


@contextlib.contextmanager
def process(target: object, *arguments: object) -> Iterator[None]:
    """The device in a process of its own."""
    device = multiprocessing.get_context("fork").Process(target=target, args=arguments, daemon=True)  # type: ignore[arg-type]
    device.start()
    time.sleep(0.5)
    try:
        yield
    finally:
        device.kill()
        device.join()


def main() -> None:
    """Print one line a link."""
    master, slave = os.openpty()
    tty.setraw(slave)
    with process(serve_line, master, SERIAL_BYTES):
        measured("serial over a pseudo-terminal", SerialPort(os.ttyname(slave), 921_600), SERIAL_BYTES)
    for fd in (master, slave):
        os.close(fd)
    if find_spec("msgpack") is None:
        print("CAN FD on loopback: python-can's udp_multicast needs msgpack")
        return
    with process(serve_bus, FD_BYTES):
        port = CanPort("udp_multicast", GROUP, 1_000_000, fd=True, settings=BUS_SETTINGS)
        measured("CAN FD over multicast on loopback", port, FD_BYTES)


if __name__ == "__main__":
    main()
