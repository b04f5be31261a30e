"""Interface of a link that sends and receives frames; implemented by the drives `can` and `serial`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from plugins.wire import BlockLayout, Frame


class Port(Protocol):
    """An open link. One thread may call `send` while another one calls `receive`.

    Both raise their library's errors; every call is wrapped in `link_errors`.
    """

    where: str
    """Name of the link, for messages."""
    requests_each: int
    """Largest number of pending requests for blocks."""
    blocks_each: int
    """Largest number of blocks in a request, so that its answer does not flood the link."""

    def layout(self, block_bytes: int) -> BlockLayout:
        """Layout of blocks on this link; `block_bytes` is the drive's block length on serial lines."""
        ...

    def bulk_rate(self, layout: BlockLayout) -> float | None:
        """Bytes of capture per second on the line; None without a known limit."""
        ...

    def send(self, frames: Sequence[Frame], timeout_s: float) -> bool:
        """Send frames; False where the link did not accept all of them in time."""
        ...

    def receive(self, timeout_s: float) -> list[Frame]:
        """Received frames, waiting for the first one only; empty after `timeout_s`."""
        ...

    def close(self) -> None:
        """Close the link."""
        ...


@runtime_checkable
class SharedPort(Protocol):
    """A link that another process may write to as well; a frame that this splits is dropped."""

    def fileno(self) -> int | None:
        """Descriptor of the link; None where the system has none."""
        ...

    def as_written(self, frames: Sequence[Frame]) -> bytes:
        """Frames as bytes to be written to the descriptor."""
        ...
