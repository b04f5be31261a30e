"""Registers: the table is sound, and the drive's file refuses what the table does not allow."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.wire import (
    AckStatus,
    Capability,
    CaptureFormat,
    Channel,
    Fault,
    PowerState,
    RegisterFile,
    register_index,
    register_name,
    registers,
    single,
)
from plugins.wire._program import AXES, KINDS, WAVEFORMS

LIMIT = register_index("limit_current_a")
TARGET = register_index("current_d_a")
KIND = register_index("program_kind")


def test_indices_are_unique_and_fit_a_byte() -> None:
    indices = [register.index for register in registers().values()]
    assert len(set(indices)) == len(indices)
    assert all(0 <= index <= 255 for index in indices)
    assert indices == sorted(indices)
    assert all(register_name(register_index(name)) == name for name in registers())


def test_every_register_is_explained_and_its_default_is_allowed() -> None:
    for register in registers().values():
        assert register.text.endswith("."), register.name
        assert register.access in ("read", "setup", "program")
        assert register.access == "read" or register.refuses(register.default) is None, register.name
        assert all(abs(bound) <= 1 << 24 for bound in register.range) or not register.whole, register.name


def test_ranges_of_enumerations_hold_all_members_and_no_more() -> None:
    for name, bits in (("capability_bits", Capability), ("capture_channels", Channel), ("capture_mask", Channel)):
        assert registers()[name].range[1] >= sum(bits)
    assert registers()["program_kind"].range == (0, len(KINDS) - 1)
    assert registers()["excitations"].range == (0, (1 << len(KINDS)) - 1)
    assert registers()["swept_axis"].range == (0, len(AXES) - 1)
    assert registers()["waveform"].range == (0, len(WAVEFORMS) - 1)
    assert registers()["capture_format"].range == (0, max(CaptureFormat))
    assert registers()["fault_cause"].range[1] >= max(Fault)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_register_takes_a_number_that_is_none(value: float) -> None:
    file = RegisterFile()
    for register in registers().values():
        status = file.write(register.index, value, PowerState.DISARMED)
        assert status in (AckStatus.NOT_A_NUMBER, AckStatus.READ_ONLY)
        assert math.isfinite(file[register.name])


@given(st.integers(0, 255), st.floats(width=32), st.sampled_from(PowerState))
def test_any_write_leaves_the_file_within_the_table(index: int, value: float, state: PowerState) -> None:
    file = RegisterFile()
    before = dict(file.values())
    status = file.write(index, value, state)
    name = register_name(index)
    if status is not AckStatus.OK:
        assert dict(file.values()) == before
        return
    assert name is not None
    low, high = registers()[name].range
    assert single(low) <= file[name] <= single(high)
    assert file.read(index) == value


def test_limits_are_written_disarmed_only_and_programs_while_none_runs() -> None:
    allowed = {
        (index, state): RegisterFile().write(index, 1.0, state) is AckStatus.OK
        for index in (LIMIT, TARGET)
        for state in PowerState
    }
    assert [state for state in PowerState if allowed[LIMIT, state]] == [PowerState.DISARMED]
    assert [state for state in PowerState if allowed[TARGET, state]] == [
        PowerState.DISARMED,
        PowerState.HOLDING,
        PowerState.FAULTED,
    ]


def test_refusals_have_their_reason() -> None:
    file = RegisterFile()
    assert file.write(register_index("max_current_a"), 1.0, PowerState.DISARMED) is AckStatus.READ_ONLY
    assert file.write(255, 1.0, PowerState.DISARMED) is AckStatus.UNKNOWN
    assert file.write(KIND, 1.5, PowerState.DISARMED) is AckStatus.OUT_OF_RANGE
    assert file.write(KIND, 4.0, PowerState.DISARMED) is AckStatus.OUT_OF_RANGE
    assert file.write(LIMIT, -1.0, PowerState.DISARMED) is AckStatus.OUT_OF_RANGE
    assert file.read(255) is AckStatus.UNKNOWN
