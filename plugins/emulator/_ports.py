"""The device's side of a link: a pseudo-terminal, or a CAN bus by python-can. Neither ever waits to send."""

from __future__ import annotations

import os
import random
import select
import struct
import termios
import time
import tty
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from plugins.drives.wire import (
    CAN_FD,
    CLASSIC,
    BlockLayout,
    Frame,
    SerialDecoder,
    frame_id,
    serial_blocks,
    to_serial,
)
from protocols import InputError

Unit = Frame | bytes
"""What a port sends at a time: a frame, or the bytes of one."""
_READ_BYTES = 65536
_FRAMES_EACH = 64
_NOBODY_S = 0.002
_CAN_HEAD, _CAN_START, _CAN_END = struct.Struct("<BIBI"), 0xAA, 0xBB


class Port(Protocol):
    """A link that is open."""

    @property
    def heard_of(self) -> bool | None:
        """Whether a host has the other end open; None where that cannot be known."""
        ...

    def publish(self) -> None:
        """Let hosts find it; raises `InputError` where the place is taken."""
        ...

    def layout(self, block_bytes: int) -> BlockLayout: ...

    def coded(self, frame: Frame) -> Unit: ...

    def cost(self, unit: Unit) -> float:
        """Bytes that the line is busy for."""
        ...

    def damage(self, unit: Unit, chance: random.Random) -> Unit | None:
        """The unit after a disturbance; None where a receiver does not get to see it."""
        ...

    def damage_received(self, frame: Frame, chance: random.Random) -> Frame | None: ...

    def send(self, unit: Unit) -> bool:
        """Whether it was taken."""
        ...

    def receive(self, timeout_s: float) -> list[Frame]:
        """What has come, waiting for the first one only."""
        ...

    def close(self) -> None: ...


