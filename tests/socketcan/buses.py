"""The machine's buses, and what can be done to them. Nothing here speaks a protocol."""

from __future__ import annotations

import fcntl
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

CLASSIC_BUS, FD_BUS = "fluxcan0", "fluxcanfd0"
BUSES = (CLASSIC_BUS, FD_BUS)

# linux/can/error.h
ERROR_FLAG = 0x20000000
BUS_OFF = 0x40
ERRORS = (0x02, 0x04, 0x08, 0x20, BUS_OFF, 0x80, 0x100)
"""Lost arbitration, controller, protocol, no acknowledgement, bus off, bus error, restarted."""

# linux/sockios.h, linux/if.h
_GET_FLAGS, _SET_FLAGS, _UP = 0x8913, 0x8914, 0x1
_REQUEST = struct.Struct("16sH22x")
_FRAME = struct.Struct("<IB3x8s")


def are_there() -> bool:
    """Whether this machine has the buses."""
    return all(Path("/sys/class/net", bus).exists() for bus in BUSES)


def is_fd(bus: str) -> bool:
    return bus == FD_BUS


def report_error(bus: str, kind: int) -> None:
    """An error frame as a controller's driver makes it, for everybody on the bus."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        raw.bind((bus,))
        raw.send(_FRAME.pack(ERROR_FLAG | kind, 8, bytes(8)))


def set_up(bus: str, up: bool) -> None:
    """Take the interface down, or up again."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        requested = _REQUEST.pack(bus.encode(), 0)
        flags = _REQUEST.unpack(fcntl.ioctl(control, _GET_FLAGS, requested))[1]
        flags = flags | _UP if up else flags & ~_UP
        fcntl.ioctl(control, _SET_FLAGS, _REQUEST.pack(bus.encode(), flags))


@contextmanager
def down(bus: str) -> Iterator[None]:
    """The interface is down for a while."""
    set_up(bus, False)
    try:
        yield
    finally:
        set_up(bus, True)
