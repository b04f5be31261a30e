"""The device's side of a link, and a pseudo-terminal as such a link; sending never blocks."""

from __future__ import annotations

import os
import random
import select
import time
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from plugins.commands.emulator._bounds import BOUNDS
from plugins.wire import BlockLayout, Frame, SerialDecoder, serial_blocks, to_serial
from protocols import InputError

Unit = Frame | bytes
"""Unit of sending: a frame, or the bytes of one."""


class Port(Protocol):
    """An open link."""

    @property
    def connected(self) -> bool | None:
        """Whether a host has opened the other end; None if unknown."""
        ...

    def publish(self) -> None:
        """Make the link visible to hosts; raises `InputError` where its name is taken."""
        ...

    def layout(self, block_bytes: int) -> BlockLayout: ...

    def coded(self, frame: Frame) -> Unit: ...

    def cost(self, unit: Unit) -> float:
        """Transmission time of a unit, in bytes of the line."""
        ...

    def damage(self, unit: Unit, chance: random.Random) -> Unit | None:
        """The unit after a disturbance; None where a receiver drops it."""
        ...

    def damage_received(self, frame: Frame, chance: random.Random) -> Frame | None: ...

    def send(self, unit: Unit) -> bool:
        """Whether the unit was accepted."""
        ...

    def receive(self, timeout_s: float) -> list[Frame]:
        """Received frames, waiting for the first one only."""
        ...

    def close(self) -> None: ...


class PtyPort:
    """A pseudo-terminal with a symbolic link to the host's side.

    Parameters
    ----------
    path : Path
        The symbolic link; one that a killed emulator left behind is replaced.
    """

    def __init__(self, path: Path) -> None:
        try:
            import tty
        except ImportError:
            raise InputError(str(path), "", "this system has no pseudo-terminals; --can joins a bus") from None
        self._path = path
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self._slave_name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._poll = select.poll()
        self._poll.register(self._master, select.POLLIN)
        self._decoder, self._rest = SerialDecoder(), b""
        self._connected = False

    def publish(self) -> None:
        try:
            _point(self._path, self._slave_name)
        except OSError as error:
            raise InputError(str(self._path), "", f"cannot be linked: {error.strerror}") from None

    @property
    def connected(self) -> bool | None:
        return self._connected

    def layout(self, block_bytes: int) -> BlockLayout:
        return serial_blocks(block_bytes)

    def coded(self, frame: Frame) -> Unit:
        return to_serial(frame)

    def cost(self, unit: Unit) -> float:
        return len(unit)

    def damage(self, unit: Unit, chance: random.Random) -> Unit | None:
        assert isinstance(unit, bytes)
        damaged = bytearray(unit)
        damaged[chance.randrange(len(damaged))] ^= 1 << chance.randrange(8)
        return bytes(damaged)

    def damage_received(self, frame: Frame, chance: random.Random) -> Frame | None:
        damaged = self.damage(to_serial(frame), chance)
        assert isinstance(damaged, bytes)
        return next(iter(SerialDecoder().feed(damaged + b"\0")), None)

    def send(self, unit: Unit) -> bool:
        if not self._connected:
            return False
        assert isinstance(unit, bytes)
        try:
            if self._rest:
                self._rest = self._rest[os.write(self._master, self._rest) :]
            if self._rest:
                return False
            self._rest = unit[os.write(self._master, unit) :]
        except BlockingIOError:
            return False
        except OSError:  # the host is closing
            return False
        return True

    def receive(self, timeout_s: float) -> list[Frame]:
        events = self._poll.poll(1e3 * timeout_s)
        if not events:
            self._connected = True  # a terminal without a host reports a hang-up at once
            return []
        if not events[0][1] & select.POLLIN:
            self._lost()
            time.sleep(min(timeout_s, BOUNDS.reconnect_period_s))
            return []
        self._connected = not events[0][1] & select.POLLHUP
        try:
            return self._decoded(os.read(self._master, BOUNDS.max_read_bytes))
        except OSError:
            self._lost()
            return []

    def _decoded(self, data: bytes) -> list[Frame]:
        return self._decoder.feed(data)

    def _lost(self) -> None:
        import termios

        if self._connected:
            # As on a real line, the next host must not receive unread data of the previous one.
            with suppress(OSError, termios.error):
                termios.tcflush(self._master, termios.TCOFLUSH)
                slave = os.open(self._slave_name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                termios.tcflush(slave, termios.TCIFLUSH)
                os.close(slave)
        self._connected, self._rest = False, b""

    def close(self) -> None:
        with suppress(OSError):
            if str(self._path.readlink()) == self._slave_name:
                self._path.unlink()
        os.close(self._master)


def _point(path: Path, target: str) -> None:
    if path.is_symlink():
        if not path.readlink().is_relative_to("/dev/pts"):
            raise InputError(str(path), "", "is a link to something other than a terminal; left unchanged")
    elif path.exists():
        raise InputError(str(path), "", "exists already; left unchanged")
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(target)
    temporary.replace(path)
