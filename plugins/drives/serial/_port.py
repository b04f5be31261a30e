"""A serial line: a device, a pseudo-terminal, or a TCP socket. COBS frames over a file descriptor; no protocol."""

from __future__ import annotations

import os
import select
import socket
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol

from plugins.wire import BlockLayout, Frame, SerialDecoder, all_to_serial, serial_blocks
from protocols import InputError


class _Handle(Protocol):
    def fileno(self) -> int: ...
    def close(self) -> None: ...


class SerialPort:
    """An open serial line.

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
    frame_overhead_bytes: ClassVar[int] = 16
    """Identifier, offset, CRC-32, stuffing and the closing zero around a block's data."""
    for_blocks: ClassVar[float] = 0.9
    """Part of the line that is left to blocks by telemetry, requests, and what has to be asked for twice."""
    connect_s: ClassVar[float] = 2.0
    """A socket that has not opened after so long does not."""

    requests_each = 16
    blocks_each = 64

    def __init__(self, port: str, baud_rate: int, *, dtr: bool = True) -> None:
        self.where = port
        is_line = not port.startswith("socket://")
        self._handle: _Handle = _open_line(port, baud_rate, dtr) if is_line else _open_socket(port)
        self._line_rate = baud_rate / 10.0 if is_line and not _is_pseudo_terminal(port) else None
        self._fd = self._handle.fileno()
        os.set_blocking(self._fd, False)
        self._readable, self._writable = select.poll(), select.poll()
        self._readable.register(self._fd, select.POLLIN)
        self._writable.register(self._fd, select.POLLOUT)
        self._decoder = SerialDecoder()
        self._before = b"\0"  # ends whatever the other end has of an earlier frame

    @property
    def bad_frames(self) -> int:
        """Frames that came damaged, and were dropped."""
        return self._decoder.bad_frames

    def layout(self, block_bytes: int) -> BlockLayout:
        return serial_blocks(block_bytes)

    def bulk_rate(self, layout: BlockLayout) -> float | None:
        if self._line_rate is None:
            return None
        return SerialPort.for_blocks * self._line_rate * layout.block / (layout.block + SerialPort.frame_overhead_bytes)

    def send(self, frames: Sequence[Frame], timeout_s: float) -> bool:
        data = self._before + all_to_serial(frames)
        deadline = time.monotonic() + timeout_s
        while data:
            try:
                data = data[os.write(self._fd, data) :]
            except BlockingIOError:
                left = deadline - time.monotonic()
                if left <= 0.0 or not self._writable.poll(1e3 * left):
                    break
        self._before = b"\0" if data else b""  # what is cut off here is damaged there, and dropped
        return not data

    def fileno(self) -> int:
        return self._fd

    def as_written(self, frames: Sequence[Frame]) -> bytes:
        return b"\0" + all_to_serial(frames)  # what the other process has begun ends here

    def receive(self, timeout_s: float) -> list[Frame]:
        if not self._readable.poll(1e3 * timeout_s):
            return []
        try:
            data = os.read(self._fd, SerialPort.read_bytes)
        except BlockingIOError:
            return []
        if not data:
            raise ConnectionResetError("closed by the other end")
        return self._decoder.feed(data)

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
    opened = socket.create_connection((host, int(port)), timeout=SerialPort.connect_s)
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return opened


def _is_pseudo_terminal(port: str) -> bool:
    return Path(port).resolve().is_relative_to("/dev/pts")
