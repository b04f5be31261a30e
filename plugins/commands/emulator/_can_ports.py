"""The device's side of a CAN bus: any interface of python-can, or a terminal for its interface `serial`."""

from __future__ import annotations

import random
import select
import struct
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from plugins.commands.emulator._bounds import BOUNDS
from plugins.commands.emulator._ports import PtyPort, Unit
from plugins.wire import CAN_FD_LAYOUT, CLASSIC_LAYOUT, BlockLayout, Frame, filters_of_drive, frame_id, from_bus, on_bus
from protocols import InputError

_CAN_HEAD, _CAN_START, _CAN_END = struct.Struct("<BIBI"), 0xAA, 0xBB
_FILTERS_IN_KERNEL = "socketcan"
"""Interface that filters in the kernel; python-can's others filter each frame after parsing it."""


class SerialCanPort(PtyPort):
    """A pseudo-terminal for python-can's interface ``serial``: classic frames without losses.

    Its format: 0xAA, time stamp (4 bytes), length (1), identifier (4), data, 0xBB; little-endian.

    Parameters
    ----------
    path : Path
        As for a serial line.
    node : int
        Node number of the identifiers to send and to receive.
    """

    def __init__(self, path: Path, node: int = 0) -> None:
        super().__init__(path)
        self._node, self._bytes = node, b""

    def layout(self, block_bytes: int) -> BlockLayout:
        return CLASSIC_LAYOUT

    def coded(self, frame: Frame) -> Unit:
        head = _CAN_HEAD.pack(_CAN_START, 0, len(frame.payload), on_bus(frame.frame_id, self._node))
        return head + frame.payload + bytes((_CAN_END,))

    def cost(self, unit: Unit) -> float:
        return (47 + 8 * (len(unit) - _CAN_HEAD.size - 1)) / 8

    def damage(self, unit: Unit, chance: random.Random) -> Unit | None:
        return None  # a bus controller drops damaged frames

    def damage_received(self, frame: Frame, chance: random.Random) -> Frame | None:
        return None

    def _decoded(self, data: bytes) -> list[Frame]:
        self._bytes += data
        frames: list[Frame] = []
        while len(self._bytes) >= _CAN_HEAD.size:
            start, _, length, identifier = _CAN_HEAD.unpack_from(self._bytes)
            end = _CAN_HEAD.size + length
            if start != _CAN_START or length > 8:
                self._bytes = self._bytes[1:]  # inside a frame: search the next start
            elif len(self._bytes) <= end:
                break
            else:
                own = from_bus(identifier, self._node)
                if self._bytes[end] == _CAN_END and own is not None:
                    frames.append(Frame(own, self._bytes[_CAN_HEAD.size : end]))
                self._bytes = self._bytes[end + 1 :]
        return frames


class CanPort:
    """A bus by any interface of python-can.

    Parameters
    ----------
    interface, channel : str
    node : int
        Node number of the identifiers to send and to receive.
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
        node: int = 0,
        fd: bool,
        bitrate: int,
        data_bitrate: int,
        settings: Mapping[str, Any],
    ) -> None:
        import can

        self._can, self._fd, self._node = can, fd, node
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
        if interface == _FILTERS_IN_KERNEL:
            self._bus.set_filters(filters_of_drive(node))
        self._readable = _readable(self._bus)
        self._errors = (can.CanError, OSError)
        self._bulk_ids = {frame_id(CLASSIC_LAYOUT.name), frame_id(CAN_FD_LAYOUT.name)}

    def publish(self) -> None:
        """Nothing to publish: a bus is visible to all."""

    @property
    def connected(self) -> bool | None:
        return None

    def layout(self, block_bytes: int) -> BlockLayout:
        return CAN_FD_LAYOUT if self._fd else CLASSIC_LAYOUT

    def coded(self, frame: Frame) -> Unit:
        return frame

    def cost(self, unit: Unit) -> float:
        """Cost of a frame by ISO 11898-1 without stuff bits; FD data count at their own bit rate."""
        assert isinstance(unit, Frame)
        size = len(unit.payload)
        if size <= 8:
            return (47 + 8 * size) / 8
        return (29 + (38 + 8 * size) * self._fast) / 8

    def damage(self, unit: Unit, chance: random.Random) -> Unit | None:
        """Drop a damaged frame, as controllers do by its CRC; some bulk frames pass with an error."""
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
        long, identifier = len(unit.payload) > 8, on_bus(unit.frame_id, self._node)
        message = self._can.Message(
            arbitration_id=identifier, data=unit.payload, is_extended_id=False, is_fd=long, bitrate_switch=long
        )
        try:
            self._bus.send(message, timeout=0.0)
        except self._errors:
            return False
        return True

    def receive(self, timeout_s: float) -> list[Frame]:
        frames: list[Frame] = []
        wait_s = timeout_s
        for _ in range(BOUNDS.max_received_frames):
            if self._readable is not None and not self._readable.poll(1e3 * wait_s):
                break
            message = self._received(0.0 if self._readable is not None else wait_s)
            if message is None:
                break
            identifier = from_bus(message.arbitration_id, self._node)
            damaged = message.is_error_frame or message.is_remote_frame or message.is_extended_id
            if identifier is not None and not damaged:
                frames.append(Frame(identifier, bytes(message.data)))
            wait_s = 0.0
        return frames

    def _received(self, wait_s: float) -> Any:
        try:
            return self._bus.recv(wait_s)
        except (*self._errors, ValueError, TypeError):  # a damaged frame, or a bus that is down
            time.sleep(BOUNDS.reconnect_period_s)
            return None

    def close(self) -> None:
        self._bus.shutdown()


def _readable(bus: Any) -> select.poll | None:
    """Poll object for received frames, where the bus has a file descriptor."""
    try:
        fd = bus.fileno()
    except NotImplementedError:
        return None
    if fd < 0 or not hasattr(select, "poll"):
        return None
    readable = select.poll()
    readable.register(fd, select.POLLIN)
    return readable
