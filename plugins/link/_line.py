"""A line of bytes: a device, a pseudo-terminal, or a TCP socket, read and written by its descriptor. No frames."""

from __future__ import annotations

import os
import select
import socket
import time
from pathlib import Path
from typing import Any, ClassVar, Protocol

from protocols import InputError


class _Handle(Protocol):
    def fileno(self) -> int: ...
    def close(self) -> None: ...


class Line:
    """An open line.

    Reading and writing go past pyserial: its `in_waiting` is a bare OSError on a dead line and no
    more than 1 on a socket, and its write blocks for good where nobody reads.

    Parameters
    ----------
    port : str
        A device, a pseudo-terminal's path, or ``socket://host:port``.
    baud_rate : int
        For devices; pseudo-terminals and sockets do not care.
    dtr : bool
        Level of the DTR line, set before opening: some boards are reset by a change.

    Raises pyserial's and the system's own errors, and `InputError` for what no port could be.
    """

    read_bytes: ClassVar[int] = 65536
    """Bytes read at once."""
    connect_s: ClassVar[float] = 2.0
    """A socket that has not opened after so long does not."""

    def __init__(self, port: str, baud_rate: int, *, dtr: bool = True) -> None:
        is_line = not port.startswith("socket://")
        self._handle: _Handle = _open_line(port, baud_rate, dtr) if is_line else _open_socket(port)
        self.is_device = is_line and not _is_pseudo_terminal(port)
        """Whether it has a baud rate."""
        self._fd = self._handle.fileno()
        os.set_blocking(self._fd, False)
        self._readable, self._writable = select.poll(), select.poll()
        self._readable.register(self._fd, select.POLLIN)
        self._writable.register(self._fd, select.POLLOUT)

    def fileno(self) -> int:
        return self._fd

    def write(self, data: bytes, timeout_s: float) -> bool:
        """Whether the line took all of it in time."""
        deadline = time.monotonic() + timeout_s
        while data:
            try:
                data = data[os.write(self._fd, data) :]
            except BlockingIOError:
                left = deadline - time.monotonic()
                if left <= 0.0 or not self._writable.poll(1e3 * left):
                    break
        return not data

    def read(self, timeout_s: float) -> bytes:
        """What is there, waiting for the first byte only; nothing when the time is over.

        Raises `ConnectionResetError` where the other end has closed it.
        """
        if not self._readable.poll(1e3 * timeout_s):
            return b""
        try:
            data = os.read(self._fd, Line.read_bytes)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionResetError("closed by the other end")
        return data

    def close(self) -> None:
        self._handle.close()


def _open_line(port: str, baud_rate: int, dtr: bool) -> _Handle:
    import serial

    try:
        line: Any = serial.Serial(exclusive=True, baudrate=baud_rate, timeout=0, write_timeout=0)
        line.dtr = dtr
        line.port = port
        line.open()
    except ValueError as error:
        raise InputError("the drive's line", port, str(error)) from error
    handle: _Handle = line
    return handle


def _open_socket(url: str) -> _Handle:
    host, _, port = url.removeprefix("socket://").rpartition(":")
    if not port.isdecimal():
        raise InputError("the drive's line", url, "expected socket://host:port")
    opened = socket.create_connection((host, int(port)), timeout=Line.connect_s)
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return opened


def _is_pseudo_terminal(port: str) -> bool:
    return Path(port).resolve().is_relative_to("/dev/pts")
