"""Interlock inputs on the wire: names, bits, words, and what an earlier version's message says of them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.wire import (
    Capability,
    Fault,
    Measurement,
    RegisterFile,
    capabilities_of,
    capability_registers,
    decode,
    drive_fault,
    encode,
    interlocks_line,
    open_interlocks,
    parse_description,
)
from protocols import Capabilities, DriveFault, FaultCause, InputError
from tests.plugins.wire.test_program import CAPABILITIES, FACTS

NAMES = ("door", "emergency stop")


def capabilities_by(text: str, bits: Capability = Capability.INTERLOCKS) -> Capabilities:
    own = RegisterFile(capability_registers(CAPABILITIES, replace(FACTS, bits=bits)))
    return capabilities_of(own.values(), parse_description(text.encode()), None)


@given(st.lists(st.text("abc ÄΩ-", min_size=1).filter(str.strip), min_size=1, max_size=8))
def test_names_come_back_from_the_description(names: list[str]) -> None:
    assert capabilities_by(interlocks_line(names)).interlocks == tuple(map(str.strip, names))


@pytest.mark.parametrize("names", [["a"] * 9, ["door, cover"], [" "], ["a\nname: b"]])
def test_names_that_a_description_cannot_carry_are_refused(names: list[str]) -> None:
    with pytest.raises(InputError):
        interlocks_line(names)


def test_a_drive_without_the_capability_has_none_whatever_it_describes() -> None:
    assert capabilities_by(interlocks_line(NAMES), Capability(0)).interlocks == ()


@pytest.mark.parametrize("text", ["", "interlocks:", "interlocks: 1,2,3,4,5,6,7,8,9"])
def test_inputs_without_a_name_each_are_wrong_data(text: str) -> None:
    with pytest.raises(DriveFault, match="its description names") as fault:
        capabilities_by(text)
    assert fault.value.cause is FaultCause.WRONG_DATA


def test_bits_are_the_names_in_their_order() -> None:
    assert [open_interlocks(bits, NAMES) for bits in range(4)] == [(), NAMES[:1], NAMES[1:], NAMES]


def test_an_input_that_has_no_name_forbids_power_too() -> None:
    assert open_interlocks(4, NAMES) == ("input 2",)


def test_a_trip_names_the_input_in_one_line() -> None:
    fault = drive_fault(Fault.INTERLOCK, 2.0, 0.0, 1 << Fault.INTERLOCK, NAMES)
    assert str(fault) == "drive fault emergency_stop: interlock open: emergency stop; close it, and resume"


def test_a_measurement_of_version_1_0_says_that_none_is_open() -> None:
    message = Measurement(1, -2, 3, 300.0, 3)
    identifier, payload = encode(message)
    assert decode(identifier, payload) == message
    assert decode(identifier, payload[:7]) == message._replace(open_interlocks=0)
    assert decode(identifier, payload[:6]) is None
