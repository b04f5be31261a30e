"""A link that loses, repeats, reorders and damages frames on purpose; for tests of both ends of an upload."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from plugins.wire import (
    Ack,
    AckStatus,
    Answer,
    BlockLayout,
    CaptureAssembly,
    CaptureSource,
    Frame,
    Op,
    PowerState,
    ReadBlock,
    decode,
    encode,
)
from protocols import DriveFault, FaultCause


@dataclass
class Lossy:
    """Rates are parts of one; a damaged payload goes through as a link without a CRC would let it."""

    rng: random.Random
    drop: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    corrupt: float = 0.0

    def __call__(self, frames: Sequence[Frame]) -> list[Frame]:
        out: list[Frame] = []
        held: list[Frame] = []
        chance = self.rng.random
        for frame in frames:
            if self.drop and chance() < self.drop:
                continue
            if self.corrupt and chance() < self.corrupt:
                frame = self._damaged(frame)
            if self.reorder and chance() < self.reorder:
                held.append(frame)
                continue
            out.append(frame)
            if self.duplicate and chance() < self.duplicate:
                out.append(frame)
            if held and chance() < 0.2:
                out.append(held.pop(0))
        return out + held

    def _damaged(self, frame: Frame) -> Frame:
        payload = bytearray(frame.payload)
        payload[self.rng.randrange(len(payload))] ^= 1 << self.rng.randrange(8)
        return Frame(frame.frame_id, bytes(payload))


@dataclass
class Device:
    """A capture behind a lossy link, with a clock that only moves while somebody listens."""

    source: CaptureSource
    layout: BlockLayout
    there: Callable[[Sequence[Frame]], list[Frame]]
    back: Callable[[Sequence[Frame]], list[Frame]]
    now_s: float = 0.0
    sent: int = 0
    _queue: list[Frame] = field(default_factory=list)

    def send(self, request: ReadBlock) -> None:
        for frame in self.there([encode(request)]):
            message = decode(*frame)
            if isinstance(message, ReadBlock):
                self._queue += self._answer(message)

    def receive(self) -> list[Frame]:
        """All that is under way, through the link; time passes where there is nothing."""
        frames, self._queue = self.back(self._queue), []
        self.sent += len(frames)
        self.now_s += 1e-3 if frames else 0.1
        return frames

    def _answer(self, request: ReadBlock) -> list[Frame]:
        answer = self.source.answer(request, self.layout)
        if isinstance(answer, Answer):
            return [*(Frame(self.layout.frame_id, payload) for payload in answer.payloads), encode(answer.end)]
        return [encode(Ack(0, request.window, Op.READ_BLOCK, AckStatus(answer), PowerState.HOLDING))]


def upload(
    assembly: CaptureAssembly,
    send: Callable[[ReadBlock], None],
    receive: Callable[[], Sequence[Frame]],
    *,
    clock: Callable[[], float] = time.monotonic,
    repeat_s: float = 0.15,
    timeout_s: float = 1.0,
    rounds: int = 200,
) -> memoryview:
    """Ask and take until the capture is complete and verified.

    Raises `DriveFault`: ``no_answer`` where nothing comes, ``wrong_data`` where the capture does not
    fit its CRC or the drive refuses to hand it out.
    """
    idle, before = 0, -1
    received_s = clock()
    while (data := assembly.result()) is None:
        if not assembly.waiting:
            idle = 0 if assembly.received != before else idle + 1
            before = assembly.received
            if idle > rounds:
                raise DriveFault(FaultCause.NO_ANSWER, f"capture {assembly.capture} does not get on")
            for request in assembly.requests():
                send(request)
            requested_s = clock()
        mine = assembly.take(receive())
        now = clock()
        received_s = now if mine else received_s
        if now - received_s > timeout_s:
            raise DriveFault(FaultCause.NO_ANSWER, f"no data of capture {assembly.capture} for {timeout_s:g} s")
        if now - max(received_s, requested_s) > repeat_s:
            assembly.give_up()
    return data
