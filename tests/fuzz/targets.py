"""What is fuzzed: codec, framing, a drive's word about itself, and uploads over links that do anything.

`one_input` raises whatever is not one of the project's own errors, and `Wrong` where something got through that
must not. It knows no fuzzer.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from plugins.wire import (
    CAN_FD_LAYOUT,
    CLASSIC_LAYOUT,
    AckStatus,
    Answer,
    Capability,
    CaptureFormat,
    CaptureSource,
    Channel,
    DriveFacts,
    Frame,
    PowerState,
    ReadBlock,
    RegisterFile,
    RowFormat,
    Scales,
    SerialDecoder,
    capabilities_of,
    capability_registers,
    decode,
    encode,
    facts_of,
    limits_of,
    parse_description,
    program_of,
    register_index,
    registers,
    serial_blocks,
    to_serial,
)
from plugins.wire._dbc import layouts
from protocols import Capabilities, FluxbenchError
from tests.fuzz.choices import Choices
from tests.fuzz.upload import Upload, Wrong, pattern

IDENTIFIERS = tuple(sorted(layout.frame_id for layout in layouts().values()))
SCALES = Scales.spanning(10.0, 200.0, 400.0, 5.0)
OWN = Capabilities(
    name="fuzzed drive",
    sampling_frequency_hz=10_000.0,
    pwm_frequency_hz=10_000.0,
    pwm_frequencies_hz=(10_000.0,),
    dc_bus_voltage_v=300.0,
    voltage_delay_samples=1.5,
    max_current_a=10.0,
    max_voltage_v=170.0,
    excitations=frozenset({"hold"}),
    watchdog_s=0.2,
    watchdog_covers=frozenset({"hold"}),
)
FACTS = DriveFacts(bits=Capability.RAW_CAPTURE, channels=Channel(31), scales=SCALES, memory_bytes=65536)
LAYOUTS = (CLASSIC_LAYOUT, CAN_FD_LAYOUT, serial_blocks(60), serial_blocks(1020))


def codec(choices: Choices) -> None:
    """Any payload decodes to nothing, or to a message that encodes to the same one."""
    identifier = choices.one_of(IDENTIFIERS) if choices.below(8) else choices.whole(2)
    message = decode(identifier, choices.some(choices.below(80)))
    if message is None:
        return
    frame = encode(message)
    again = decode(*frame)
    if frame.frame_id != identifier or again is None or not _alike(message, again):
        raise Wrong(f"{message} became {again}")


def _alike(one: Any, other: Any) -> bool:
    """Equal; a NaN is as good as another one."""
    pairs = zip(one, other, strict=True)
    return type(one) is type(other) and all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)


def framing(choices: Choices) -> None:
    """Where a line is cut makes no difference; what comes out could have been sent, and a good frame is found."""
    good = Frame(choices.whole(2), choices.some(choices.below(24)))
    overlong = bytes([choices.below(256)]) * (5000 if choices.below(8) == 7 else 0)
    data = overlong + choices.some(choices.left) + b"\0"
    whole, pieces = SerialDecoder(), SerialDecoder()
    found, parted = whole.feed(data), []
    step = 1 + len(good.payload) * (100 if overlong else 1)
    for start in range(0, len(data), step):
        parted += pieces.feed(data[start : start + step])
    if found != parted or whole.bad_frames != pieces.bad_frames:
        raise Wrong(f"{found} in one piece, {parted} in pieces of {step}")
    if any(SerialDecoder().feed(to_serial(frame)) != [frame] for frame in found):
        raise Wrong("a frame that cannot have been sent")
    if whole.feed(to_serial(good)) != [good]:
        raise Wrong("a good frame after a bad one was lost")


def self_description(choices: Choices) -> None:
    """A drive's registers and description make capabilities, or are refused."""
    file = RegisterFile(capability_registers(OWN, FACTS))
    names = list(registers())
    for _ in range(choices.below(16)):
        value: float = struct.unpack("<f", choices.some(4).ljust(4, b"\0"))[0]
        file[choices.one_of(names)] = float(choices.below(300)) if choices.below(2) else value
    own = dict(file.values())
    description = parse_description(choices.some(choices.left))
    facts = facts_of(own)
    made = capabilities_of(own, description, None)
    if not (made.max_current_a > 0.0 and facts.block_bytes >= 60):
        raise Wrong(f"{made} is no drive")


def register_writes(choices: Choices) -> None:
    """Writes leave the registers within the table; a program or limits are made of them, or `ValueError` says no."""
    file = RegisterFile()
    for _ in range(choices.below(32)):
        value: float = struct.unpack("<f", choices.some(4).ljust(4, b"\0"))[0]
        index = choices.below(256)
        state = choices.one_of(tuple(PowerState)) if choices.below(4) == 0 else PowerState.DISARMED
        before = dict(file.values())
        status = file.write(index, value, state)
        changed = [name for name, held in file.values().items() if held != before[name]]
        if status is not AckStatus.OK and changed:
            raise Wrong(f"refused as {status.name}, and {changed} changed")
        if any(registers()[name].refuses(file[name]) or register_index(name) != index for name in changed):
            raise Wrong(f"register {index} let {value} in")
    for made_of in (program_of, limits_of):
        try:
            made_of(file.values())
        except ValueError:
            continue


def block_requests(choices: Choices) -> None:
    """The drive's end: any request is answered with the capture's own bytes, or refused."""
    data = pattern(choices.below(400), choices.below(7))
    layout = choices.one_of(LAYOUTS)
    source = CaptureSource(1, len(data), memory_bytes=choices.one_of((None, 64, 4096)))
    source.append(data[: choices.below(512)])
    requested = ReadBlock(choices.whole(2) << choices.below(11), choices.below(64), choices.whole(2), choices.below(3))
    answer = source.answer(requested, layout)
    if not isinstance(answer, Answer):
        return
    sent = b"".join(payload[layout.header :] for payload in answer.payloads)
    there = data[: source.captured][requested.offset : requested.offset + len(sent)]
    if sent[: len(there)] != there or any(sent[len(there) :]):
        raise Wrong("blocks that are not the capture's")


def rows(choices: Choices) -> None:
    """Bytes of rows become as many finite samples, or are refused."""
    form = RowFormat(Channel(1 + choices.below(511)), choices.one_of(tuple(CaptureFormat)), SCALES)
    data = choices.some(choices.left)
    columns = form.unpack(data)
    if any(len(column) * form.row_bytes != len(data) for column in columns.values()):
        raise Wrong("samples were lost")
    if any(not math.isfinite(value) for column in columns.values() for value in column):
        raise Wrong("a sample is no number")


def upload(choices: Choices) -> None:
    """An upload over a link that does what the fuzzer likes: the capture, or a refusal."""
    Upload(choices, choices.one_of(LAYOUTS)).run()


TARGETS: tuple[Callable[[Choices], None], ...] = (
    upload, upload, upload, codec, framing, self_description, register_writes, block_requests, rows
)  # fmt: skip
"""Uploads are the largest part, and are tried most."""


def one_input(data: bytes) -> None:
    """One input of a fuzzer; the project's own errors are answers, everything else is a finding."""
    choices = Choices(data)
    target = TARGETS[choices.below(len(TARGETS))]
    try:
        target(choices)
    except FluxbenchError as error:
        if "\n" in str(error) or not str(error):
            raise Wrong(f"an error is one line, not {str(error)!r}") from error
