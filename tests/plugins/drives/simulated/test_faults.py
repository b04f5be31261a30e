"""Every way in which the drive can fail, and what is left of it afterwards."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest

from plugins.drives.simulated import SimulatedDrive
from plugins.drives.simulated import _state as layout
from protocols import DriveFault, DriveRefused, DriveState, FaultCause, Hold, Limits
from tests.plugins.drives.simulated.conftest import Bench

HOLD = Hold(current_d_a=1.0, current_q_a=1.0, settle_s=0.2, duration_s=2.0)
LIMITS = Limits(current_a=3.0, voltage_v=100.0)


def failing(bench: Bench, kind: str, **more: Any) -> SimulatedDrive:
    return bench(faults=[{"kind": kind, "at_excitation": 2, "after_s": 0.9, **more}])


def run_twice(drive: SimulatedDrive) -> DriveFault:
    """The first excitation is whole; the second fails after its first block; returns the fault."""
    assert sum(map(len, drive.execute(HOLD))) == 20_000
    running = drive.execute(HOLD)
    assert len(next(running)) == 5_000
    with pytest.raises(DriveFault) as caught:
        next(running)
    return caught.value


def true_length(drive: SimulatedDrive) -> float:
    x = drive._plant.memory.state
    return math.hypot(x[layout.I_ALPHA], x[layout.I_BETA])


def test_a_lost_link_stays_lost(bench: Bench) -> None:
    drive = failing(bench, "lost_link")
    assert run_twice(drive).cause is FaultCause.LINK_LOST
    for call in (drive.ramp_down, drive.disarm, drive.telemetry, drive.clear_fault, lambda: drive.arm(LIMITS)):
        with pytest.raises(DriveFault) as caught:
            call()
        assert caught.value.cause is FaultCause.LINK_LOST
    drive.heartbeat()
    drive.close()


def test_a_stuck_drive_is_given_up_and_can_be_ramped_down(bench: Bench) -> None:
    drive = failing(bench, "stuck", timeout_s=0.05)
    started = time.monotonic()
    assert run_twice(drive).cause is FaultCause.NO_ANSWER
    assert time.monotonic() - started >= 0.05
    drive.ramp_down()
    drive.disarm()
    assert drive.telemetry().state is DriveState.DISARMED


def test_a_slow_drive_hands_over_all_the_same(bench: Bench) -> None:
    drive = failing(bench, "slow", sleep_s=0.05)
    list(drive.execute(HOLD))
    started = time.monotonic()
    assert sum(map(len, drive.execute(HOLD))) == 20_000
    assert time.monotonic() - started >= 0.05


@pytest.mark.parametrize("data", ["nan", "huge", "shape", "gap"])
def test_wrong_data_is_handed_over_as_a_bad_link_would(bench: Bench, data: str) -> None:
    drive = failing(bench, "wrong_data", data=data)
    list(drive.execute(HOLD))
    blocks = list(drive.execute(HOLD))
    bad = blocks[1]
    match data:
        case "nan":
            assert np.isnan(bad.i_ab).any()
        case "huge":
            assert np.abs(bad.i_ab).max() > 1e20
        case "shape":
            assert len(bad.i_ab) != len(bad.v_ab)
        case "gap":
            assert bad.start_s - blocks[0].start_s != pytest.approx(0.5)
    assert all(np.isfinite(b.i_ab).all() for b in (blocks[0], *blocks[2:]))


def test_a_trip_in_the_middle_is_latched_until_cleared(bench: Bench) -> None:
    drive = failing(bench, "trip", cause="bus_voltage")
    assert run_twice(drive).cause is FaultCause.BUS_VOLTAGE
    assert drive.telemetry().faults == ("bus_voltage",)
    assert drive.telemetry().state is DriveState.FAULTED
    assert true_length(drive) < 1e-3
    with pytest.raises(DriveRefused, match="latched"):
        drive.arm(LIMITS)
    with pytest.raises(DriveRefused, match="not armed"):
        drive.execute(HOLD)
    drive.ramp_down()
    drive.disarm()
    assert drive.telemetry().state is DriveState.FAULTED
    drive.clear_fault()
    drive.arm(LIMITS)
    assert sum(map(len, drive.execute(HOLD))) == 20_000


def test_a_bug_of_the_plugin_surfaces_as_one(bench: Bench) -> None:
    drive = failing(bench, "exception")
    list(drive.execute(HOLD))
    with pytest.raises(RuntimeError):
        list(drive.execute(HOLD))


def test_a_fault_may_strike_at_a_time_and_strikes_once(bench: Bench) -> None:
    drive = bench(faults=[{"kind": "trip", "at_s": 3.0}])
    list(drive.execute(HOLD))
    with pytest.raises(DriveFault):
        list(drive.execute(HOLD))
    assert drive.telemetry().time_s == pytest.approx(3.02, abs=1e-9)  # and the diodes' 20 ms
    drive.clear_fault()
    drive.arm(LIMITS)
    assert sum(map(len, drive.execute(HOLD))) == 20_000


def test_overcurrent_switches_off_at_once(bench: Bench) -> None:
    """A sensor that reads too much is all it takes: the trip judges by the reading."""
    drive = bench(effects={"current_offset": {"offset_a_a": 0.9}}, armed=False)
    drive.arm(Limits(current_a=0.7, voltage_v=100.0))
    with pytest.raises(DriveFault) as caught:
        list(drive.execute(HOLD.model_copy(update={"current_d_a": 0.5, "current_q_a": 0.4})))
    assert caught.value.cause is FaultCause.OVERCURRENT
    assert drive.telemetry().faults == ("overcurrent",)
    assert true_length(drive) < 1e-3


def test_overload_trips_after_its_time(bench: Bench) -> None:
    drive = bench(overload_s=0.5)
    with pytest.raises(DriveFault) as caught:
        list(drive.execute(Hold(current_d_a=0.0, current_q_a=4.0, settle_s=0.1, duration_s=5.0)))
    assert caught.value.cause is FaultCause.OVERTEMPERATURE
    assert 0.2 < drive.telemetry().time_s < 0.5


def test_without_a_heartbeat_the_drive_makes_itself_safe(bench: Bench) -> None:
    drive = bench(watchdog_s=0.05)
    running = drive.execute(HOLD)
    next(running)
    time.sleep(0.08)
    with pytest.raises(DriveFault) as caught:
        next(running)
    assert caught.value.cause is FaultCause.HEARTBEAT_LOST
    reading = drive.telemetry()
    assert (reading.state, reading.faults) == (DriveState.FAULTED, ("heartbeat_lost",))
    assert true_length(drive) < 1e-3
    with pytest.raises(DriveRefused):
        drive.arm(LIMITS)


def test_with_heartbeats_it_goes_on_and_it_counts_from_arming(bench: Bench) -> None:
    drive = bench(watchdog_s=0.1, armed=False)
    time.sleep(0.12)
    drive.arm(LIMITS)
    running = drive.execute(HOLD)
    for _ in range(3):
        next(running)
        time.sleep(0.06)
        drive.heartbeat()
    assert drive.telemetry().state is DriveState.ARMED


def test_a_silent_host_is_noticed_between_excitations_too(bench: Bench) -> None:
    drive = bench(watchdog_s=0.05)
    list(drive.execute(HOLD.model_copy(update={"duration_s": 0.1})))
    time.sleep(0.08)
    assert drive.telemetry().state is DriveState.FAULTED
    with pytest.raises(DriveRefused, match="not armed"):
        drive.execute(HOLD)


def test_a_watched_run_keeps_the_pace_it_was_given(bench: Bench) -> None:
    drive = bench(realtime_factor=20.0)
    started = time.monotonic()
    list(drive.execute(HOLD))
    assert time.monotonic() - started == pytest.approx(0.1, abs=0.05)
