"""A line to a VESC, serial or TCP: sends frames, sorts what comes by its command. Knows no command's meaning."""

from __future__ import annotations

import os
import queue
import select
import socket
import threading
import time
from collections import defaultdict
from typing import Protocol

from plugins.drives.vesc._packets import Decoder, framed
from protocols import DriveFault, FaultCause, InputError

READ_OCTETS, POLL_S, CONNECT_S, WRITE_S = 65536, 0.05, 2.0, 1.0


class _Handle(Protocol):
    def fileno(self) -> int: ...
    def close(self) -> None: ...


class Link:
    """An open line; its reader is a thread that `close` ends. Errors become `DriveFault` (link_lost), and stay.

    Parameters
    ----------
    port : str
        A serial device or ``socket://host:port``.
    baud_rate : int
        Of a UART.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        self.where, self.lost = f"VESC at {port}", None
        try:
            self._handle = _open_socket(port) if port.startswith("socket://") else _open_line(port, baud_rate)
        except OSError as error:
            raise DriveFault(FaultCause.LINK_LOST, f"{self.where}: {error.strerror or error}") from None
        self._fd = self._handle.fileno()
        os.set_blocking(self._fd, False)
        self._come: defaultdict[int, queue.SimpleQueue[bytes]] = defaultdict(queue.SimpleQueue)
        self._writing, self._closed = threading.Lock(), threading.Event()
        self._reader = threading.Thread(target=self._read, name="vesc", daemon=True)
        self._reader.start()

    lost: DriveFault | None

    def send(self, payload: bytes) -> None:
        """Write a frame; raises `DriveFault` where it does not go out."""
        self.check()
        data, deadline = framed(payload), time.monotonic() + WRITE_S
        with self._writing:
            while data:
                try:
                    data = data[os.write(self._fd, data) :]
                except BlockingIOError:
                    if time.monotonic() > deadline:
                        raise self._lose(f"takes nothing for {WRITE_S:g} s") from None
                    select.select([], [self._fd], [], POLL_S)
                except OSError as error:
                    raise self._lose(error.strerror or str(error)) from None

    def take(self, command: int, timeout_s: float) -> bytes | None:
        """The next payload of a command; None where none comes in time."""
        self.check()
        try:
            return self._come[command].get(timeout=timeout_s) if timeout_s > 0 else self._come[command].get_nowait()
        except queue.Empty:
            return None

    def ask(self, payload: bytes, answer: int, timeout_s: float) -> bytes:
        """Send, and take the next answer of this command; raises `DriveFault` where there is none."""
        self.forget(answer)
        self.send(payload)
        answered = self.take(answer, timeout_s)
        if answered is None:
            raise self._lose(f"does not answer within {timeout_s:g} s")
        return answered

    def forget(self, command: int) -> None:
        """Drop what has come of this command."""
        self._come[command] = queue.SimpleQueue()

    def check(self) -> None:
        """Raises `DriveFault` where the line is lost."""
        if self.lost is not None:
            raise self.lost

    def close(self) -> None:
        """End the reader and let go of the line."""
        self._closed.set()
        self._reader.join()
        self._handle.close()

    def _lose(self, why: str) -> DriveFault:
        self.lost = self.lost or DriveFault(FaultCause.LINK_LOST, f"{self.where}: {why}")
        return self.lost

    def _read(self) -> None:
        decoder = Decoder()
        while not self._closed.is_set() and self.lost is None:
            try:
                if not select.select([self._fd], [], [], POLL_S)[0]:
                    continue
                octets = os.read(self._fd, READ_OCTETS)
            except BlockingIOError:
                continue
            except OSError as error:
                self._lose(error.strerror or str(error))
                return
            if not octets:
                self._lose("closed by the other end")
                return
            for payload in decoder.feed(octets):
                self._come[payload[0]].put(payload)


def _open_line(port: str, baud_rate: int) -> _Handle:
    import serial

    line: _Handle = serial.Serial(port, baudrate=baud_rate, timeout=0, write_timeout=0, exclusive=True)
    return line


def _open_socket(url: str) -> _Handle:
    host, _, port = url.removeprefix("socket://").rpartition(":")
    if not port.isdecimal():
        raise InputError("the drive's line", url, "expected socket://host:port")
    opened = socket.create_connection((host, int(port)), timeout=CONNECT_S)
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return opened
