"""What the drive `vesc` does where board, line or configuration are not as they should be."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from plugins.drives.vesc import VescDrive, VescOptions
from plugins.drives.vesc._link import Link
from plugins.drives.vesc._packets import Command
from plugins.drives.vesc._rows import ANGLE_STEP_RAD, TONE_TABLE, tone, turning_frame, window
from protocols import DriveFault, DriveRefused, DriveSetup, FaultCause, GatesOff, Hold, Injection, Limits, Motor
from tests.plugins.drives.vesc.emulator import Firmware, on_a_line, on_tcp

MOTOR = Motor(name="48 V servo", pole_pairs=7, rated_current_rms_a=5.0, stator_resistance_ohm=0.2)
LIMITS = Limits(current_a=8.0, voltage_v=10.0)
HOLD = Hold(current_d_a=4.0, current_q_a=0.0, settle_s=0.05, duration_s=0.05)


@pytest.fixture(autouse=True)
def _a_quick_console(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is tried here is no matter of the console's pace; the kit and the runs keep it."""
    monkeypatch.setattr("plugins.drives.vesc._board.CONSOLE_PERIOD_S", 0.04)
    monkeypatch.setattr("tests.plugins.drives.vesc.emulator.DEAF_S", 0.03)


def drive_at(port: str, **options: Any) -> VescDrive:
    return VescDrive(DriveSetup(motor=MOTOR, options=VescOptions(port=port, **options), seed=1))


@contextmanager
def armed(port: str, watchdog_s: float = 2.0) -> Iterator[VescDrive]:
    """A drive with a beating heart."""
    drive, done = drive_at(port, watchdog_s=watchdog_s), threading.Event()
    drive.connect()

    def beat() -> None:
        while not done.wait(0.05):
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


def whole(drive: VescDrive, excitation: Any) -> np.ndarray:
    blocks = [block for block in drive.execute(excitation) if len(block)]
    return np.concatenate([np.hstack([block.i_ab, block.v_ab]) for block in blocks])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motor-type": 0}, "motor type"),
        ({"foc-sensor-mode": 4}, "HFI"),
        ({"m-invert-direction": 1}, "inverted"),
        ({"l-current-max-scale": 0.0}, "current limits"),
    ],
)
def test_a_configuration_that_does_not_fit_is_refused(change: dict[str, float], message: str) -> None:
    with on_a_line(lambda firmware: firmware.configuration.update(change)) as (_, port):
        drive = drive_at(port)
        with pytest.raises(DriveRefused, match=message):
            drive.connect()
        drive.close()


def test_an_old_firmware_is_refused_with_the_version_that_is_needed() -> None:
    with on_a_line(lambda firmware: setattr(firmware, "version", (6, 5))) as (_, port):
        drive = drive_at(port)
        with pytest.raises(DriveRefused, match=r"6\.05 of '60_MK6', 6\.06 or newer"):
            drive.connect()
        drive.close()


def test_limits_and_timeout_are_the_boards_own_for_the_run_and_put_back() -> None:
    with on_tcp() as (firmware, port), armed(port) as drive:
        before = Firmware().configuration
        assert firmware.configuration["l-current-max-scale"] == pytest.approx(0.4)
        assert firmware.configuration["l-abs-current-max"] == pytest.approx(12.0)
        assert firmware.configuration["timeout-msec"] == 2000
        rows = whole(drive, HOLD)
        assert rows[:, :2].mean(axis=0) == pytest.approx([4.0, 0.0], abs=0.03)
        assert rows[:, 2:].mean(axis=0) == pytest.approx([0.8, 0.0], abs=0.01)
        drive.disarm()
        assert firmware.configuration == before
        assert not firmware.running


def test_a_fault_of_the_board_trips_and_stays() -> None:
    with on_a_line() as (firmware, port), armed(port) as drive:
        whole(drive, HOLD)
        firmware.trip(4)
        with pytest.raises(DriveFault) as fault:
            whole(drive, HOLD)
        assert fault.value.cause is FaultCause.OVERCURRENT
        with pytest.raises(DriveRefused, match="latched"):
            drive.arm(LIMITS)


def test_a_current_that_the_board_does_not_hold_is_a_fault() -> None:
    with on_a_line() as (firmware, port), armed(port) as drive:
        firmware.configuration["l-current-max-scale"] = 0.05
        with pytest.raises(DriveFault, match="limits or has released it"):
            whole(drive, HOLD)


