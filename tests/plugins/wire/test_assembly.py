"""Uploads over bad links: the capture arrives byte-exact, or is refused; it is never wrong."""

from __future__ import annotations

import contextlib
import itertools
import random
from collections.abc import Sequence
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.wire import (
    CAN_FD_LAYOUT,
    CLASSIC_LAYOUT,
    Answer,
    BlockLayout,
    BulkEnd,
    CaptureAssembly,
    CaptureSource,
    Frame,
    ReadBlock,
    SerialDecoder,
    encode,
    frame_id,
    serial_blocks,
    to_serial,
)
from protocols import DriveFault, FaultCause, InputError
from tests.plugins.wire.lossy import Device, Lossy, upload
from tests.support.cases import few

SERIAL = serial_blocks(1020)
LAYOUTS = [CLASSIC_LAYOUT, CAN_FD_LAYOUT, SERIAL]
NAMES = ["classic", "fd", "serial"]
ROWS = np.random.default_rng(7).bytes(100_000 * 4 * 2)
"""100,000 rows of four int16 channels."""


def fetch(device: Device, length: int, **options: int) -> bytes:
    assembly = CaptureAssembly(device.source.number, length, device.layout, **options)
    return bytes(upload(assembly, device.send, device.receive, clock=lambda: device.now_s))


def device(data: bytes, layout: BlockLayout, link: Lossy, number: int = 5) -> Device:
    return Device(CaptureSource.complete_with(number, data), layout, link, link)


MIXES = list(itertools.product((0.0, 0.01, 0.05), repeat=3))


@few("drop, duplicate, reorder", MIXES, fast=2)
@pytest.mark.parametrize("layout", [CAN_FD_LAYOUT, SERIAL], ids=["fd", "serial"])
def test_hundred_thousand_rows_arrive_exactly(
    layout: BlockLayout, drop: float, duplicate: float, reorder: float
) -> None:
    link = Lossy(random.Random(f"{drop}{duplicate}{reorder}"), drop, duplicate, reorder)
    assert fetch(device(ROWS, layout, link), len(ROWS)) == ROWS


@few("rate", [0.01, 0.0, 0.05])
def test_hundred_thousand_rows_arrive_exactly_on_classic_can(rate: float) -> None:
    link = Lossy(random.Random(1), rate, rate, rate)
    assert fetch(device(ROWS, CLASSIC_LAYOUT, link), len(ROWS)) == ROWS


@few("rates", list(itertools.product((0.0, 0.01, 0.05), repeat=4)), fast=4, ids=str)
def test_on_a_serial_line_damage_is_as_good_as_loss(rates: tuple[float, float, float, float]) -> None:
    rng, damage = random.Random(str(rates)), rates[3]
    mix, decoder = Lossy(rng, *rates[:3]), SerialDecoder()

    def line(frames: Sequence[Frame]) -> list[Frame]:
        received = []
        for frame in mix(frames):
            coded = bytearray(to_serial(frame))
            if damage and rng.random() < damage:
                coded[rng.randrange(len(coded))] ^= 1 << rng.randrange(8)
            received += decoder.feed(bytes(coded))
        return received

    end = Device(CaptureSource.complete_with(5, ROWS), SERIAL, line, line)
    assert fetch(end, len(ROWS)) == ROWS


@pytest.mark.parametrize("layout", LAYOUTS, ids=NAMES)
@few("corrupt", [0.0001, 0.01, 0.05])
def test_damage_that_no_frame_check_sees_is_never_taken_for_data(layout: BlockLayout, corrupt: float) -> None:
    data = ROWS[:60_000]
    for seed in range(6):
        link = Lossy(random.Random(seed), 0.01, 0.01, 0.01, corrupt)
        with contextlib.suppress(DriveFault):
            assert fetch(device(data, layout, link), len(data)) == data


@given(
    layout=st.sampled_from(LAYOUTS),
    length=st.integers(0, 9000),
    rates=st.tuples(*[st.sampled_from([0.0, 0.05, 0.3])] * 4),
    seed=st.integers(0, 1000),
    blocks_each=st.sampled_from([1, 7, 4096]),
    requests_each=st.sampled_from([1, 8, 32]),
)
def test_exact_or_refused_on_any_link(
    layout: BlockLayout,
    length: int,
    rates: tuple[float, float, float, float],
    seed: int,
    blocks_each: int,
    requests_each: int,
) -> None:
    data = ROWS[seed : seed + length]
    end = device(data, layout, Lossy(random.Random(seed), *rates))
    try:
        got = fetch(end, length, blocks_each=blocks_each, requests_each=requests_each)
    except DriveFault:
        assert any(rates), "refused on a perfect link"
    else:
        assert got == data


