"""Excitations, limits and capabilities go through registers and come back as they were, to a single's precision."""

from __future__ import annotations

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from plugins.wire import (
    VECTORS,
    AckStatus,
    Capability,
    Channel,
    DriveFacts,
    Fault,
    PowerState,
    RegisterFile,
    Scales,
    capabilities_of,
    capability_registers,
    capture_registers,
    drive_fault,
    facts_of,
    limit_registers,
    limits_of,
    motor_registers,
    parse_description,
    program_of,
    program_registers,
    register_index,
    registers,
)
from plugins.wire._facts import shortest_decimal
from protocols import (
    Capabilities,
    CurrentControl,
    DriveFault,
    DriveRefused,
    Excitation,
    FaultCause,
    GatesOff,
    Hold,
    Injection,
    Limits,
    Motor,
    Trapezoid,
)

FS = 10_000.0
seconds = st.floats(0.001, 60.0)
amperes = st.floats(-100.0, 100.0)
common = {
    "rotor_angle_rad": st.floats(-6.3, 6.3),
    "pwm_frequency_hz": st.none() | st.sampled_from([4000.0, 8000.0, 16000.0]),
    "control": st.builds(CurrentControl, bandwidth_hz=st.floats(1.0, 500.0), damping=st.floats(0.3, 2.0)),
}
excitations: st.SearchStrategy[Excitation] = st.one_of(
    st.builds(GatesOff, duration_s=seconds, **common),
    st.builds(
        Hold, current_d_a=amperes, current_q_a=amperes, settle_s=st.floats(0.0, 5.0), duration_s=seconds, **common
    ),
    st.builds(
        Trapezoid,
        swept_axis=st.sampled_from(["d", "q", "dq"]),
        held_a=amperes,
        amplitude_a=st.floats(0.01, 100.0),
        period_s=st.sampled_from([0.5, 1.0, 2.0, 2.5]),
        periods=st.integers(1, 50),
        settle_s=st.floats(0.0, 5.0),
        **common,
    ),
    st.builds(
        Injection,
        target_d_a=amperes,
        target_q_a=amperes,
        settle_s=seconds,
        discard_s=st.floats(0.0, 1.0),
        duration_s=seconds,
        amplitude_v=st.floats(0.1, 300.0),
        frequency_hz=st.floats(10.0, 2000.0),
        rotation_hz=st.floats(0.0, 10.0),
        waveform=st.sampled_from(["square", "sine"]),
        **common,
    ),
)
CAPABILITIES = Capabilities(
    name="board 7",
    sampling_frequency_hz=FS,
    pwm_frequency_hz=8000.0,
    pwm_frequencies_hz=(4000.0, 8000.0, 16000.0),
    dc_bus_voltage_v=565.7,
    voltage_delay_samples=1.5,
    max_current_a=5.6,
    max_voltage_v=326.6,
    longest_capture_s=12.5,
    excitations=frozenset({"gates_off", "hold", "injection"}),
    watchdog_s=0.2,
    watchdog_covers=frozenset({"hold", "injection"}),
    has_brake=True,
    motor_name="400 W: sample",
)
FACTS = DriveFacts(
    bits=Capability.BRAKE | Capability.RIPPLE_ON_DRIVE,
    channels=VECTORS | Channel.V_DC,
    scales=Scales.spanning(12.0, 600.0, 800.0, 1.0),
    memory_bytes=65_536,
    ripple_rate_max_hz=500.0,
    ripple_memory_rows=4096,
)


def through_a_drive(values: dict[str, float]) -> RegisterFile:
    """Written one by one into a drive's file, as singles."""
    file = RegisterFile()
    for name, value in values.items():
        assert file.write(register_index(name), value, PowerState.DISARMED) is AckStatus.OK, (name, value)
    return file


@settings(deadline=None)
@given(excitations)
def test_an_excitation_comes_back_to_a_singles_precision(excitation: Excitation) -> None:
    back = program_of(through_a_drive(program_registers(excitation, FS)).values())
    assert type(back) is type(excitation)
    for (name, wanted), (_, held) in zip(excitation, back, strict=True):
        if name.endswith("_s") and name != "period_s":
            assert held == pytest.approx(wanted, rel=0.0, abs=0.5 / FS + 1e-6 * wanted)
        elif isinstance(wanted, float):
            assert held == pytest.approx(wanted, rel=1e-6)
        elif isinstance(wanted, CurrentControl):
            assert held.bandwidth_hz == pytest.approx(wanted.bandwidth_hz, rel=1e-6)
        else:
            assert held == wanted