def test_time_in_which_the_host_was_suspended_is_no_silence_of_the_board(monkeypatch: pytest.MonkeyPatch) -> None:
    readings = count()
    # Ten seconds pass between any two readings of the clock: in none of them did this process run.
    clock = SimpleNamespace(monotonic=lambda: 10.0 * next(readings))
    with on_tcp() as (_, port):
        link = Link(port, 115200)
        monkeypatch.setattr("plugins.link._timeouts.time", clock)
        link.send(bytes([Command.FW_VERSION]))
        assert link.take(Command.FW_VERSION, 1.0) is not None
        link.close()


def test_a_row_that_is_lost_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plugins.drives.vesc.drive.MAX_UPLOAD_S", 0.5)
    with on_a_line() as (firmware, port), armed(port) as drive:
        firmware.drops_row = 17
        with pytest.raises(DriveFault, match="rows of"):
            whole(drive, HOLD)
        assert not firmware.running


def test_a_board_that_falls_silent_is_a_lost_link_and_its_own_timeout_lets_go() -> None:
    with on_a_line() as (firmware, port), armed(port, watchdog_s=0.3) as drive:
        whole(drive, HOLD)
        assert firmware.running
        firmware.deaf = True
        with pytest.raises(DriveFault) as fault:
            whole(drive, HOLD)
        assert fault.value.cause is FaultCause.LINK_LOST
        deadline = time.monotonic() + 1.0
        while firmware.running and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not firmware.running


def test_gates_off_shows_what_the_sensors_show() -> None:
    with on_a_line() as (firmware, port), armed(port) as drive:
        whole(drive, HOLD)
        rows = whole(drive, GatesOff(duration_s=0.05))
        assert not firmware.running
        assert not rows[:, 2:].any()
        assert 0.0 < np.abs(rows[:, :2]).max() < 0.2


@pytest.mark.parametrize(
    ("excitation", "message"),
    [
        (HOLD.model_copy(update={"current_d_a": 0.02}), "releases below"),
        (HOLD.model_copy(update={"duration_s": 1.0}), "longer"),
        (
            Injection(
                target_d_a=0.0,
                target_q_a=0.0,
                settle_s=0.1,
                duration_s=0.05,
                amplitude_v=1.0,
                frequency_hz=400.0,
                rotation_hz=2.0,
                waveform="sine",
            ),
            "no whole turn",
        ),
    ],
)
def test_what_it_cannot_is_refused_before_anything_moves(excitation: Any, message: str) -> None:
    with on_a_line() as (firmware, port), armed(port) as drive:
        with pytest.raises(DriveRefused, match=message):
            whole(drive, excitation)
        assert not firmware.running


def test_nobody_at_the_port_is_a_lost_link() -> None:
    drive = drive_at("/dev/pts/nobody")
    with pytest.raises(DriveFault, match="VESC at"):
        drive.connect()
    drive.close()


# Rows


def _rows(phase: np.ndarray) -> Any:
    rows = np.zeros(len(phase), np.dtype([("phase", "u1")]))
    rows["phase"] = phase
    return rows


@pytest.mark.parametrize("first_rad", [0.0, 1.234, 6.2])
def test_the_frame_is_found_finer_than_its_octets(first_rad: float) -> None:
    angle = first_rad + 2.0 * np.pi * 20.0 / 8000.0 * np.arange(1000)
    octets = (angle % (2.0 * np.pi) / ANGLE_STEP_RAD).astype(int)
    octets[:37] = 12
    found, begin = turning_frame(_rows(octets), 20.0, 1.0 / 8000.0)
    assert np.abs(np.angle(np.exp(1j * (found - angle)))).max() < 0.1 * ANGLE_STEP_RAD
    assert 30 <= begin <= 37


def test_a_frame_that_stands_still_is_reported() -> None:
    with pytest.raises(DriveFault, match="does not rotate"):
        turning_frame(_rows(np.full(1000, 3)), 20.0, 1.0 / 8000.0)


def test_a_tones_first_row_is_one_step_into_its_wave() -> None:
    place, v = tone(100, 250.0, 3.0, 1.0 / 8000.0)
    assert place[:3] * 32 == pytest.approx([1.0, 2.0, 3.0])
    assert v[:3] == pytest.approx(3j * TONE_TABLE[1:4])


@pytest.mark.parametrize(("direction", "phase"), [(0.0, 0.0), (2.0, 0.3), (-1.0, 0.9)])
def test_a_window_begins_where_direction_and_wave_are_those_requested(direction: float, phase: float) -> None:
    k = np.arange(1000)
    angle, place = 0.4 + 2.0 * np.pi * k / 600, (k / 20) % 1.0
    at = window(angle, place, direction, phase, 100, 400, 1 / 20)
    vector = np.exp(1j * angle[at]) * np.sin(2.0 * np.pi * place[at])
    expected = np.exp(1j * direction) * np.sin(2.0 * np.pi * phase)
    assert 100 <= at <= 400
    assert abs(vector - expected) < 0.2
