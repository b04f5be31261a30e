"""Both ends of a bus: the host's, and the drive's as a process of its own."""

from __future__ import annotations

import multiprocessing
import random
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from plugins.commands.emulator._can_ports import CanPort as DevicePort
from plugins.drives.can._port import CanPort
from plugins.wire import CaptureSource, Frame, ReadBlock, decode
from tests.plugins.link.device import Device, Script
from tests.plugins.wire.lossy import Device as CaptureDevice
from tests.plugins.wire.lossy import Lossy
from tests.socketcan.buses import is_fd

NUMBER = 5
"""Capture number of what is handed out."""
BIT_RATE, DATA_BIT_RATE = 1_000_000, 5_000_000
WATCHDOG_S = 2.0
"""Longer than that of drives: both ends run in a machine that is ten times slower."""
_SO_MEMINFO, _MEMINFO = 55, struct.Struct("=9I")
"""asm-generic/socket.h and linux/sock_diag.h; what the kernel dropped is the last of the nine."""

Over = Callable[[], bool]
Work = Callable[[DevicePort, Over], Any]
"""What the drive's process does until it is over; it returns the process's last word."""


class HostPort(CanPort):
    """The host's end.

    Parameters
    ----------
    bus : str
    sleep_s : float
    every : int
        The receiver sleeps so long in every n-th turn, as a process does that the machine keeps waiting.
    buffer_bytes : int, optional
        Of the socket; by default as large as the port makes it.
    """

    def __init__(self, bus: str, *, sleep_s: float = 0.0, every: int = 1, buffer_bytes: int | None = None) -> None:
        super().__init__("socketcan", bus, BIT_RATE, fd=is_fd(bus), data_bitrate=DATA_BIT_RATE)
        self._sleep_s, self._every, self._turn = sleep_s, every, 0
        if buffer_bytes is not None:
            with self._twin() as twin:
                twin.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
        self.overflowed = 0
        """Frames that the kernel dropped, for the receive buffer was full."""

    def receive(self, timeout_s: float) -> list[Frame]:
        self._turn += 1
        if self._sleep_s and self._turn % self._every == 0:
            time.sleep(self._sleep_s)
            with self._twin() as twin:
                self.overflowed = _MEMINFO.unpack(twin.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[-1]
        return super().receive(timeout_s)

    @contextmanager
    def _twin(self) -> Iterator[socket.socket]:
        twin = socket.socket(fileno=self._bus.fileno())
        try:
            yield twin
        finally:
            twin.detach()


@dataclass
class Peer:
    """The drive's process; its last word is there when it has ended."""

    reported: Any = None


@contextmanager
def peer(work: Work, bus: str) -> Iterator[Peer]:
    """A process at the other end of the bus. A fork, for imports take long in a slow machine."""
    mine, its = multiprocessing.Pipe()

    def live() -> None:
        port = DevicePort("socketcan", bus, fd=is_fd(bus), bitrate=BIT_RATE, data_bitrate=DATA_BIT_RATE, settings={})
        its.send("ready")
        reported = work(port, its.poll)
        port.close()
        its.send(reported)

    process = multiprocessing.get_context("fork").Process(target=live, daemon=True)
    process.start()
    made = Peer()
    try:
        assert mine.recv() == "ready"
        yield made
    finally:
        with suppress(OSError):
            mine.send("over")
            made.reported = mine.recv() if mine.poll(30.0) else None
        process.join(10.0)
        process.kill()
        mine.close()
        its.close()


@dataclass(frozen=True)
class Mix:
    """What the bus does to frames, in parts of one, each way."""

    drop: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    damage: float = 0.0
    """Seen by the controllers, which drop the frame."""
    unseen: float = 0.0
    """Damage that nobody sees."""

    def link(self, seed: int) -> Lossy:
        lost = 1.0 - (1.0 - self.drop) * (1.0 - self.damage)
        return Lossy(random.Random(f"{seed} {self}"), lost, self.duplicate, self.reorder, self.unseen)


def handing_out(data: bytes, mix: Mix) -> Work:
    """A drive that has one capture, and does nothing but hand it out."""

    def work(port: DevicePort, over: Over) -> None:
        source = CaptureSource.complete_with(NUMBER, data)
        device = CaptureDevice(source, port.layout(0), mix.link(1), mix.link(2))
        while not over():
            for frame in port.receive(0.005):
                message = decode(*frame)
                if isinstance(message, ReadBlock):
                    device.send(message)
            for frame in device.receive():
                while not port.send(frame) and not over():
                    time.sleep(1e-3)

    return work


@dataclass(frozen=True)
class Story:
    """What a drive that ran programs can tell at the end."""

    arms: int
    cause: str
    energised: bool


def running_programs(port: DevicePort, over: Over) -> Story:
    """The small drive of the host's own tests, ten times faster than real time."""
    device = Device(port.layout(0), Script())
    device.watchdog.limit_s = WATCHDOG_S
    while not over():
        for frame in [*device.turn(), *device.receive(port.receive(0.002))]:
            port.send(frame)
    return Story(len(device.arms), device.fault.name.lower(), device.i_dq != (0.0, 0.0))
