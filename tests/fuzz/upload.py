"""An upload whose link does what the choices say: the capture arrives as it is, or is refused."""

from __future__ import annotations

from collections.abc import Callable
from zlib import crc32

from plugins.wire import (
    Ack,
    AckStatus,
    Answer,
    BlockLayout,
    BulkEnd,
    CaptureAssembly,
    CaptureSource,
    Frame,
    Op,
    PowerState,
    ReadBlock,
    SerialDecoder,
    decode,
    encode,
    frame_id,
    to_serial,
)
from protocols import DriveFault
from tests.fuzz.choices import Choices

NUMBER = 5
_MOST_WAITING = 512
_SPARE_ROUNDS = 16
_TAGS = 64
"""After so many requests their tags come round, and a frame that was under way since is taken for another one."""
_STRANGERS = tuple(frame_id(name) for name in ("Bulk", "BulkFD", "BulkEnd", "Ack", "Status"))


class Wrong(Exception):
    """Something got through that must not: a finding."""


def pattern(length: int, seed: int) -> bytes:
    """Bytes in which no two blocks are alike."""
    return bytes((k * (2 * seed + 1) + (k >> 3) * 37 + (k >> 8)) & 255 for k in range(length))


class Upload:
    """Both ends of an upload, and the link between them.

    Parameters
    ----------
    choices : Choices
        What happens, one thing after the other; when they are used up, the link works.
    layout : BlockLayout
    make : callable
        The assembly under test.
    """

    def __init__(
        self,
        choices: Choices,
        layout: BlockLayout,
        make: Callable[..., CaptureAssembly] = CaptureAssembly,
        decoder: Callable[[], SerialDecoder] = SerialDecoder,
    ) -> None:
        self._choices, self._layout = choices, layout
        length = choices.below(400)
        self._data = pattern(length, choices.below(5))
        memory = choices.one_of((None, None, 2 * layout.block, 6 * layout.block))
        self._source = CaptureSource(NUMBER, length, memory_bytes=memory)
        self._assembly = make(
            NUMBER,
            length,
            layout,
            first_window=choices.below(64),
            blocks_each=choices.one_of((1, 3, 4096)),
            requests_each=choices.one_of((1, 8, 32)),
        )
        self._before = CaptureSource.complete_with(NUMBER, pattern(length, 6))
        self._way: list[Frame] = []
        self._decoder = decoder() if layout.name == "BulkFD" and choices.below(2) else None
        self._sent: set[Frame] = set()
        self._forged: set[int] = set()
        self._requested, self._harmed = 0, memory is not None or self._decoder is not None
        self._happenings: tuple[Callable[[], object], ...] = (
            self._ask, self._capture, self._deliver, self._deliver, self._deliver_late, self._lose,
            self._repeat, self._damage, self._stranger, self._stale, self._assembly.give_up, self._look,
        )  # fmt: skip

    def run(self) -> None:
        """Everything that the choices say, then a link that works; raises `Wrong`, or `DriveFault` for a refusal."""
        try:
            while self._choices.left:
                self._choices.one_of(self._happenings)()
            self._come_to_an_end()
        except DriveFault as refusal:
            if not self._harmed and self._requested < _TAGS:
                raise Wrong("refused, though the link only lost, repeated and reordered") from refusal
            raise

    def _come_to_an_end(self) -> None:
        self._source.append(self._data[self._source.captured :])
        for _ in range(_SPARE_ROUNDS + 4 * self._assembly.blocks):
            self._take(self._way)
            self._way.clear()
            if self._look():
                return
            self._assembly.give_up()
            self._ask()
        raise Wrong("an upload over a link that works does not come to its end")

    # The drive

    def _capture(self) -> None:
        """Some more bytes of the capture are there."""
        start = self._source.captured
        self._source.append(self._data[start : start + 8 * self._choices.below(32)])

    def _ask(self) -> None:
        """The host asks, and the drive answers."""
        available = None if self._source.complete else self._source.captured
        for request in self._assembly.requests(available):
            self._requested += 1
            self._answer(request, self._source)

    def _stale(self) -> None:
        """An answer from another capture, with a tag that this one may use."""
        self._harmed = True
        self._answer(ReadBlock(0, self._choices.below(_TAGS), 4, NUMBER), self._before)

    def _answer(self, request: ReadBlock, source: CaptureSource) -> None:
        answer = source.answer(request, self._layout)
        if isinstance(answer, Answer):
            if source is self._before:
                self._forged.add(answer.end.crc)
            self._way += [Frame(self._layout.frame_id, payload) for payload in answer.payloads]
            self._way.append(encode(answer.end))
        else:
            self._way.append(encode(Ack(0, request.window, Op.READ_BLOCK, AckStatus(answer), PowerState.HOLDING)))
        del self._way[:-_MOST_WAITING]

    # The link

    def _deliver(self) -> None:
        count = 1 + self._choices.below(64)
        self._take(self._way[:count])
        del self._way[:count]

    def _deliver_late(self) -> None:
        """The last one overtakes all others."""
        if self._way:
            self._take([self._way.pop()])

    def _lose(self) -> None:
        if self._way:
            self._way.pop(self._choices.below(len(self._way)))

    def _repeat(self) -> None:
        if self._way:
            self._way.append(self._way[self._choices.below(len(self._way))])

    def _damage(self) -> None:
        """Bytes change on the way, unseen by the frame's own check."""
        which = self._choices.below(max(1, len(self._way)))
        identifier, payload = self._way[which] if self._way else Frame(0, b"")
        if not payload:
            return
        damaged = bytearray(payload)
        for _ in range(1 + self._choices.below(3)):
            damaged[self._choices.below(len(damaged))] ^= self._choices.whole()
        self._way[which] = self._bad(Frame(identifier, bytes(damaged)))

    def _stranger(self) -> None:
        """A frame that nobody sent."""
        identifier = self._choices.one_of(_STRANGERS)
        length = self._choices.one_of((8, 64, 4 + self._layout.block, self._choices.below(80)))
        self._way.append(self._bad(Frame(identifier, self._choices.some(length).ljust(length, b"\0"))))

    def _bad(self, frame: Frame) -> Frame:
        self._harmed = True
        message = decode(*frame)
        if isinstance(message, BulkEnd):
            self._forged.add(message.crc)
        return frame

    # The host

    def _take(self, frames: list[Frame]) -> None:
        self._assembly.take(frames if self._decoder is None else self._over_a_line(frames))
        prefix = self._assembly.prefix
        if len(self._assembly.peek(0, prefix)) != prefix:
            raise Wrong("a prefix that is not there")

    def _over_a_line(self, frames: list[Frame]) -> list[Frame]:
        """The same as bytes, some of which change, come twice, or are lost."""
        assert self._decoder is not None
        found = []
        self._sent.update(frames)
        for frame in frames:
            coded = bytearray(to_serial(frame))
            what = self._choices.below(8)
            at = self._choices.below(len(coded)) if what in (1, 2, 3) else 0
            if what == 1:
                coded[at] ^= self._choices.whole()
            elif what == 2:
                del coded[at]
            elif what == 3:
                coded[at:at] = self._choices.some(3)
            came = self._decoder.feed(bytes(coded))
            if not self._sent.issuperset(came):
                raise Wrong("a frame came out of the line that nobody sent")
            found += came
        return found

    def _look(self) -> bool:
        """Whether the capture is there; it must be the drive's, unless somebody forged the CRC that vouches for it."""
        result = self._assembly.result()
        if result is None:
            return False
        if bytes(result) != self._data and crc32(result) not in self._forged:
            raise Wrong("a capture that is not what the drive captured")
        return True
