"""What a link is to the rest: frames out, frames in. The links themselves are in `can` and `serial`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from plugins.wire import BlockLayout, Frame


class Port(Protocol):
    """An open link. `send` and `receive` may be called at once from two threads, each from one at a time.

    Both raise their library's own errors; `link_errors` is put around every call.
    """

    where: str
    """The link as a person names it."""
    requests_each: int
    """Requests for blocks that may be under way at once."""
    blocks_each: int
    """Blocks that one request may ask for, so that its answer does not flood the link."""

    def layout(self, block_bytes: int) -> BlockLayout:
        """How blocks are cut here; `block_bytes` is what the drive says for serial lines."""
        ...

    def bulk_rate(self, layout: BlockLayout) -> float | None:
        """Bytes of captures a second that the line carries; None where nothing is known to limit it."""
        ...

    def send(self, frames: Sequence[Frame], timeout_s: float) -> bool:
        """Send frames; False where the link took not all of them in time."""
        ...

    def receive(self, timeout_s: float) -> list[Frame]:
        """All frames that are there, waiting for the first one only; nothing when the time is over."""
        ...

    def close(self) -> None:
        """Let go of the link."""
        ...


@runtime_checkable
class SharedPort(Protocol):
    """A link that another process may write to as well; a frame that the other one has cut in two is dropped."""

    def fileno(self) -> int:
        """Its descriptor."""
        ...

    def as_written(self, frames: Sequence[Frame]) -> bytes:
        """Frames as they are written to it."""
        ...
