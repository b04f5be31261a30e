"""The fuzzer's harness: it is quiet about what is right, and finds what is wrong."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from plugins.wire import CAN_FD_LAYOUT, CLASSIC_LAYOUT, CaptureAssembly, Frame, ReadBlock, SerialDecoder, serial_blocks
from protocols import DriveFault
from tests.fuzz.choices import Choices
from tests.fuzz.targets import TARGETS, one_input
from tests.fuzz.upload import Upload, Wrong

INPUTS = 60
LAYOUTS = (CLASSIC_LAYOUT, CAN_FD_LAYOUT, serial_blocks(60))


def inputs(seed: int, count: int) -> list[bytes]:
    rng = random.Random(seed)
    return [rng.randbytes(rng.randrange(400)) for _ in range(count)]


@pytest.mark.parametrize("target", range(2, len(TARGETS)))
def test_nothing_is_found_in_a_hurry(target: int) -> None:
    for data in inputs(target, INPUTS):
        one_input(bytes([target]) + data)


class Credulous(CaptureAssembly):
    """Hands out what it has without asking its CRC."""

    def result(self) -> memoryview | None:
        super_result = super().result()
        if super_result is None and self.prefix == self.length:
            return memoryview(self.peek(0, self.length))
        return super_result


class Forgetful(CaptureAssembly):
    """Never asks again."""

    def requests(self, available: int | None = None) -> list[ReadBlock]:
        return [] if self.received else super().requests(available)


class Gullible(SerialDecoder):
    """Does not look at the CRC of a frame."""

    def _frame(self, coded: bytes) -> Frame | None:
        body = coded[1:-4]
        good = super()._frame(coded)
        return good or (Frame(int.from_bytes(body[:2], "little"), body[2:]) if len(body) > 2 else None)


def findings(make: Callable[..., CaptureAssembly], decoder: Callable[[], SerialDecoder] = SerialDecoder) -> set[str]:
    found = set()
    for k, data in enumerate(inputs(1, 120)):
        try:
            Upload(Choices(data), LAYOUTS[k % 3], make, decoder).run()
        except DriveFault:
            continue
        except Wrong as wrong:
            found.add(str(wrong))
    return found


def test_a_host_that_does_not_ask_the_crc_is_found() -> None:
    assert findings(Credulous) == {"a capture that is not what the drive captured"}


def test_a_host_that_never_asks_again_is_found() -> None:
    assert findings(Forgetful) == {"an upload over a link that works does not come to its end"}


def test_a_line_without_frame_checks_is_found() -> None:
    assert "a frame came out of the line that nobody sent" in findings(CaptureAssembly, Gullible)


def test_the_right_ones_pass() -> None:
    assert findings(CaptureAssembly) == set()


def test_choices_never_run_out() -> None:
    choices = Choices(b"\x05\x00\x01")
    assert (choices.whole(), choices.whole(2), choices.left) == (5, 256, 0)
    assert (choices.below(7), choices.some(3), choices.one_of("ab")) == (0, b"", "a")