class PtyPort:
    """A pseudo-terminal with a symbolic link to the host's side.

    Parameters
    ----------
    path : Path
        The link; one that a killed emulator left behind is replaced.
    """

    def __init__(self, path: Path) -> None:
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
            raise InputError(str(self._path), "", f"cannot be made a link: {error.strerror}") from None

    @property
    def heard_of(self) -> bool | None:
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
        except OSError:  # the host is just letting go
            return False
        return True

    def receive(self, timeout_s: float) -> list[Frame]:
        events = self._poll.poll(1e3 * timeout_s)
        if not events:
            self._connected = True  # a terminal that nobody has open says so at once
            return []
        if not events[0][1] & select.POLLIN:
            self._lost()
            time.sleep(min(timeout_s, _NOBODY_S))
            return []
        self._connected = not events[0][1] & select.POLLHUP
        try:
            return self._decoded(os.read(self._master, _READ_BYTES))
        except OSError:
            self._lost()
            return []

    def _decoded(self, data: bytes) -> list[Frame]:
        return self._decoder.feed(data)

    def _lost(self) -> None:
        if self._connected:
            self._forget_unread()
        self._connected, self._rest = False, b""

    def _forget_unread(self) -> None:
        """What the host that has gone did not read would be the first that the next one gets: no line keeps it."""
        with suppress(OSError, termios.error):
            termios.tcflush(self._master, termios.TCOFLUSH)
            slave = os.open(self._slave_name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            termios.tcflush(slave, termios.TCIFLUSH)
            os.close(slave)

    def close(self) -> None:
        with suppress(OSError):
            if str(self._path.readlink()) == self._slave_name:
                self._path.unlink()
        os.close(self._master)


def _point(path: Path, target: str) -> None:
    if path.is_symlink():
        if not path.readlink().is_relative_to("/dev/pts"):
            raise InputError(str(path), "", "is a link to something that is no terminal; left alone")
    elif path.exists():
        raise InputError(str(path), "", "is there already; left alone")
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(target)
    temporary.replace(path)


class SerialCanPort(PtyPort):
    """A pseudo-terminal at whose other end python-can's interface ``serial`` is opened: classic frames without losses.

    Its format: 0xAA, time stamp (4 bytes), length (1), identifier (4), data, 0xBB; little-endian.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._bytes = b""

    def layout(self, block_bytes: int) -> BlockLayout:
        return CLASSIC

    def coded(self, frame: Frame) -> Unit:
        head = _CAN_HEAD.pack(_CAN_START, 0, len(frame.payload), frame.frame_id)
        return head + frame.payload + bytes((_CAN_END,))

    def cost(self, unit: Unit) -> float:
        return (47 + 8 * (len(unit) - _CAN_HEAD.size - 1)) / 8

    def damage(self, unit: Unit, chance: random.Random) -> Unit | None:
        return None  # a bus controller drops it

    def damage_received(self, frame: Frame, chance: random.Random) -> Frame | None:
        return None

    def _decoded(self, data: bytes) -> list[Frame]:
        self._bytes += data
        frames: list[Frame] = []
        while len(self._bytes) >= _CAN_HEAD.size:
            start, _, length, identifier = _CAN_HEAD.unpack_from(self._bytes)
            end = _CAN_HEAD.size + length
            if start != _CAN_START or length > 8:
                self._bytes = self._bytes[1:]  # somewhere in a frame: look for the next
            elif len(self._bytes) <= end:
                break
            else:
                if self._bytes[end] == _CAN_END:
                    frames.append(Frame(identifier, self._bytes[_CAN_HEAD.size : end]))
                self._bytes = self._bytes[end + 1 :]
        return frames


class CanPort:
    """A bus by any interface of python-can.

    Parameters
    ----------
    interface, channel : str
    fd : bool
        CAN FD: blocks of captures are frames of 64 bytes.
    bitrate, data_bitrate : int
    settings : mapping
        Further arguments of the interface.

    Raises `InputError` where it cannot be opened.
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        *,
        fd: bool,
        bitrate: int,
        data_bitrate: int,
        settings: Mapping[str, Any],
    ) -> None:
        import can

        self._can, self._fd = can, fd
        self._fast = bitrate / data_bitrate
        arguments: dict[str, Any] = {"bitrate": bitrate}
        if fd:
            arguments |= {"fd": True, "data_bitrate": data_bitrate}
        if interface == "serial":
            arguments["timeout"] = 0.001
        try:
            self._bus: Any = can.Bus(
                channel=channel, interface=interface, ignore_config=True, **{**arguments, **settings}
            )
        except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
            raise InputError("--can", f"{interface}:{channel}", f"cannot be opened: {error}") from None
        self._writable, self._readable = _polls(self._bus)
        self._errors = (can.CanError, OSError)
        self._bulk_ids = {frame_id(CLASSIC.name), frame_id(CAN_FD.name)}

    def publish(self) -> None:
        """A bus is there for all."""

    @property
    def heard_of(self) -> bool | None:
        return None

    def layout(self, block_bytes: int) -> BlockLayout:
        return CAN_FD if self._fd else CLASSIC

    def coded(self, frame: Frame) -> Unit:
        return frame

    def cost(self, unit: Unit) -> float:
        """ISO 11898-1 without stuff bits; the data of an FD frame counts at its own bit rate."""
        assert isinstance(unit, Frame)
        size = len(unit.payload)
        if size <= 8:
            return (47 + 8 * size) / 8
        return (29 + (38 + 8 * size) * self._fast) / 8

    def damage(self, unit: Unit, chance: random.Random) -> Unit | None:
        """Controllers drop what does not fit the frame's own CRC; of bulk data some is let through."""
        assert isinstance(unit, Frame)
        if unit.frame_id not in self._bulk_ids:
            return None
        payload = bytearray(unit.payload)
        payload[chance.randrange(len(payload))] ^= 1 << chance.randrange(8)
        return Frame(unit.frame_id, bytes(payload))

    def damage_received(self, frame: Frame, chance: random.Random) -> Frame | None:
        return None

    def send(self, unit: Unit) -> bool:
        assert isinstance(unit, Frame)
        if self._writable is not None and not self._writable.poll(0):
            return False
        long = len(unit.payload) > 8
        message = self._can.Message(
            arbitration_id=unit.frame_id, data=unit.payload, is_extended_id=False, is_fd=long, bitrate_switch=long
        )
        try:
            self._bus.send(message, timeout=0.0)
        except self._errors:
            return False
        return True

    def receive(self, timeout_s: float) -> list[Frame]:
        frames: list[Frame] = []
        wait_s = timeout_s
        while len(frames) < _FRAMES_EACH:
            if self._readable is not None and not self._readable.poll(1e3 * wait_s):
                break
            message = self._received(0.0 if self._readable is not None else wait_s)
            if message is None:
                break
            if not (message.is_error_frame or message.is_remote_frame or message.is_extended_id):
                frames.append(Frame(message.arbitration_id, bytes(message.data)))
            wait_s = 0.0
        return frames

    def _received(self, wait_s: float) -> Any:
        try:
            return self._bus.recv(wait_s)
        except (*self._errors, ValueError, TypeError):  # a damaged frame, or a bus that is down
            time.sleep(_NOBODY_S)
            return None

    def close(self) -> None:
        self._bus.shutdown()


def _polls(bus: Any) -> tuple[select.poll | None, select.poll | None]:
    """What tells whether a frame can be sent, and whether one is there, where the bus is a file."""
    try:
        fd = bus.fileno()
    except NotImplementedError:
        return None, None
    if fd < 0:
        return None, None
    writable, readable = select.poll(), select.poll()
    writable.register(fd, select.POLLOUT)
    readable.register(fd, select.POLLIN)
    return writable, readable
