"""A CAN bus by any interface of python-can, classic or FD: sends and receives frames."""

from __future__ import annotations

import errno
import math
import select
import socket
import struct
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, ClassVar

from plugins.wire import CAN_FD_LAYOUT, CLASSIC_LAYOUT, BlockLayout, Frame, filters_of_host, from_bus, on_bus
from protocols import InputError

if TYPE_CHECKING:
    import can

_DAMAGED = (ValueError, TypeError, struct.error)
"""Errors that python-can's parsers raise on a truncated frame."""
_CLASSIC_BLOCK_BITS = 135.0
"""Bits on the bus for one block with the most bit stuffing (docs/wire.md, Bandwidth)."""
_FD_SLOW_BITS = 36.0
_FD_FAST_BITS = 680.0
_FILTERS_IN_KERNEL = "socketcan"
"""Interface that filters in the kernel; python-can's others filter each frame after parsing it."""
_WITHOUT_BIT_RATE = ("virtual", "udp_multicast")
"""Interfaces without a bit rate."""


class CanPort:
    """An open bus.

    Parameters
    ----------
    interface, channel : str
        Interface and channel in python-can's notation.
    bitrate : int
    node : int
        Node number of the drive; frames of others are ignored.
    fd : bool
        CAN FD: blocks of captures are FD frames of 64 bytes, all other frames are classic.
    data_bitrate : int
        Bit rate of an FD frame's data.
    settings : mapping
        Further arguments of the interface.

    Raises python-can's own errors, and `InputError` for settings that the interface refuses.
    """

    max_batch_frames: ClassVar[int] = 512
    """Largest number of frames received at a time."""
    max_batch_s: ClassVar[float] = 5e-3
    """Longest CPU time for receiving a batch; single frames would be too slow for CAN FD."""
    max_errors_in_a_row: ClassVar[int] = 3
    """Successive errors, damaged frames included, after which the bus is given up."""
    receive_buffer_bytes: ClassVar[int] = 4 << 20
    """Receive buffer requested from the kernel, which may grant less."""
    socket_frame_bytes: ClassVar[int] = 1280
    """Largest size of a frame in a socket's buffer, with the kernel's bookkeeping."""
    min_request_blocks: ClassVar[int] = 16
    """Smallest number of blocks in a request, with any buffer."""
    block_load_ratio: ClassVar[float] = 0.8
    """Share of the bus for blocks, beside telemetry, requests and repetitions."""
    rest_of_frame_s: ClassVar[float] = 0.5
    """Wait for the rest of a frame: python-can's serial format has no checksum, so the rest could pass as a frame."""

    def __init__(
        self,
        interface: str,
        channel: str,
        bitrate: int,
        *,
        node: int = 0,
        fd: bool = False,
        data_bitrate: int = 5_000_000,
        settings: Mapping[str, str | int | float | bool] | None = None,
    ) -> None:
        import can

        self.where = f"{interface}:{channel}" + (f" node {node}" if node else "")
        self._can: Any = can
        self._node = node
        self._fd, self._rates = fd, None if interface in _WITHOUT_BIT_RATE else (bitrate, data_bitrate)
        arguments: dict[str, Any] = {"bitrate": bitrate}
        if fd:
            arguments |= {"fd": True, "data_bitrate": data_bitrate}
        if interface == "serial":
            arguments["timeout"] = CanPort.rest_of_frame_s
        arguments |= settings or {}
        try:
            self._bus: can.BusABC = can.Bus(channel=channel, interface=interface, ignore_config=True, **arguments)
        except can.CanError:
            raise
        except (NotImplementedError, TypeError, ValueError) as error:
            raise InputError("the drive's bus", self.where, str(error).splitlines()[0]) from error
        if interface == _FILTERS_IN_KERNEL:
            self._bus.set_filters(filters_of_host(node))
        unread = _widen_buffer(self._bus)
        self.requests_each, self.blocks_each = (8, 512) if fd else (4, 256)
        if unread is not None:
            self.blocks_each = min(self.blocks_each, max(unread // self.requests_each, CanPort.min_request_blocks))
        self._readable = _poll_of(self._bus) if interface == "serial" else None
        self._errors = 0

    def layout(self, block_bytes: int) -> BlockLayout:
        return CAN_FD_LAYOUT if self._fd else CLASSIC_LAYOUT

    def bulk_rate(self, layout: BlockLayout) -> float | None:
        if self._rates is None:
            return None
        slow, fast = self._rates
        if not self._fd:
            return classic_rate(slow)
        return CanPort.block_load_ratio * layout.block / (_FD_SLOW_BITS / slow + _FD_FAST_BITS / fast)

    def send(self, frames: Sequence[Frame], timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        for frame in frames:
            identifier = on_bus(frame.frame_id, self._node)
            message = self._can.Message(arbitration_id=identifier, data=frame.payload, is_extended_id=False)
            while not self._sent(message, deadline):
                if time.monotonic() >= deadline:
                    return False
                time.sleep(1e-3)
        return True

    def _sent(self, message: can.Message, deadline: float) -> bool:
        """Whether the bus accepted the message by the deadline; a full queue is retried."""
        try:
            self._bus.send(message, timeout=max(1e-3, deadline - time.monotonic()))
        except self._can.CanTimeoutError:
            return False
        except self._can.CanOperationError as error:
            down = isinstance(error.__cause__, OSError) and error.__cause__.errno != errno.ENOBUFS
            if down or time.monotonic() >= deadline:
                raise
            return False
        return True

    def receive(self, timeout_s: float) -> list[Frame]:
        frames: list[Frame] = []
        wait_s, until_s = timeout_s, math.inf
        while len(frames) < CanPort.max_batch_frames and time.thread_time() < until_s:
            if self._readable is not None and not self._readable.poll(1e3 * wait_s):
                break
            message = self._received(wait_s)
            if message is None:
                if self._readable is None:
                    break
            elif not (message.is_extended_id or message.is_remote_frame or message.is_error_frame):
                identifier = from_bus(message.arbitration_id, self._node)
                if identifier is not None:
                    frames.append(Frame(identifier, bytes(message.data)))
            if wait_s:
                wait_s, until_s = 0.0, time.thread_time() + CanPort.max_batch_s
        return frames

    def _received(self, wait_s: float) -> can.Message | None:
        try:
            message = self._bus.recv(wait_s)
        except (*_DAMAGED, self._can.CanOperationError) as error:
            self._errors += 1
            if self._errors < CanPort.max_errors_in_a_row:
                return None
            if isinstance(error, _DAMAGED):
                raise self._can.CanOperationError(f"only damaged frames are received ({error})") from error
            raise
        if message is not None:
            self._errors = 0
        return message

    def close(self) -> None:
        self._bus.shutdown()


def classic_rate(bitrate: int) -> float:
    """Bytes of capture per second on a bus with classic frames."""
    return CanPort.block_load_ratio * CLASSIC_LAYOUT.block * bitrate / _CLASSIC_BLOCK_BITS


def _widen_buffer(bus: can.BusABC) -> int | None:
    """Frames that a socket buffers before it silently drops some; None where the bus is not a socket."""
    try:
        duplicate = socket.socket(fileno=bus.fileno())
    except (OSError, NotImplementedError, ValueError):  # not every interface has a socket
        return None
    with suppress(OSError):
        duplicate.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, CanPort.receive_buffer_bytes)
    granted = duplicate.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    duplicate.detach()
    return granted // CanPort.socket_frame_bytes


def _poll_of(bus: can.BusABC) -> select.poll | None:
    """Poll object for an interface whose `recv` ignores its timeout; None on Windows, where it does not."""
    if not hasattr(select, "poll"):
        return None
    readable = select.poll()
    readable.register(bus.fileno(), select.POLLIN)
    return readable