@settings(deadline=None)
@given(excitations)
def test_both_ends_count_the_same_rows(excitation: Excitation) -> None:
    back = program_of(through_a_drive(program_registers(excitation, FS)).values())
    assert back.rows(FS) == excitation.rows(FS)


def test_registers_that_are_no_program_are_an_error() -> None:
    with pytest.raises(ValueError, match="duration_s"):
        program_of(RegisterFile().values())
    with pytest.raises(ValueError, match="current_a"):
        limits_of(RegisterFile().values())


def test_limits_nameplate_and_capture_settings_are_writable_registers() -> None:
    limits = Limits(current_a=4.0, voltage_v=200.0, duration_s=120.0)
    assert limits_of(through_a_drive(limit_registers(limits)).values()) == limits
    motor = Motor(name="m", pole_pairs=3, rated_current_rms_a=1.5, stator_resistance_ohm=4.5)
    values = through_a_drive(motor_registers(motor)).values()
    assert values["motor_rated_current_a"] == pytest.approx(motor.rated_current_a)
    assert values["motor_inductance_d_h"] == 0.0
    held = through_a_drive(capture_registers(VECTORS, ripple_periods=2)).values()
    assert (held["capture_mask"], held["ripple_periods"], held["ripple_live"]) == (15, 2, 0)


def test_capabilities_come_back_digit_by_digit() -> None:
    file = RegisterFile(capability_registers(CAPABILITIES, FACTS))
    description = {"name": "board 7", "motor": "400 W: sample"}
    assert capabilities_of(file.values(), description, 12.5) == CAPABILITIES
    assert facts_of(file.values()) == FACTS


def test_every_capability_register_is_within_the_table() -> None:
    for name, value in capability_registers(CAPABILITIES, FACTS).items():
        assert registers()[name].access == "read"
        assert registers()[name].refuses(value) is None, name


def test_another_major_version_is_refused_and_nonsense_is_wrong_data() -> None:
    file = RegisterFile(capability_registers(CAPABILITIES, FACTS))
    file["protocol_major"] = 2.0
    with pytest.raises(DriveRefused, match="version 2"):
        capabilities_of(file.values(), {}, None)
    values = dict(RegisterFile(capability_registers(CAPABILITIES, FACTS)).values())
    with pytest.raises(DriveFault, match="max_current_a: nan is not a number"):
        facts_of({**values, "max_current_a": float("nan")})
    with pytest.raises(DriveFault, match="watchdog_covers was not read"):
        capabilities_of({k: v for k, v in values.items() if k != "watchdog_covers"}, {}, None)
    with pytest.raises(DriveFault, match="registers are inconsistent") as caught:
        capabilities_of({**values, "max_current_a": 0.0}, {}, None)
    assert caught.value.cause is FaultCause.WRONG_DATA
    assert "\n" not in str(caught.value)


def test_a_description_is_lines_of_keys_and_values() -> None:
    assert parse_description(b"name: board 7\nmotor: 400 W: sample\nnonsense\n") == {
        "name": "board 7",
        "motor": "400 W: sample",
    }
    assert parse_description(b"\xff\xfe") == {}


@example(3.4025001647762064e38)
@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_shortest_decimal_is_the_same_single(value: float) -> None:
    import numpy as np

    assert np.float32(shortest_decimal(value)) == np.float32(value)


def test_a_fault_names_its_first_cause_and_what_followed() -> None:
    bits = 1 << Fault.OVERCURRENT | 1 << Fault.WATCHDOG
    fault = drive_fault(Fault.OVERCURRENT, 12.3, 9.0, bits)
    assert fault.cause is FaultCause.OVERCURRENT
    assert "12.3 A against 9 A" in str(fault)
    assert "then watchdog" in str(fault)
    assert {drive_fault(cause).cause for cause in Fault} <= set(FaultCause)
