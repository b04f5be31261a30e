"""What the drive `odrive` does where board, line or configuration are not as they should be."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plugins.drives.odrive import OdriveDrive, OdriveOptions
from plugins.drives.odrive._properties import Properties
from protocols import DriveFault, DriveRefused, DriveSetup, FaultCause, Hold, Limits, Motor
from tests.plugins.drives.odrive.emulator import Board, on_a_line, on_tcp

MOTOR = Motor(name="D5065", pole_pairs=7, rated_current_rms_a=8.0, stator_resistance_ohm=0.2)
LIMITS = Limits(current_a=10.0, voltage_v=10.0)
HOLD = Hold(current_d_a=3.0, current_q_a=4.0, settle_s=0.02, duration_s=0.05, rotor_angle_rad=0.5)


def drive_at(port: str, **options: Any) -> OdriveDrive:
    options = {"sampling_frequency_hz": 100.0, "watchdog_s": 2.0, **options}
    return OdriveDrive(DriveSetup(motor=MOTOR, options=OdriveOptions(port=port, **options), seed=1))


@contextmanager
def armed(port: str, **options: Any) -> Iterator[OdriveDrive]:
    """A drive with a beating heart."""
    drive, done = drive_at(port, **options), threading.Event()
    drive.connect()

    def beat() -> None:
        while not done.wait(0.02):
            drive.heartbeat()

    thread = threading.Thread(target=beat, daemon=True)
    thread.start()
    try:
        drive.arm(LIMITS)
        yield drive
    finally:
        done.set()
        thread.join()
        drive.close()


def whole(drive: OdriveDrive) -> np.ndarray:
    blocks = [block for block in drive.execute(HOLD) if len(block)]
    return np.concatenate([np.hstack([block.i_ab, block.v_ab]) for block in blocks])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fw_version_minor": 6}, "firmware 0.6.6, 0.5 is needed"),
        ({"axis0.motor.config.motor_type": 2}, "motor_type"),
        ({"axis0.motor.is_calibrated": 0}, "not calibrated"),
        ({"axis0.encoder.is_ready": 0}, "encoder is not calibrated"),
        ({"axis0.motor.config.torque_constant": 0.0}, "torque_constant"),
        ({"axis0.motor.config.pole_pairs": 4}, "pole_pairs is 4"),
        ({"axis0.current_state": 8}, "not idle"),
    ],
)
def test_a_configuration_that_does_not_fit_is_refused(change: dict[str, float], message: str) -> None:
    with on_a_line(lambda board: board.values.update(change)) as (_, port):
        drive = drive_at(port)
        with pytest.raises(DriveRefused, match=message):
            drive.connect()
        drive.close()


def test_time_in_which_the_host_was_suspended_is_no_silence_of_the_board(monkeypatch: pytest.MonkeyPatch) -> None:
    suspended_s = 0.0
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + suspended_s)
    monkeypatch.setattr("plugins.link._timeouts.time", clock)
    with on_tcp() as (board, port):
        line = Properties(port, 115200)
        read = line.read_bytes

        def read_after_a_suspension(wait_s: float) -> bytes:
            nonlocal suspended_s
            suspended_s += 10.0
            return read(wait_s) if suspended_s > 20.0 else b""

        monkeypatch.setattr(line, "read_bytes", read_after_a_suspension)
        assert line.read(["vbus_voltage"]) == [board.values["vbus_voltage"]]
        line.close()


@pytest.mark.parametrize("bus_v", [float("nan"), float("inf"), -3.0, 0.0])
def test_a_bus_voltage_that_is_none_is_the_boards_fault_in_one_line(bus_v: float) -> None:
    with on_a_line(lambda board: board.values.update(vbus_voltage=bus_v)) as (_, port):
        drive = drive_at(port)
        with pytest.raises(DriveFault, match=f"reads a bus of {bus_v:g} V$") as fault:
            drive.connect()
        drive.close()
    assert fault.value.cause is FaultCause.BUS_VOLTAGE


@pytest.mark.parametrize("limit_a", [float("nan"), float("inf"), -1.0])
def test_a_capability_that_cannot_be_is_the_boards_fault_in_one_line(limit_a: float) -> None:
    with on_a_line(lambda board: board.values.update({"axis0.motor.config.current_lim": limit_a})) as (_, port):
        drive = drive_at(port)
        with pytest.raises(DriveFault, match="odrive gave an impossible value: max_current_a: Input should") as fault:
            drive.connect()
        drive.close()
    assert fault.value.cause is FaultCause.WRONG_DATA
    assert "\n" not in str(fault.value)


def test_a_current_points_where_it_is_wanted_and_the_board_is_left_as_it_was() -> None:
    with on_tcp() as (board, port), armed(port) as drive:
        rows = whole(drive)
        i = complex(*rows[:, :2].mean(axis=0))
        assert abs(i) == pytest.approx(5.0, abs=0.03)
        assert abs(np.angle(i / np.exp(0.5j) / (3.0 + 4.0j))) < 0.05
        assert complex(*rows[:, 2:].mean(axis=0)) == pytest.approx(0.2 * i, abs=0.01)
        assert board.values["axis0.motor.config.current_lim"] == 10.0
        drive.disarm()
        assert not board.armed
        before = Board().values
        assert board.values == pytest.approx(before, abs=1e-5)


def test_an_error_of_the_board_trips_and_stays() -> None:
    with on_a_line() as (board, port), armed(port) as drive:
        whole(drive)
        board.trip(".motor", 1 << 12)
        with pytest.raises(DriveFault, match="motor 0x1000"):
            whole(drive)
        with pytest.raises(DriveRefused, match="latched"):
            drive.arm(LIMITS)


def test_errors_of_before_stay_unless_somebody_has_seen_to_them() -> None:
    with on_a_line(lambda board: board.trip(".motor", 4)) as (board, port):
        drive = drive_at(port)
        drive.connect()
        with pytest.raises(DriveRefused, match="latched"):
            drive.arm(LIMITS)
        drive.close()
        seen = drive_at(port, clear_fault=True)
        seen.connect()
        assert board.values["axis0.motor.error"] == 0
        seen.close()


def test_a_board_that_limits_the_current_is_a_fault() -> None:
    with on_a_line() as (board, port), armed(port) as drive:
        board.values["axis0.motor.config.current_lim"] = 1.0
        with pytest.raises(DriveFault, match="limits it"):
            whole(drive)
        assert not board.armed


def test_a_rotor_that_gives_way_under_the_current_is_a_fault() -> None:
    with on_a_line() as (board, port), armed(port) as drive:
        under_way = drive.execute(HOLD)
        next(under_way)
        board.counts += 200
        with pytest.raises(DriveFault, match="the rotor has turned"):
            list(under_way)
        assert not board.armed


def test_a_slow_line_says_that_readings_come_late() -> None:
    with on_a_line() as (board, port), armed(port) as drive:
        board.slow_s = 0.02
        with pytest.raises(DriveFault, match="lower sampling_frequency_hz"):
            whole(drive)


def test_a_silent_board_is_a_lost_link_and_its_watchdog_disarms() -> None:
    with on_a_line() as (board, port), armed(port, watchdog_s=0.4) as drive:
        whole(drive)
        board.mute = True
        with pytest.raises(DriveFault) as fault:
            whole(drive)
        assert fault.value.cause is FaultCause.LINK_LOST
        deadline = time.monotonic() + 1.5
        while board.armed and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not board.armed


def test_a_property_that_is_not_there_is_a_fault() -> None:
    with on_a_line() as (_, port):
        line = Properties(port, 115200)
        with pytest.raises(DriveFault, match="'invalid property'"):
            line.read(["vbus_voltage", "axis0.nothing"])
        line.close()


@settings(max_examples=15, deadline=None)
@given(st.floats(-900.0, 9000.0))
def test_numbers_survive_a_board_that_cuts_them_after_nine_letters(value: float) -> None:
    with on_a_line() as (board, port):
        line = Properties(port, 115200)
        line.write({"axis0.encoder.config.phase_offset_float": value})
        assert board.values["axis0.encoder.config.phase_offset_float"] == pytest.approx(value, rel=1e-4, abs=1e-4)
        line.close()
