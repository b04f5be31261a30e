"""A byte line: a device, a pseudo-terminal or a TCP socket, read and written without blocking."""

from __future__ import annotations

import select
import socket
import time
from pathlib import Path
from typing import Any, ClassVar

from plugins.link._transports import DescriptorTransport, PortTransport, SocketTransport, Transport
from protocols import InputError


class Line:
    """An open line.

    Reading and writing bypass pyserial: its `in_waiting` raises a plain OSError on a dead line and is at most
    1 on a socket, and its write blocks forever where no one reads.

    Parameters
    ----------
    port : str
        A device, a pseudo-terminal's path, or ``socket://host:port``.
    baud_rate : int
        Baud rate of a device; ignored by pseudo-terminals and sockets.
    dtr : bool
        Level of the DTR line, set before opening, since a change resets some boards.

    Raises pyserial's and the system's own errors, and `InputError` for an invalid port.
    """

    read_bytes: ClassVar[int] = 65536
    """Largest number of bytes in a read."""
    connect_s: ClassVar[float] = 2.0
    """Timeout for opening a socket."""

    def __init__(self, port: str, baud_rate: int, *, dtr: bool = True) -> None:
        is_line = not port.startswith("socket://")
        self._transport = _open_line(port, baud_rate, dtr) if is_line else _open_socket(port)
        self.is_device = is_line and not _is_pseudo_terminal(port)
        """Whether the line has a baud rate."""

    def fileno(self) -> int | None:
        """Descriptor that another process may write to; None where the system has none."""
        return self._transport.fileno()

    def write(self, data: bytes, timeout_s: float) -> bool:
        """Whether the line accepted all data in time."""
        deadline = time.monotonic() + timeout_s
        while data:
            try:
                data = data[self._transport.write(data) :]
            except BlockingIOError:
                remaining_s = deadline - time.monotonic()
                if remaining_s <= 0.0 or not self._transport.is_writable(remaining_s):
                    break
        return not data

    def read(self, timeout_s: float) -> bytes:
        """Received bytes, waiting for the first one only; empty after `timeout_s`.

        Raises `ConnectionResetError` where the other end has closed it.
        """
        if not self._transport.is_readable(timeout_s):
            return b""
        try:
            data = self._transport.read(Line.read_bytes)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionResetError("closed by the other end")
        return data

    def close(self) -> None:
        self._transport.close()


def _open_line(port: str, baud_rate: int, dtr: bool) -> Transport:
    import serial

    try:
        line: Any = serial.Serial(exclusive=True, baudrate=baud_rate, timeout=0, write_timeout=0)
        line.dtr = dtr
        line.port = port
        line.open()
    except ValueError as error:
        raise InputError("the drive's line", port, str(error)) from error
    return DescriptorTransport(line) if hasattr(select, "poll") else PortTransport(line)


def _open_socket(url: str) -> Transport:
    host, _, port = url.removeprefix("socket://").rpartition(":")
    if not port.isdecimal():
        raise InputError("the drive's line", url, "expected socket://host:port")
    connection = socket.create_connection((host, int(port)), timeout=Line.connect_s)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return SocketTransport(connection)


def _is_pseudo_terminal(port: str) -> bool:
    return Path(port).resolve().is_relative_to("/dev/pts")
