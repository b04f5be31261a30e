"""The message set: what the DBC says is what the codec does, and what a bus needs of it."""

from __future__ import annotations

import math
import random
import subprocess
import sys
from enum import IntEnum
from functools import cache
from typing import Any, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.wire import (
    DESCRIPTION_CAPTURE,
    LAST_CAPTURE,
    RIPPLE_FLAG,
    EStop,
    Frame,
    Heartbeat,
    ParameterWrite,
    Status,
    decode,
    encode,
    frame_id,
    registers,
)
from plugins.wire._dbc import message_database
from plugins.wire._messages import MESSAGES, Message
from protocols import InputError


@cache
def database() -> Any:
    return message_database()


def random_payload(message: Any, rng: random.Random) -> bytes:
    """Random signals of a message, enumerations in their range, singles finite."""
    values: dict[str, float] = {}
    for signal in message.signals:
        if signal.choices:
            values[signal.name] = rng.choice(list(signal.choices))
        elif signal.is_float:
            values[signal.name] = rng.choice([0.0, -1.5, rng.gauss(0.0, 1e3), 3e38])
        else:
            low = -(1 << (signal.length - 1)) if signal.is_signed else 0
            values[signal.name] = rng.randrange(low, low + (1 << signal.length))
    return bytes(message.encode(values, scaling=False, strict=False))


@pytest.mark.parametrize("make", MESSAGES, ids=lambda make: make.__name__)
def test_codec_and_cantools_agree_bit_by_bit(make: type[Message]) -> None:
    description = database().get_message_by_name(make.__name__)
    rng = random.Random(make.__name__)
    for _ in range(100):
        payload = random_payload(description, rng)
        message = decode(description.frame_id, payload)
        assert type(message) is make
        raw = description.decode(payload, decode_choices=False)
        assert message._asdict() == pytest.approx(raw)
        assert encode(message) == Frame(description.frame_id, payload)


@pytest.mark.parametrize("make", MESSAGES, ids=lambda make: make.__name__)
def test_enumerations_are_the_value_tables(make: type[Message]) -> None:
    for name, kind in get_type_hints(make).items():
        choices = database().get_message_by_name(make.__name__).get_signal_by_name(name).choices
        if issubclass(kind, IntEnum):
            assert {member.value: member.name.lower() for member in kind} == {k: str(v) for k, v in choices.items()}
        elif name == "parameter":
            assert {r.index: r.name for r in registers().values()} == {k: str(v) for k, v in choices.items()}
        else:
            assert choices is None, f"{make.__name__}.{name} has a value table but is a plain number"


def test_every_message_and_signal_is_explained() -> None:
    for message in database().messages:
        assert message.comment, message.name
        assert all(signal.comment for signal in message.signals), message.name
        assert message.senders in (["Host"], ["Drive"])


def test_messages_are_little_endian_with_short_identifiers_and_fit_classic_can() -> None:
    ids = [message.frame_id for message in database().messages]
    assert len(set(ids)) == len(ids)
    for message in database().messages:
        assert message.frame_id < 0x800
        assert not message.is_extended_frame
        assert message.length <= 8 or message.name == "BulkFD"
        assert all(signal.byte_order == "little_endian" for signal in message.signals)


def test_lower_identifiers_are_the_more_urgent_messages() -> None:
    by_urgency = ["EStop", "Heartbeat", "Command", "Setpoint", "Status", "Ack", "Tick", "RippleD", "BulkEnd", "Bulk"]
    ids = [frame_id(name) for name in by_urgency]
    assert ids == sorted(ids)


@given(st.integers(0, 0x7FF), st.binary(max_size=70))
def test_any_frame_is_a_message_or_nothing(identifier: int, payload: bytes) -> None:
    message = decode(identifier, payload)
    if message is not None and not any(isinstance(x, float) and math.isnan(x) for x in message):
        again = encode(message)
        assert decode(*again) == message


def test_bytes_that_a_later_version_adds_are_passed_over() -> None:
    beat = Heartbeat(7, 3, 1234)
    identifier, payload = encode(beat)
    assert decode(identifier, payload + b"new") == beat
    assert decode(identifier, payload[:-1]) is None


def test_unknown_members_of_an_enumeration_make_no_message() -> None:
    assert decode(frame_id("Command"), bytes([1, 0, 1, 99, 0, 0, 0, 0])) is None


@given(st.binary(max_size=8))
def test_an_emergency_stop_is_one_whatever_its_payload(payload: bytes) -> None:
    assert isinstance(decode(frame_id("EStop"), payload), EStop)


def test_capture_numbers_ripple_rows_and_the_description_do_not_meet() -> None:
    assert registers()["capture_number"].range == (0, LAST_CAPTURE)
    assert LAST_CAPTURE < RIPPLE_FLAG < LAST_CAPTURE + RIPPLE_FLAG < DESCRIPTION_CAPTURE < 1 << 16


def test_a_number_that_does_not_fit_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"Heartbeat\.session"):
        encode(Heartbeat(70_000, 0, 0))
    with pytest.raises(InputError, match=r"ParameterWrite\.value"):
        encode(ParameterWrite(1, 1, 1, 1e39))


def test_scaled_signals_come_back_in_their_unit() -> None:
    status = decode(frame_id("Status"), bytes([0x14, 9, 2, 0, 0x10, 0x27, 0xEC, 1]))
    assert isinstance(status, Status)
    assert (status.state.name, status.cause.name) == ("FAULTED", "OVERCURRENT")
    assert status.v_dc == pytest.approx(200.0)
    assert status.temperature == -20


def test_importing_the_protocol_imports_no_parser_of_files() -> None:
    heavy = "{'cantools', 'can', 'yaml', 'serial', 'typer'}"
    code = f"import sys, plugins.wire as wire; wire.encode(wire.EStop()); print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
