"""A run played back is the run: same rows, same maps; what it does not hold is refused."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest

from orchestrator.engine import AbsentOperator, Interrupts, RunServices, start_run
from orchestrator.recording import Recording, open_recording
from plugins.drives.replay import ReplayDrive, ReplayOptions
from protocols import (
    Drive,
    DriveChoice,
    DriveFault,
    DriveRefused,
    DriveSetup,
    DriveState,
    FaultCause,
    GatesOff,
    Hold,
    Limits,
    RecordingError,
    ResumableDrive,
)
from tests.support.tiny import run_tiny, tiny_procedure


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    result = run_tiny(tmp_path_factory.mktemp("replay"))
    assert result.outcome.error is None
    return open_recording(result.path)


def replay_of(recording: Recording, *, real_time: bool = False) -> ReplayDrive:
    options = ReplayOptions(recording=recording.path, real_time=real_time)
    return ReplayDrive(DriveSetup(motor=recording.manifest.motor, options=options, seed=1))


def armed(recording: Recording, *, real_time: bool = False) -> ReplayDrive:
    drive = replay_of(recording, real_time=real_time)
    capabilities = drive.connect()
    drive.arm(Limits(current_a=capabilities.max_current_a, voltage_v=capabilities.max_voltage_v))
    return drive


def some_hold(recording: Recording, *, longer: float = 1.0) -> Hold:
    segment = next(s for s in recording.manifest.segments if s.stage.value == "resistance")
    seconds = segment.samples / recording.manifest.drive.sampling_frequency_hz
    return Hold(
        current_d_a=segment.settings["current_d_a"],
        current_q_a=segment.settings["current_q_a"],
        settle_s=0.1,
        duration_s=longer * seconds,
        rotor_angle_rad=segment.rotor_angle_rad,
    )


@pytest.mark.slow
def test_it_is_a_drive_that_can_be_resumed(original: Recording) -> None:
    drive = replay_of(original)
    assert isinstance(drive, Drive)
    assert isinstance(drive, ResumableDrive)


def test_the_procedure_played_back_gives_the_same_rows(original: Recording, tmp_path: Path) -> None:
    procedure = tiny_procedure(tmp_path)
    choice = DriveChoice.model_validate({"name": "replay", "recording": str(original.path)})
    result = start_run(
        procedure.model_copy(update={"drive": choice}), tmp_path / "again", RunServices(AbsentOperator(), Interrupts())
    )
    assert result.outcome.error is None, result.outcome.reason
    again = open_recording(tmp_path / "again")
    assert [s.id for s in again.segments()] == [s.id for s in original.segments()]
    for ours, theirs in zip(again.segments(), original.segments(), strict=True):
        assert ours.start_s == pytest.approx(theirs.start_s, abs=1e-9)
        np.testing.assert_array_equal(again.load(ours).i_ab, original.load(theirs).i_ab)
        np.testing.assert_array_equal(again.load(ours).v_ab, original.load(theirs).v_ab)


def test_what_the_recording_does_not_hold_is_refused(original: Recording) -> None:
    drive = armed(original)
    hold = some_hold(original)
    for change, message in (
        ({"current_d_a": hold.current_d_a + 0.1}, "holds no hold"),
        ({"rotor_angle_rad": hold.rotor_angle_rad + math.pi / 3}, "holds no hold"),
        ({"pwm_frequency_hz": 1234.0}, "PWM frequency 1234 Hz"),
        ({"duration_s": 1e3}, "holds no hold"),
        ({"current_d_a": math.nan}, "current_d_a is not a finite number"),
    ):
        with pytest.raises(DriveRefused, match=message):
            list(drive.execute(hold.model_copy(update=change)))


def test_a_limit_below_what_was_recorded_is_kept(original: Recording) -> None:
    drive = replay_of(original)
    drive.connect()
    drive.arm(Limits(current_a=0.01, voltage_v=100.0))
    with pytest.raises(DriveRefused, match="above the limit"):
        list(drive.execute(some_hold(original)))


def test_nothing_is_played_before_arming_and_after_disarming(original: Recording) -> None:
    drive = replay_of(original)
    drive.connect()
    with pytest.raises(DriveRefused, match="not armed"):
        list(drive.execute(some_hold(original)))
    drive.arm(Limits(current_a=9.0, voltage_v=200.0))
    list(drive.execute(some_hold(original)))
    assert abs(drive.telemetry().i_d_a) > 0.0
    drive.disarm()
    assert drive.telemetry().state is DriveState.DISARMED
    assert drive.telemetry().i_d_a == 0.0


def test_a_silent_host_ends_the_playing_and_latches(original: Recording) -> None:
    drive = armed(original)
    list(drive.execute(some_hold(original)))
    time.sleep(0.3)
    with pytest.raises(DriveFault) as fault:
        list(drive.execute(some_hold(original)))
    assert fault.value.cause is FaultCause.HEARTBEAT_LOST
    assert drive.telemetry().state is DriveState.FAULTED
    with pytest.raises(DriveRefused, match="latched"):
        drive.arm(Limits(current_a=1.0, voltage_v=10.0))
    drive.clear_fault()
    assert drive.telemetry().state is DriveState.DISARMED


def test_real_time_takes_as_long_as_the_measurement(original: Recording) -> None:
    drive = armed(original, real_time=True)
    hold = some_hold(original)
    began = time.monotonic()
    for _ in drive.execute(hold):
        drive.heartbeat()
    assert time.monotonic() - began >= hold.duration_s


def test_a_recording_that_is_not_there_is_one_clear_error(tmp_path: Path, original: Recording) -> None:
    drive = ReplayDrive(
        DriveSetup(motor=original.manifest.motor, options=ReplayOptions(recording=tmp_path / "none"), seed=1)
    )
    with pytest.raises(RecordingError, match="no such directory"):
        drive.connect()


def test_gates_off_is_played_where_it_was_recorded(original: Recording) -> None:
    held = [s for s in original.manifest.segments if s.stage.value == "gates_off"]
    drive = armed(original)
    reading = GatesOff(duration_s=0.01)
    if held:
        assert len(next(iter(drive.execute(reading)))) > 0
    else:
        with pytest.raises(DriveRefused):
            drive.execute(reading)