@given(
    layout=st.sampled_from(LAYOUTS),
    batches=st.lists(
        st.lists(
            st.builds(
                Frame,
                st.sampled_from([frame_id(name) for name in ("Bulk", "BulkFD", "BulkEnd", "Ack")]),
                st.binary(max_size=80) | st.binary(min_size=64, max_size=64) | st.binary(min_size=8, max_size=8),
            )
        ),
        max_size=8,
    ),
)
def test_any_frames_are_survived_and_never_make_a_capture(layout: BlockLayout, batches: list[list[Frame]]) -> None:
    data = ROWS[:3000]
    assembly = CaptureAssembly(5, len(data), layout)
    for batch in batches:
        assembly.requests()
        try:
            assembly.take(batch)
            result = assembly.result()
        except DriveFault:
            continue
        assert result is None
    assembly.give_up()


def test_frames_of_the_capture_before_are_not_taken() -> None:
    old, new = ROWS[:6000], ROWS[6000:12000]
    first = CaptureAssembly(1, len(old), CAN_FD_LAYOUT)
    late = CaptureSource.complete_with(1, old).answer(first.requests()[0], CAN_FD_LAYOUT)
    second = CaptureAssembly(2, len(new), CAN_FD_LAYOUT, first_window=first.next_window)
    [request] = second.requests()
    assert not isinstance(late, int)
    second.take([*(Frame(CAN_FD_LAYOUT.frame_id, payload) for payload in late[0]), encode(late[1])])
    assert second.received == 0
    answer = CaptureSource.complete_with(2, new).answer(request, CAN_FD_LAYOUT)
    assert not isinstance(answer, int)
    second.add(answer[0])
    second.end(answer[1])
    result = second.result()
    assert result is not None
    assert bytes(result) == new


def test_answers_that_are_late_beyond_all_patience_never_mean_other_blocks() -> None:
    data = ROWS[:60_000]
    source = CaptureSource.complete_with(1, data)
    assembly = CaptureAssembly(1, len(data), CLASSIC_LAYOUT, blocks_each=64, requests_each=5)
    requests: list[ReadBlock] = []
    for _ in range(40):
        requests += assembly.requests()
        assembly.give_up()
    assert len(requests) == 32
    assert assembly.exhausted
    while assembly.result() is None:
        assert requests
        for request in requests:
            answer = source.answer(request, CLASSIC_LAYOUT)
            assert isinstance(answer, Answer)
            assembly.add(answer.payloads)
            assembly.end(answer.end)
        requests = assembly.requests()
    assert bytes(assembly.result() or b"") == data


