"""The host's end of an upload: blocks in any order become a capture that is byte-exact, or refused.

Pure logic, without I/O and threads. Missing blocks are requested again, one by one; at the
end the CRC-32 over the whole capture decides.
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
"""Answers to older requests are no longer taken, and no more requests are sent without an end of any: tags come round
again, and this capture and the one before it must not mean different blocks by one."""


class CaptureAssembly:
    """A capture of known length, put together from blocks.

    Parameters
    ----------
    capture : int
        Capture number, as the drive acknowledged it.
    length : int
        Bytes of the complete capture.
    layout : BlockLayout
        How this link carries blocks.
    first_window : int
        Tag of the first request. Go on with `next_window` of the assembly before, so that its late
        answers are not taken for this one's.
    blocks_each, requests_each : int
        Most blocks in one request, and most requests under way at a time.
    passes : int
        How often the whole capture is read where its CRC does not fit, before it is refused.
    """

    slips: ClassVar[int] = 2
    """Ends with an impossible length that are put down to damage on the way."""
    bridge: ClassVar[int] = 2
    """Missing blocks with at most this many present ones between them share a request."""

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
        self._blocks_each = min(blocks_each, layout.most)
        self._requests_each = min(requests_each, _TRUSTED_WINDOWS)
        self._passes_left = passes
        blocks = -(-length // layout.block)
        self._data = np.zeros((blocks, layout.block), dtype=np.uint8)
        self._have = np.zeros(blocks, dtype=np.bool_)
        self._base = np.zeros(WINDOW_COUNT, dtype=np.int64)
        self._count = np.full(WINDOW_COUNT, -1, dtype=np.int64)  # -1: answers with this tag are not taken
        self._trusted: deque[int] = deque()
        self._waiting_for: list[int] = []  # in the order of asking
        self._unended: list[int] = []  # the same, with those that were given up and may come all the same
        self._crcs: list[int] = []
        self._announced = 0
        self._too_long = 0
        self._doubted = False  # whether the CRC, rather than the data, was requested again

    # What is known

    @property
    def waiting(self) -> bool:
        """Whether an answer is still under way, as far as is known."""
        return bool(self._waiting_for)

    @property
    def exhausted(self) -> bool:
        """Whether too many answers are missing to send more requests."""
        return len(self._unended) >= _TRUSTED_WINDOWS

    @property
    def received(self) -> int:
        """Blocks that are there; grows as long as the upload gets on."""
        return int(np.count_nonzero(self._have))

    @property
    def blocks(self) -> int:
        return len(self._have)

    @property
    def captured(self) -> int:
        """Bytes that the drive had captured when it last ended an answer."""
        return self._announced

    @property
    def prefix(self) -> int:
        """Bytes from the start without a gap; not verified before `result` is there."""
        gap = np.flatnonzero(~self._have)[:1]
        return min(self.length, int(gap[0]) * self.layout.block) if len(gap) else self.length

    def peek(self, start: int, stop: int) -> bytes:
        """Bytes of the prefix, on trust: the CRC is yet to come.

        Raises `InputError` where not all of them are there.
        """
        if not 0 <= start <= stop <= self.prefix:
            raise InputError("wire", "capture", f"bytes {start} to {stop} are not there yet")
        return self._data.reshape(-1)[start:stop].tobytes()

    def missing(self, available: int | None = None) -> list[tuple[int, int]]:
        """Runs (first block, count) that are missing below `available` bytes (default: all), near ones merged."""
        return _runs(~self._have[: self._blocks_within(available)])

    def _not_requested(self, available: int | None) -> list[tuple[int, int]]:
        """The same without what is under way."""
        absent = ~self._have[: self._blocks_within(available)]
        for window in self._waiting_for:
            absent[self._base[window] : self._base[window] + self._count[window]] = False
        return _runs(absent)

    def _blocks_within(self, available: int | None) -> int:
        reach = self.length if available is None else min(available, self.length)
        return self.blocks if reach == self.length else reach // self.layout.block

    # Asking

    def requests(self, available: int | None = None) -> list[ReadBlock]:
        """What to send next; nothing while more than half of what may be under way is (see `give_up`).

        Where no block is missing but the CRC is, a request for no blocks brings it. While the drive
        still captures, `available` is how many bytes it has (rows in `Progress` times bytes a row).
        """
        room = self._requests_each - len(self._waiting_for)
        if 2 * room < self._requests_each or self.exhausted:
            return []
        room = min(room, _TRUSTED_WINDOWS - len(self._unended))
        runs = self._not_requested(available)
        if not runs:
            return [] if self.waiting else [self._request(0, 0)]
        if self.waiting and sum(count for _, count in runs) < self._blocks_each:
            return []  # a few blocks wait for more
        requests: list[ReadBlock] = []
        for first, count in runs:
            for start in range(first, first + count, self._blocks_each):
                if len(requests) == room:
                    return requests
                requests.append(self._request(start, min(self._blocks_each, first + count - start)))
        return requests

    def give_up(self) -> None:
        """Wait no longer for what is under way; late answers are taken all the same."""
        self._waiting_for.clear()

    def _request(self, first: int, count: int) -> ReadBlock:
        window = self.next_window
        self.next_window = (window + 1) % WINDOW_COUNT
        if len(self._trusted) == _TRUSTED_WINDOWS:
            self._count[self._trusted.popleft()] = -1
        self._trusted.append(window)
        self._base[window], self._count[window] = first, count
        self._waiting_for.append(window)
        self._unended.append(window)
        return ReadBlock(first * self.layout.block, window, count, self.capture)

    # Taking

    def take(self, frames: Iterable[Frame]) -> bool:
        """Take the frames that belong to an upload and pass over all others; whether there were any.

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
                    self._refused(message)
        if payloads:
            self.add(payloads)
        return bool(payloads) or others

    def add(self, payloads: Sequence[bytes]) -> None:
        """Payloads of bulk frames, in any order, repeated or not."""
        window, position, data = self.layout.parse(payloads)
        base, count = self._base[window], self._count[window]
        block = position + base if self.layout.relative else position
        fits = (block >= base) & (block < base + count)
        if not fits.all():
            block, data = block[fits], data[fits]
        fresh = ~self._have[block]
        if not fresh.all():
            block, data = block[fresh], data[fresh]
        self._data[block] = data
        self._have[block] = True
        if self._crcs:  # the length is known: an answer whose blocks are all there needs no end
            self._waiting_for = [window for window in self._waiting_for if not self._answered(window)]

    def _answered(self, window: int) -> bool:
        base, count = int(self._base[window]), int(self._count[window])
        return count > 0 and bool(self._have[base : base + count].all())

    def end(self, end: BulkEnd) -> None:
        """The end of one answer; raises `DriveFault` where the capture proves longer than announced."""
        if end.window in self._unended:
            del self._unended[: self._unended.index(end.window) + 1]
        if self._count[end.window] < 0:
            return
        if end.length > self.length:
            self._too_long += 1
            if self._too_long > CaptureAssembly.slips:
                what = f"capture {self.capture} has {end.length} bytes instead of {self.length}"
                raise DriveFault(FaultCause.WRONG_DATA, what)
            return
        if end.window in self._waiting_for:  # earlier requests were answered before, or lost
            del self._waiting_for[: self._waiting_for.index(end.window) + 1]
        self._announced = max(self._announced, end.length)
        if end.length == self.length and end.crc not in self._crcs:
            self._crcs.append(end.crc)

    def _refused(self, ack: Ack) -> None:
        if ack.status is AckStatus.OK or ack.seq not in self._waiting_for:
            return
        why = ack.status.name.lower().replace("_", " ")
        raise DriveFault(FaultCause.WRONG_DATA, f"the drive does not hand out capture {self.capture}: {why}")

    # The end

    def result(self) -> memoryview | None:
        """The capture, verified; None where there is more to ask for.

        Where the CRC does not fit, it is requested once more, and then the whole capture.

        Raises `DriveFault` (wrong_data) where the CRC does not fit after the last pass.
        """
        if not self._crcs or not self._have.all():
            return None
        data = self._data.reshape(-1)[: self.length].data
        if crc32(data) in self._crcs:
            return data.toreadonly()
        self._crcs.clear()
        if self._doubted:
            self._start_again()
        self._doubted = not self._doubted
        return None

    def _start_again(self) -> None:
        self._passes_left -= 1
        if self._passes_left <= 0:
            raise DriveFault(FaultCause.WRONG_DATA, f"capture {self.capture} does not fit its CRC-32 and is refused")
        self._have[:] = False
        self._count[:] = -1
        self._trusted.clear()
        self._waiting_for.clear()


def _runs(absent: NDArray[np.bool_]) -> list[tuple[int, int]]:
    gaps = np.flatnonzero(absent)
    if not len(gaps):
        return []
    cuts = np.flatnonzero(np.diff(gaps) > CaptureAssembly.bridge + 1)
    first, last = gaps[np.r_[0, cuts + 1]], gaps[np.r_[cuts, len(gaps) - 1]]
    return [(int(a), int(b - a + 1)) for a, b in zip(first, last, strict=True)]
