"""Serial framing: what goes in comes out, damage is dropped and counted, and memory stays bounded."""

from __future__ import annotations

import random
import re
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.wire import Frame, SerialDecoder, all_to_serial, decode, to_serial
from plugins.wire._framing import MAX_PAYLOAD_BYTES

frames = st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=600))


@given(st.lists(frames, max_size=6), st.data())
def test_frames_come_out_whatever_the_pieces(sent: list[Frame], data: st.DataObject) -> None:
    line = all_to_serial(sent)
    decoder, got, at = SerialDecoder(), [], 0
    while at < len(line):
        step = data.draw(st.integers(1, 300))
        got += decoder.feed(line[at : at + step])
        at += step
    assert got == sent
    assert decoder.bad_frames == 0


@given(frames, st.data())
def test_a_damaged_frame_is_dropped_and_its_neighbours_are_not(frame: Frame, data: st.DataObject) -> None:
    line = bytearray(to_serial(frame))
    at = data.draw(st.integers(0, len(line) - 2))
    line[at] ^= data.draw(st.integers(1, 255))
    decoder = SerialDecoder()
    first, last = Frame(1, b"first"), Frame(2, b"last")
    assert decoder.feed(to_serial(first) + bytes(line) + to_serial(last)) == [first, last]
    assert decoder.bad_frames >= (len(bytes(line)[:-1].strip(b"\0")) > 0)


@given(st.binary(max_size=2000))
def test_any_bytes_are_survived_and_the_next_frame_is_found(noise: bytes) -> None:
    decoder, frame = SerialDecoder(), Frame(0x90, b"\0\0answer")
    decoder.feed(noise)
    assert decoder.feed(b"\0" + to_serial(frame)) == [frame]


def test_a_line_without_zeros_does_not_fill_the_memory() -> None:
    decoder = SerialDecoder()
    for _ in range(200):
        decoder.feed(b"\x55" * 4000)
        assert sys.getsizeof(decoder._rest) < 10_000
    assert decoder.bad_frames == 1
    frame = Frame(3, b"back")
    assert decoder.feed(b"\x55\0" + to_serial(frame)) == [frame]


def test_the_longest_frame_passes_and_a_longer_one_does_not() -> None:
    longest = Frame(5, random.Random(1).randbytes(MAX_PAYLOAD_BYTES))
    decoder = SerialDecoder()
    assert decoder.feed(to_serial(longest)) == [longest]
    assert decoder.feed(to_serial(Frame(5, bytes(MAX_PAYLOAD_BYTES + 1)))) == []
    assert decoder.bad_frames == 1


@pytest.mark.parametrize("payload", [b"", bytes(300), b"\xff" * 300])
def test_no_zero_is_inside_a_frame(payload: bytes) -> None:
    assert 0 not in to_serial(Frame(0, payload))[:-1]


PAGE = Path(__file__).parents[3] / "docs" / "firmware.md"
ROW = re.compile(r"^\| `(\w+)\((.*)\)` \| `([0-9A-F]{3})` \| `([0-9a-f ]+)` \| `([0-9a-f ]+)` \|$", re.MULTILINE)


def test_the_golden_frames_of_the_page_are_what_is_stated() -> None:
    rows = ROW.findall(PAGE.read_text(encoding="utf-8"))
    assert len(rows) == 10
    for name, fields, number, payload, line in rows:
        (frame,) = SerialDecoder().feed(bytes.fromhex(line))
        assert (frame.frame_id, frame.payload) == (int(number, 16), bytes.fromhex(payload))
        assert to_serial(frame) == bytes.fromhex(line)
        message = decode(*frame)
        assert type(message).__name__ == name
        assert message is not None
        values = [getattr(value, "name", None) or f"{value:g}" for value in message]
        assert fields == ", ".join(f"{field}={value}" for field, value in zip(message._fields, values, strict=True))