def test_the_next_requests_are_sent_while_answers_are_on_their_way() -> None:
    assembly = CaptureAssembly(1, 60 * 100, CAN_FD_LAYOUT, blocks_each=10, requests_each=4)
    source = CaptureSource.complete_with(1, ROWS[: 60 * 100])
    requests = assembly.requests()
    assert [request.blocks for request in requests] == [10] * 4
    assert not assembly.requests()
    for request in requests[:2]:
        answer = source.answer(request, CAN_FD_LAYOUT)
        assert isinstance(answer, Answer)
        assembly.add(answer.payloads)
        assembly.end(answer.end)
    assert [request.offset // 60 for request in assembly.requests()] == [40, 50]


def test_missing_blocks_are_named_and_near_ones_merged() -> None:
    assembly = CaptureAssembly(1, 600, CAN_FD_LAYOUT)
    assert assembly.missing() == [(0, 10)]
    [request] = assembly.requests()
    source = CaptureSource.complete_with(1, ROWS[:600])
    answer = source.answer(request, CAN_FD_LAYOUT)
    assert not isinstance(answer, int)
    assembly.add([answer[0][k] for k in (0, 2, 4, 5, 6, 8, 9)])
    assert assembly.missing() == [(1, 3), (7, 1)]
    assert assembly.prefix == 60
    assert assembly.peek(10, 60) == ROWS[10:60]
    with pytest.raises(InputError):
        assembly.peek(0, 61)


@pytest.mark.parametrize("layout", LAYOUTS, ids=NAMES)
def test_a_capture_can_be_read_while_it_grows(layout: BlockLayout) -> None:
    data = ROWS[:50_000]
    source = CaptureSource(3, len(data), memory_bytes=16_000)
    end = Device(source, layout, list, list)
    assembly = CaptureAssembly(3, len(data), layout)
    for start in range(0, len(data), 4000):
        source.append(data[start : start + 4000])
        while assembly.missing(source.captured):
            for request in assembly.requests(source.captured):
                end.send(request)
            assembly.take(end.receive())
        assert assembly.peek(0, assembly.prefix) == data[: assembly.prefix]
    result = assembly.result()
    assert result is not None
    assert bytes(result) == data


def test_what_the_ring_has_overwritten_is_refused() -> None:
    source = CaptureSource(3, 50_000, memory_bytes=16_000)
    source.append(ROWS[:40_000])
    end = Device(source, CAN_FD_LAYOUT, list, list)
    with pytest.raises(DriveFault, match="overwritten"):
        fetch(end, 50_000)


def test_a_capture_longer_than_announced_is_refused_at_once() -> None:
    end = device(ROWS[:6000], SERIAL, Lossy(random.Random(0)))
    with pytest.raises(DriveFault, match="6000 bytes instead of 3000"):
        fetch(end, 3000)
    assert end.now_s < 1.0


def test_another_capture_is_refused_by_name() -> None:
    end = device(ROWS[:100], CAN_FD_LAYOUT, Lossy(random.Random(0)), number=4)
    assembly = CaptureAssembly(9, 100, CAN_FD_LAYOUT)
    with pytest.raises(DriveFault, match="capture 9: not captured"):
        upload(assembly, end.send, end.receive, clock=lambda: end.now_s)


def test_a_dead_drive_is_given_up_within_a_second_and_a_half() -> None:
    end = device(ROWS[:100], CAN_FD_LAYOUT, Lossy(random.Random(0), drop=1.0))
    with pytest.raises(DriveFault) as caught:
        fetch(end, 100)
    assert caught.value.cause is FaultCause.NO_ANSWER
    assert end.now_s < 1.5


def test_other_traffic_does_not_keep_a_dead_upload_alive() -> None:
    now_s = 0.0

    def receive() -> list[Frame]:
        nonlocal now_s
        now_s += 0.05
        return [Frame(frame_id("Status"), bytes(8))]

    with pytest.raises(DriveFault, match="no data"):
        upload(CaptureAssembly(1, 100, CAN_FD_LAYOUT), lambda _: None, receive, clock=lambda: now_s)


def test_a_wrong_crc_is_requested_again_before_the_data_are() -> None:
    data = ROWS[:600]
    assembly = CaptureAssembly(1, len(data), CAN_FD_LAYOUT)
    source = CaptureSource.complete_with(1, data)
    [request] = assembly.requests()
    answer = source.answer(request, CAN_FD_LAYOUT)
    assert not isinstance(answer, int)
    assembly.add(answer[0])
    assembly.end(BulkEnd(crc32(data) ^ 1, len(data), request.window))
    assert assembly.result() is None
    [again] = assembly.requests()
    assert again.blocks == 0
    assembly.end(BulkEnd(crc32(data), len(data), again.window))
    assert bytes(assembly.result() or b"") == data


@pytest.mark.parametrize("length", [-1, 1 << 26])
def test_a_length_that_cannot_be_addressed_is_refused(length: int) -> None:
    with pytest.raises(InputError, match="cannot be addressed"):
        CaptureAssembly(1, length, CAN_FD_LAYOUT)


@given(st.sampled_from(LAYOUTS), st.builds(ReadBlock, *[st.integers(0, 1 << bits) for bits in (14, 5, 16, 2)]))
def test_any_request_is_answered_or_refused_with_blocks_of_the_capture(layout: BlockLayout, request: ReadBlock) -> None:
    data = ROWS[:10_000]
    answer = CaptureSource.complete_with(1, data).answer(request, layout)
    if isinstance(answer, int):
        assert request.capture != 1 or request.offset % layout.block or request.blocks > layout.max_blocks
        return
    sent = b"".join(payload[layout.header :] for payload in answer.payloads)
    there = data[request.offset : request.offset + request.blocks * layout.block]
    assert sent[: len(there)] == there
    assert not any(sent[len(there) :])
