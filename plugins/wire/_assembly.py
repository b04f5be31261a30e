"""The host's end of an upload: assembles blocks in any order to a byte-exact capture, or refuses it.

Pure logic, without I/O and threads. Missing blocks are requested again individually; a CRC-32
over the whole capture verifies the result.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import ClassVar
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from plugins.wire._blocks import MAX_CAPTURE_BYTES, WINDOW_COUNT, BlockLayout
from plugins.wire._codec import Frame, decode, frame_id
from plugins.wire._messages import Ack, AckStatus, BulkEnd, Op, ReadBlock
from protocols import DriveFault, FaultCause, InputError

_TRUSTED_WINDOWS = WINDOW_COUNT // 2
"""Number of requests whose answers are accepted, and of unanswered requests. Tags wrap, so that with more of them a
tag could denote different blocks of this capture and the previous one."""


class CaptureAssembly:
    """A capture of known length, assembled from blocks.

    Parameters
    ----------
    capture : int
        Capture number of the drive's acknowledgement.
    length : int
        Bytes of the complete capture.
    layout : BlockLayout
        Layout of blocks on this link.
    first_window : int
        Tag of the first request: `next_window` of the previous assembly, so that its late answers
        are not accepted here.
    blocks_each, requests_each : int
        Largest number of blocks in a request, and of pending requests.
    passes : int
        Number of times that the whole capture is read until its CRC matches, before it is refused.
    """

    max_bad_ends: ClassVar[int] = 2
    """Number of ends with an impossible length that count as transmission errors."""
    max_merged_gap: ClassVar[int] = 2
    """Largest gap of present blocks between missing ones that share a request."""

    def __init__(
        self,
        capture: int,
        length: int,
        layout: BlockLayout,
        *,
        first_window: int = 0,
        blocks_each: int = 4096,
        requests_each: int = 24,
        passes: int = 3,
    ) -> None:
        if not 0 <= length <= MAX_CAPTURE_BYTES:
            raise InputError("wire", "length", f"a capture of {length} bytes cannot be addressed")
        self.capture, self.length, self.layout = capture, length, layout
        self.next_window = first_window % WINDOW_COUNT
        self._blocks_each = min(blocks_each, layout.max_blocks)
        self._requests_each = min(requests_each, _TRUSTED_WINDOWS)
        self._passes_left = passes
        blocks = -(-length // layout.block)
        self._data = np.zeros((blocks, layout.block), dtype=np.uint8)
        self._have = np.zeros(blocks, dtype=np.bool_)
        self._base = np.zeros(WINDOW_COUNT, dtype=np.int64)
        self._count = np.full(WINDOW_COUNT, -1, dtype=np.int64)  # -1: answers with this tag are dropped
        self._trusted: deque[int] = deque()
        self._pending: list[int] = []  # in the order of requests
        self._open_windows: list[int] = []  # also those given up, whose answers may still arrive
        self._crcs: list[int] = []
        self._announced = 0
        self._too_long = 0
        self._crc_requested = False  # whether the CRC alone was requested again

    # State

    @property
    def waiting(self) -> bool:
        """Whether an answer is pending."""
        return bool(self._pending)

    @property
    def exhausted(self) -> bool:
        """Whether too many answers are missing to send further requests."""
        return len(self._open_windows) >= _TRUSTED_WINDOWS

    @property
    def received(self) -> int:
        """Number of received blocks."""
        return int(np.count_nonzero(self._have))

    @property
    def blocks(self) -> int:
        return len(self._have)

    @property
    def captured(self) -> int:
        """Bytes that the drive had captured at the end of its last answer."""
        return self._announced

    @property
    def prefix(self) -> int:
        """Bytes from the start without a gap, unverified until `result` returns the capture."""
        gap = np.flatnonzero(~self._have)[:1]
        return min(self.length, int(gap[0]) * self.layout.block) if len(gap) else self.length

    def peek(self, start: int, stop: int) -> bytes:
        """Bytes of the prefix, before their verification by the CRC.

        Raises `InputError` where some are missing.
        """
        if not 0 <= start <= stop <= self.prefix:
            raise InputError("wire", "capture", f"bytes {start} to {stop} are not there yet")
        return self._data.reshape(-1)[start:stop].tobytes()

    def missing(self, available: int | None = None) -> list[tuple[int, int]]:
        """Missing runs (first block, count) below `available` bytes (default: all), merged across small gaps."""
        return _runs(~self._have[: self._blocks_within(available)])

    def _not_requested(self, available: int | None) -> list[tuple[int, int]]:
        """As `missing`, without pending requests."""
        absent = ~self._have[: self._blocks_within(available)]
        for window in self._pending:
            absent[self._base[window] : self._base[window] + self._count[window]] = False
        return _runs(absent)

    def _blocks_within(self, available: int | None) -> int:
        reach = self.length if available is None else min(available, self.length)
        return self.blocks if reach == self.length else reach // self.layout.block

    # Requests

    def requests(self, available: int | None = None) -> list[ReadBlock]:
        """The next requests; none while more than half of the permitted ones are pending (see `give_up`).

        A request for zero blocks fetches a missing CRC. During the capture, `available` is the number
        of captured bytes (rows in `Progress` times bytes a row).
        """
        room = self._requests_each - len(self._pending)
        if 2 * room < self._requests_each or self.exhausted:
            return []
        room = min(room, _TRUSTED_WINDOWS - len(self._open_windows))
        runs = self._not_requested(available)
        if not runs:
            return [] if self.waiting else [self._request(0, 0)]
        if self.waiting and sum(count for _, count in runs) < self._blocks_each:
            return []  # wait for a larger batch
        requests: list[ReadBlock] = []
        for first, count in runs:
            for start in range(first, first + count, self._blocks_each):
                if len(requests) == room:
                    return requests
                requests.append(self._request(start, min(self._blocks_each, first + count - start)))
        return requests

    def give_up(self) -> None:
        """Stop waiting for pending requests; late answers are still accepted."""
        self._pending.clear()

    def _request(self, first: int, count: int) -> ReadBlock:
        window = self.next_window
        self.next_window = (window + 1) % WINDOW_COUNT
        if len(self._trusted) == _TRUSTED_WINDOWS:
            self._count[self._trusted.popleft()] = -1
        self._trusted.append(window)
        self._base[window], self._count[window] = first, count
        self._pending.append(window)
        self._open_windows.append(window)
        return ReadBlock(first * self.layout.block, window, count, self.capture)

    # Answers

    def take(self, frames: Iterable[Frame]) -> bool:
        """Process the frames of an upload and skip others; returns whether there were any.

        Raises `DriveFault` where the drive refuses a request.
        """
        bulk, end, ack = self.layout.frame_id, frame_id("BulkEnd"), frame_id("Ack")
        payloads, others = [], False
        for identifier, payload in frames:
            if identifier == bulk:
                payloads.append(payload)
            elif identifier in (end, ack):
                message = decode(identifier, payload)
                if isinstance(message, BulkEnd):
                    self.end(message)
                    others = True
                elif isinstance(message, Ack) and message.op is Op.READ_BLOCK:
                    self._raise_refusal(message)
        if payloads:
            self.add(payloads)
        return bool(payloads) or others

    def add(self, payloads: Sequence[bytes]) -> None:
        """Add payloads of bulk frames, in any order, with or without repetitions."""
        window, position, data = self.layout.parse(payloads)
        base, count = self._base[window], self._count[window]
        block = position + base if self.layout.relative else position
        fits = (block >= base) & (block < base + count)
        if not fits.all():
            block, data = block[fits], data[fits]
        is_new = ~self._have[block]
        if not is_new.all():
            block, data = block[is_new], data[is_new]
        self._data[block] = data
        self._have[block] = True
        if self._crcs:  # the length is verified: a complete answer needs no end
            self._pending = [window for window in self._pending if not self._answered(window)]

    def _answered(self, window: int) -> bool:
        base, count = int(self._base[window]), int(self._count[window])
        return count > 0 and bool(self._have[base : base + count].all())

    def end(self, end: BulkEnd) -> None:
        """Process the end of an answer; raises `DriveFault` where the capture is longer than announced."""
        if end.window in self._open_windows:
            del self._open_windows[: self._open_windows.index(end.window) + 1]
        if self._count[end.window] < 0:
            return
        if end.length > self.length:
            self._too_long += 1
            if self._too_long > CaptureAssembly.max_bad_ends:
                problem = f"capture {self.capture} has {end.length} bytes instead of {self.length}"
                raise DriveFault(FaultCause.WRONG_DATA, problem)
            return
        if end.window in self._pending:  # earlier requests were answered or lost
            del self._pending[: self._pending.index(end.window) + 1]
        self._announced = max(self._announced, end.length)
        if end.length == self.length and end.crc not in self._crcs:
            self._crcs.append(end.crc)

    def _raise_refusal(self, ack: Ack) -> None:
        if ack.status is AckStatus.OK or ack.seq not in self._pending:
            return
        why = ack.status.name.lower().replace("_", " ")
        raise DriveFault(FaultCause.WRONG_DATA, f"the drive refuses to send capture {self.capture}: {why}")

    # Result

    def result(self) -> memoryview | None:
        """The verified capture; None while further requests are needed.

        After a CRC mismatch the CRC is requested again, and then the whole capture.

        Raises `DriveFault` (wrong_data) where the CRC does not match after the last pass.
        """
        if not self._crcs or not self._have.all():
            return None
        data = self._data.reshape(-1)[: self.length].data
        if crc32(data) in self._crcs:
            return data.toreadonly()
        self._crcs.clear()
        if self._crc_requested:
            self._restart()
        self._crc_requested = not self._crc_requested
        return None

    def _restart(self) -> None:
        self._passes_left -= 1
        if self._passes_left <= 0:
            raise DriveFault(FaultCause.WRONG_DATA, f"capture {self.capture} does not match its CRC-32 and is refused")
        self._have[:] = False
        self._count[:] = -1
        self._trusted.clear()
        self._pending.clear()


def _runs(absent: NDArray[np.bool_]) -> list[tuple[int, int]]:
    gaps = np.flatnonzero(absent)
    if not len(gaps):
        return []
    cuts = np.flatnonzero(np.diff(gaps) > CaptureAssembly.max_merged_gap + 1)
    first, last = gaps[np.r_[0, cuts + 1]], gaps[np.r_[cuts, len(gaps) - 1]]
    return [(int(a), int(b - a + 1)) for a, b in zip(first, last, strict=True)]
