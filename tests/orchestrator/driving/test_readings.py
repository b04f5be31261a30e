"""What no drive can read is a fault of the drive with one line; what poor drives read is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from orchestrator.driving.readings import ReadingCheck, check_telemetry
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveState,
    Excitation,
    FaultCause,
    GatesOff,
    Hold,
    Limits,
    Telemetry,
    Trapezoid,
    VoltageSteps,
)

FS, BUS_V, ROWS = 1000.0, 300.0, 400
OWN = Capabilities(
    name="any drive",
    sampling_frequency_hz=FS,
    pwm_frequency_hz=8000.0,
    pwm_frequencies_hz=(8000.0,),
    dc_bus_voltage_v=BUS_V,
    max_current_a=10.0,
    max_voltage_v=170.0,
    excitations=frozenset({"hold"}),
    watchdog_s=None,
)
LIMITS = Limits(current_a=4.5, voltage_v=150.0)
HOLD = Hold(current_d_a=2.0, current_q_a=0.0, settle_s=0.1, duration_s=0.4)
SWEEP = Trapezoid(swept_axis="q", amplitude_a=4.0, held_a=0.0, period_s=0.4, periods=1, settle_s=0.1)
STEPS = VoltageSteps(voltage_d_v=40.0, turn_d_a=2.0, settle_s=0.1, duration_s=0.4)


def block(start_s: float = 1.0, **changes: Any) -> Capture:
    """Sweeping currents and the voltages of 4 ohm, with some noise."""
    noise = np.random.default_rng(1).normal(0.0, 0.01, (ROWS, 2))
    i = 4.0 * np.column_stack((np.zeros(ROWS), np.sin(2.0 * np.pi * np.arange(ROWS) / ROWS))) + noise
    fields: dict[str, Any] = {"i_ab": i, "v_ab": 4.25 * i, "v_dc": np.full(ROWS, BUS_V)}
    return Capture(start_s=start_s, sampling_frequency_hz=FS, **(fields | changes))


def require(*blocks: Capture, excitation: Excitation = SWEEP, own: Capabilities = OWN, times: Any = None) -> None:
    """All of a point's blocks, which arrive as fast as they were captured unless `times` has the host's own."""
    arrivals = iter(times or [b.start_s for b in blocks])
    check = ReadingCheck(own, LIMITS, lambda: next(arrivals))
    check.begin("sweep-000", excitation)
    for one in blocks:
        check.check(one)
    check.conclude()


def in_steps(step_v: float) -> Capture:
    honest = block()
    return block(v_ab=step_v * np.round(honest.v_ab / step_v))


def spike(name: str, value: float) -> Capture:
    column = np.array(getattr(block(), name))
    column[ROWS // 2] = value
    changes: dict[str, Any] = {name: column}
    return block(**changes)


@pytest.mark.parametrize(
    ("blocks", "cause", "message"),
    [
        ([spike("i_ab", 7.0)], FaultCause.OVERCURRENT, r"9\.9 A measured, the limit is 4\.5 A, and the drive went on"),
        ([spike("i_ab", np.nan)], FaultCause.OVERCURRENT, "nan A measured"),
        ([spike("v_ab", 2.1e6)], FaultCause.WRONG_DATA, r"2\.97e\+06 V at the motor, from a bus of 300 V"),
        ([spike("v_ab", 1e302)], FaultCause.WRONG_DATA, r"1\.414e\+302 V at the motor"),
        ([spike("v_ab", -np.inf)], FaultCause.WRONG_DATA, "inf V at the motor"),
        ([spike("v_dc", 2.1e6)], FaultCause.WRONG_DATA, r"a bus of 2\.1e\+06 V; the drive has one of 300 V"),
        ([spike("v_dc", 3.0)], FaultCause.WRONG_DATA, "a bus of 3 V"),
        ([spike("v_dc", np.nan)], FaultCause.WRONG_DATA, "a bus of nan V"),
        ([block(temperature_c=np.full(ROWS, 1e4))], FaultCause.WRONG_DATA, r"1e\+04 degrees"),
        ([in_steps(10.0)], FaultCause.WRONG_DATA, r"steps of 10 V, 3\.3 % of the bus voltage"),
        ([block(-166_999.0)], FaultCause.WRONG_DATA, "its clock stands at -166999 s, before the experiment's begin"),
        ([block(np.nan)], FaultCause.WRONG_DATA, "its clock stands at nan s"),
        ([block(10.0), block(3.0)], FaultCause.WRONG_DATA, r"its clock went back by 7\.4 s"),
    ],
)
def test_each_impossible_reading_is_a_fault_with_the_point_and_one_line(
    blocks: list[Capture], cause: FaultCause, message: str
) -> None:
    with pytest.raises(DriveFault, match=message) as fault:
        require(*blocks)
    assert fault.value.cause is cause
    assert fault.value.detail.startswith("sweep-000: ")
    assert "\n" not in str(fault.value)


def test_a_clock_ahead_of_the_hosts_is_believed_of_a_simulation_alone() -> None:
    blocks, times = [block(0.0), block(500.0)], [0.4, 2.0]
    require(*blocks, own=OWN.model_copy(update={"clock_is_simulated": True}), times=times)
    with pytest.raises(DriveFault, match=r"its clock jumped by 499\.6 s within 1\.6 s"):
        require(*blocks, times=times)


def switched(levels: int) -> Capture:
    """A voltage that is switched while the current moves."""
    return block(v_ab=np.repeat(np.linspace(-40.0, 40.0, levels), -(-ROWS // levels))[:ROWS, None] * [1.0, 0.0])


@pytest.mark.parametrize(
    ("capture", "excitation"),
    [
        (block(), SWEEP),
        (in_steps(0.5), SWEEP),
        (switched(2), HOLD),
        (switched(3), STEPS),
        (block(v_ab=np.zeros((ROWS, 2))), HOLD),
        (block(v_dc=np.zeros(ROWS), v_ab=np.zeros((ROWS, 2))), GatesOff(duration_s=0.4)),
        (block(v_dc=np.linspace(0.6, 1.3, ROWS) * BUS_V), SWEEP),
        (block(v_ab=block().v_ab * 11.0), SWEEP),
    ],
)
def test_what_a_poor_drive_reads_is_believed(capture: Capture, excitation: Excitation) -> None:
    require(capture, excitation=excitation)


@pytest.mark.parametrize(
    ("changes", "cause", "message"),
    [
        ({"v_dc_v": 2.1e6}, FaultCause.WRONG_DATA, r"any drive reads a bus of 2\.1e\+06 V; it has one of 300 V"),
        ({"v_dc_v": -5.0}, FaultCause.WRONG_DATA, "reads a bus of -5 V"),
        ({"i_q_a": 30.0}, FaultCause.OVERCURRENT, r"30 A measured, the limit is 4\.5 A"),
    ],
)
def test_telemetry_that_no_drive_has_is_a_fault(changes: dict[str, float], cause: FaultCause, message: str) -> None:
    honest = {"state": DriveState.ARMED, "time_s": 1.0, "i_d_a": 0.0, "i_q_a": 0.0, "v_dc_v": BUS_V}
    assert check_telemetry(Telemetry.model_validate(honest), OWN, LIMITS).v_dc_v == BUS_V
    with pytest.raises(DriveFault, match=message) as fault:
        check_telemetry(Telemetry.model_validate(honest | changes), OWN, LIMITS)
    assert fault.value.cause is cause
