"""Frames of the VESC's line: what goes in comes out, whatever is damaged or cut around it."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.drives.vesc._packets import MAX_PAYLOAD_BYTES, ROW, Decoder, Values, encode_frame, numbers_in, rows_of
from protocols import DriveFault
from tests.plugins.drives.vesc.emulator import crc, packet

payloads = st.binary(min_size=1, max_size=MAX_PAYLOAD_BYTES)


@given(payloads)
def test_a_frame_is_what_the_firmware_writes(payload: bytes) -> None:
    assert encode_frame(payload) == packet(payload)
    assert encode_frame(payload)[-3:-1] == crc(payload).to_bytes(2)


@given(st.lists(payloads, max_size=4), st.integers(1, 40))
def test_frames_come_out_however_they_are_cut(sent: list[bytes], piece: int) -> None:
    line, decoder, found = b"".join(map(encode_frame, sent)), Decoder(), list[bytes]()
    for at in range(0, len(line), piece):
        found += decoder.feed(line[at : at + piece])
    assert found == sent


@given(payloads, st.binary(max_size=30), st.data())
def test_nothing_damaged_comes_out_and_what_follows_does(payload: bytes, noise: bytes, data: st.DataObject) -> None:
    frame = bytearray(encode_frame(payload))
    place = data.draw(st.integers(len(frame) - len(payload) - 3, len(frame) - 4))
    frame[place] ^= data.draw(st.integers(1, 255))
    after = encode_frame(b"after")
    found = Decoder().feed(noise + bytes(frame) + after * (2 * MAX_PAYLOAD_BYTES // len(after)))
    assert payload not in found
    assert b"after" in found


@given(st.binary(max_size=60), payloads, st.integers(1, 700))
def test_a_frame_behind_noise_comes_out_at_the_next_pause(noise: bytes, payload: bytes, length: int) -> None:
    """Noise that begins a frame of any length: the one behind it must not wait for octets that never come."""
    start = bytes([3]) + length.to_bytes(2)
    decoder = Decoder()
    found = decoder.feed(noise + start + encode_frame(payload))
    assert payload in [*found, *decoder.pause()]
    assert decoder.feed(encode_frame(payload)) == [payload]


def test_rows_are_refused_where_one_is_missing_or_short() -> None:
    rows = np.zeros(3, ROW)
    rows["index"] = [0, 1, 2]
    sent = [row.tobytes() for row in rows]
    assert len(rows_of(sent)) == 3
    with pytest.raises(DriveFault, match="missing"):
        rows_of([sent[0], sent[2]])
    with pytest.raises(DriveFault, match="45 octets"):
        rows_of([sent[0], sent[1][:-1]])


@given(
    st.integers(-(2**31), 2**31 - 1), st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**15 - 1), st.integers(0, 255)
)
def test_a_reading_has_its_units(d: int, vq: int, bus: int, fault: int) -> None:
    values = Values.of(struct.pack(">BIiihBiiB", 50, Values.MASK, d, 0, bus, fault, 0, vq, 1))
    assert values.i == pytest.approx(d / 100.0)
    assert values.v.imag == pytest.approx(vq / 1000.0)
    assert values.bus_v == pytest.approx(bus / 10.0)
    assert (values.fault, values.timed_out) == (fault, True)


@pytest.mark.parametrize("payload", [b"", b"\x32", struct.pack(">BIiihBiiB", 50, 1, 0, 0, 0, 0, 0, 0, 0)])
def test_what_is_no_reading_is_a_fault(payload: bytes) -> None:
    with pytest.raises(DriveFault):
        Values.of(payload)


def test_numbers_are_read_whatever_lisp_says_of_their_type() -> None:
    assert numbers_in("> (60.000000f32 -5.500000 1000 0)") == [60.0, -5.5, 1000.0, 0.0]
