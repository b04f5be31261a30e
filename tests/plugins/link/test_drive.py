"""What a host does with a drive behind a link, on every kind of link: arming, programs, faults, ways out."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest

from plugins.wire import (
    PROTOCOL_MAJOR,
    Ack,
    AckStatus,
    Capability,
    Command,
    Conversation,
    EStop,
    Fault,
    Op,
    ParameterWrite,
    PowerState,
    ReadBlock,
    decode,
    encode,
)
from protocols import (
    CurrentControl,
    Drive,
    DriveFault,
    DriveRefused,
    DriveState,
    Excitation,
    FaultCause,
    GatesOff,
    Hold,
    Injection,
    Limits,
    ResumableDrive,
    Trapezoid,
)
from tests.plugins.link.bench import LIMITS, LINKS, armed, beating, bench, taken
from tests.plugins.link.device import FS, Script, waveforms
from tests.support.cases import few

HOLD = Hold(current_d_a=1.0, current_q_a=0.5, settle_s=0.3, duration_s=1.0, rotor_angle_rad=0.4)
INJECTION = Injection(
    target_d_a=0.5,
    target_q_a=-1.0,
    settle_s=0.3,
    discard_s=0.05,
    duration_s=1.0,
    amplitude_v=10.0,
    frequency_hz=100.0,
    rotation_hz=1.0,
    rotor_angle_rad=0.4,
)
TRAPEZOID = Trapezoid(swept_axis="q", held_a=0.5, amplitude_a=1.0, period_s=0.5, periods=2, settle_s=0.2)
LONG = Hold(current_d_a=1.0, current_q_a=0.0, settle_s=2.0, duration_s=30.0)


def turned(dq: np.ndarray, angle_rad: float) -> np.ndarray:
    z = (dq[:, 0] + 1j * dq[:, 1]) * np.exp(1j * angle_rad)
    return np.column_stack((z.real, z.imag))


@pytest.mark.parametrize("link", LINKS)
@few("excitation", [GatesOff(duration_s=0.5), HOLD, TRAPEZOID, INJECTION], fast=2, ids=lambda e: e.kind)
def test_what_the_device_captured_is_what_comes(link: str, excitation: Excitation) -> None:
    with armed(link) as b:
        capture = taken(b.drive, excitation)
    i_dq, v_dq = waveforms(excitation, len(capture))
    scales = b.device.facts.scales
    np.testing.assert_allclose(capture.i_ab, turned(i_dq, excitation.rotor_angle_rad), atol=0.51 * scales.current_a)
    np.testing.assert_allclose(capture.v_ab, turned(v_dq, excitation.rotor_angle_rad), atol=0.51 * scales.voltage_v)
    np.testing.assert_allclose(capture.v_dc, 300.0, atol=scales.bus_v)


def test_a_drive_is_one_and_its_clock_can_be_set() -> None:
    with bench() as b:
        assert isinstance(b.drive, Drive)
        assert isinstance(b.drive, ResumableDrive)
        b.drive.connect()
        b.drive.restore("hold-003", 1234.5)
        assert b.drive.telemetry().time_s == pytest.approx(1234.5, abs=5.0)
        assert b.drive.telemetry().time_s >= 1234.5


@pytest.mark.parametrize("link", LINKS)
def test_blocks_are_short_and_follow_each_other(link: str) -> None:
    with armed(link) as b:
        blocks = [block for block in b.drive.execute(HOLD) if len(block)]
    assert max(len(block) for block in blocks) <= 0.5 * FS
    for before, after in itertools.pairwise(blocks):
        assert after.start_s == pytest.approx(before.start_s + len(before) / FS, abs=1e-9)


def test_settling_yields_blocks_without_rows() -> None:
    with armed(script=Script(speed=1.0)) as b:
        begun = time.monotonic()
        first = next(b.drive.execute(LONG))
        assert len(first) == 0
        assert time.monotonic() - begun < 0.5


def test_rows_come_while_the_drive_captures() -> None:
    with armed(script=Script(speed=1.0)) as b:
        blocks = b.drive.execute(Hold(current_d_a=1.0, current_q_a=0.0, settle_s=0.1, duration_s=5.0))
        begun = time.monotonic()
        while not len(next(blocks)):
            pass
        assert time.monotonic() - begun < 1.0


@pytest.mark.parametrize("link", LINKS)
def test_frames_that_are_lost_cost_time_but_no_row(link: str) -> None:
    with armed(link, Script(drop_every=20)) as b:
        capture = taken(b.drive, HOLD)
    assert len(capture) == FS
    np.testing.assert_array_equal(capture.i_ab[:, 0], capture.i_ab[0, 0])


def test_a_program_ends_without_a_word_of_progress() -> None:
    with armed(script=Script(progress_lost=True)) as b:
        assert len(taken(b.drive, HOLD)) == FS


def test_only_what_changes_is_written_for_the_next_point() -> None:
    with armed() as b:
        taken(b.drive, HOLD)
        before = sum(isinstance(m, ParameterWrite) for m in b.device.received)
        taken(b.drive, HOLD.model_copy(update={"current_d_a": -1.0}))
        assert sum(isinstance(m, ParameterWrite) for m in b.device.received) == before + 1


# Refusals


@pytest.mark.parametrize(
    "excitation",
    [
        HOLD.model_copy(update={"current_d_a": float("nan")}),
        HOLD.model_copy(update={"current_d_a": 5.0}),
        HOLD.model_copy(update={"pwm_frequency_hz": 9999.0}),
        HOLD.model_copy(update={"control": CurrentControl(bandwidth_hz=1e9)}),
    ],
    ids=["no number", "past the limit", "no such PWM frequency", "out of the table's range"],
)
def test_what_cannot_be_is_refused_before_anything_moves(excitation: Hold) -> None:
    with armed() as b:
        with pytest.raises(DriveRefused):
            taken(b.drive, excitation)
        assert b.device.state is PowerState.HOLDING
        assert b.device.i_dq == (0.0, 0.0)


def test_a_drive_that_holds_another_limit_than_was_written_is_not_armed() -> None:
    with bench(script=Script(hold_other={"limit_current_a": 9.0})) as b:
        b.drive.connect()
        with pytest.raises(DriveFault, match=r"holds 9 as limit_current_a instead of 4\.5") as fault:
            b.drive.arm(LIMITS)
        assert fault.value.cause is FaultCause.WRONG_DATA
        assert not b.device.arms


def test_limits_above_the_drives_own_are_refused() -> None:
    with bench() as b:
        b.drive.connect()
        with pytest.raises(DriveRefused, match="current limit 6 A is above"):
            b.drive.arm(Limits(current_a=6.0, voltage_v=100.0))
        assert not b.device.arms


def test_a_drive_that_another_host_has_armed_is_left_alone() -> None:
    with armed() as b:
        (reply,) = b.device.receive([encode(Conversation().command(Op.IDENTIFY, PROTOCOL_MAJOR))])
        ack = decode(*reply)
        assert isinstance(ack, Ack)
        assert ack.status is AckStatus.BUSY
        assert len(taken(b.drive, HOLD)) == FS


def test_a_session_number_that_an_earlier_host_had_is_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = iter([4711, 0, 815, 0])
    with bench() as b:
        for session in (4712, 4713):
            b.device.receive([encode(Command(session, 1, Op.IDENTIFY, PROTOCOL_MAJOR))])
        monkeypatch.setattr("plugins.wire._session.secrets.randbelow", lambda _: next(drawn))
        b.drive.connect()
        assert b.device.ledger.session == 816


def test_a_drive_without_ripple_is_not_requested_it() -> None:
    with (
        bench(script=Script(bits=Capability.RAW_CAPTURE), capture="demodulated") as b,
        pytest.raises(DriveRefused, match="demodulates no ripple"),
    ):
        b.drive.connect()


# Faults


@pytest.mark.parametrize("link", LINKS)
def test_a_fault_comes_with_its_cause_and_figures(link: str) -> None:
    with armed(link, Script(speed=1.0)) as b:
        blocks = b.drive.execute(LONG)
        next(blocks)
        b.device.trip(Fault.OVERCURRENT, 7.25, 5.6)
        begun = time.monotonic()
        with pytest.raises(DriveFault, match=r"overcurrent: 7\.25 A against 5\.6 A") as fault:
            list(blocks)
        assert time.monotonic() - begun < 0.5
        assert fault.value.cause is FaultCause.OVERCURRENT
        reading = b.drive.telemetry()
        assert (reading.state, reading.faults) == (DriveState.FAULTED, ("overcurrent",))
        with pytest.raises(DriveRefused, match="a fault is latched"):
            b.drive.arm(LIMITS)
        b.drive.ramp_down()
        b.drive.disarm()
        b.drive.clear_fault()
        assert b.drive.telemetry().state is DriveState.DISARMED
        b.drive.arm(LIMITS)


def test_a_program_that_did_not_end_is_named() -> None:
    with armed(script=Script(speed=1.0)) as b:
        blocks = b.drive.execute(LONG)
        next(blocks)
        b.device.trip(Fault.PROGRAM_TOO_LONG, 32.5, 32.0)
        with pytest.raises(DriveFault, match=r"the program did not end: 32\.5 s against 32 s") as fault:
            list(blocks)
        assert fault.value.cause is FaultCause.PROGRAM_TOO_LONG


def test_an_emergency_stop_is_named() -> None:
    with armed(script=Script(speed=1.0)) as b:
        blocks = b.drive.execute(LONG)
        next(blocks)
        b.device.receive([encode(EStop())])
        with pytest.raises(DriveFault) as fault:
            list(blocks)
        assert fault.value.cause is FaultCause.EMERGENCY_STOP


def test_a_host_that_falls_silent_trips_the_watchdog() -> None:
    with bench(script=Script(speed=1.0)) as b:
        b.drive.connect()
        with beating(b.drive) as stop:
            b.drive.arm(LIMITS)
            blocks = b.drive.execute(LONG)
            next(blocks)
            stop()
            with pytest.raises(DriveFault) as fault:
                list(blocks)
        assert fault.value.cause is FaultCause.HEARTBEAT_LOST


def test_a_fault_between_two_programs_is_reported_before_arming_is_refused() -> None:
    with armed() as b:
        b.device.trip(Fault.OVERTEMPERATURE, 121.0, 120.0)
        b.drive.ramp_down()
        b.drive.disarm()
        with pytest.raises(DriveFault, match="temperature: 121 °C against 120 °C"):
            b.drive.arm(LIMITS)
        with pytest.raises(DriveRefused, match="a fault is latched"):
            b.drive.arm(LIMITS)


def test_the_next_host_clears_a_watchdogs_fault_and_no_other() -> None:
    with bench() as b:
        b.device.trip(Fault.WATCHDOG, 0.61, 0.6)
        b.drive.connect()
        assert b.drive.telemetry().state is DriveState.DISARMED
    with bench() as b:
        b.device.trip(Fault.OVERCURRENT, 7.0, 5.6)
        b.drive.connect()
        assert b.drive.telemetry().faults == ("overcurrent",)
    with bench(clear_fault=True) as b:
        b.device.trip(Fault.OVERCURRENT, 7.0, 5.6)
        b.drive.connect()
        assert b.drive.telemetry().faults == ()


def test_damaged_rows_never_end_as_a_capture() -> None:
    with armed(script=Script(wrong_crc=True)) as b:
        blocks = b.drive.execute(INJECTION)
        with pytest.raises(DriveFault) as fault:
            list(blocks)
        assert fault.value.cause is FaultCause.WRONG_DATA


def test_rows_that_were_overwritten_are_a_fault_that_says_so() -> None:
    with armed(script=Script(ring_bytes=100, speed=100.0)) as b:
        with pytest.raises(DriveFault, match="overwritten") as fault:
            taken(b.drive, HOLD)
        assert fault.value.cause is FaultCause.WRONG_DATA


def test_a_command_without_an_answer_is_named() -> None:
    with bench(script=Script(no_answer_to=frozenset({Op.ARM})), answer_timeout_s=0.2) as b:
        b.drive.connect()
        with pytest.raises(DriveFault, match=r"no answer to arm for 0\.2 s") as fault:
            b.drive.arm(LIMITS)
        assert fault.value.cause is FaultCause.NO_ANSWER


def test_a_drive_that_has_restarted_is_lost() -> None:
    with armed() as b:
        b.device.ledger.issue()
        with pytest.raises(DriveFault, match="no longer knows this session") as fault:
            taken(b.drive, HOLD)
        assert fault.value.cause is FaultCause.LINK_LOST
        with pytest.raises(DriveFault, match="session"):
            b.drive.arm(LIMITS)


# Ways out


@pytest.mark.parametrize("link", LINKS)
def test_leaving_early_ramping_down_and_disarming_may_be_repeated(link: str) -> None:
    with armed(link, Script(speed=1.0)) as b:
        blocks = b.drive.execute(LONG)
        next(blocks)
        for _ in range(2):
            b.drive.ramp_down()
        assert b.device.state is PowerState.HOLDING
        with pytest.raises(DriveRefused, match="given up"):
            next(blocks)
        for _ in range(2):
            b.drive.disarm()
        b.drive.ramp_down()
        assert b.drive.telemetry().state is DriveState.DISARMED


def test_ways_out_before_connecting_do_nothing() -> None:
    with bench() as b:
        b.drive.ramp_down()
        b.drive.disarm()
        b.drive.heartbeat()
        with pytest.raises(DriveRefused, match="not connected"):
            b.drive.telemetry()


@pytest.mark.parametrize("link", LINKS)
def test_a_silent_drive_is_lost_within_three_periods_and_not_armed_again(link: str) -> None:
    with armed(link, Script(speed=1.0), telemetry_period_s=0.05) as b:
        blocks = b.drive.execute(LONG)
        next(blocks)
        b.script.mute = True
        begun = time.monotonic()
        with pytest.raises(DriveFault, match="the drive is silent: no status for 3 periods") as fault:
            list(blocks)
        assert time.monotonic() - begun < 0.6
        assert fault.value.cause is FaultCause.LINK_LOST
        b.script.mute = False
        time.sleep(0.1)  # what was on its way has come
        beats = b.device.beats
        for call in (b.drive.ramp_down, b.drive.disarm, lambda: b.drive.arm(LIMITS), b.drive.telemetry):
            with pytest.raises(DriveFault, match="silent"):
                call()
        time.sleep(0.1)
        assert b.device.beats == beats, "the heart goes on beating for a drive that is lost"
        assert len(b.device.arms) == 1


def test_a_drive_that_only_seems_dead_is_still_reported_to_stop() -> None:
    with armed(script=Script(speed=1.0)) as b:
        blocks = b.drive.execute(LONG)
        next(blocks)
        b.script.no_status = True
        with pytest.raises(DriveFault, match="silent"):
            list(blocks)
        with pytest.raises(DriveFault, match="silent"):
            b.drive.disarm()
        time.sleep(0.1)
        assert b.device.state in (PowerState.DISARMED, PowerState.FAULTED)
        assert [m.op for m in b.device.received if isinstance(m, Command)][-2:] == [Op.STOP, Op.DISARM]


def test_the_heartbeat_returns_at_once_and_never_raises() -> None:
    with bench() as b:
        b.drive.connect()
        b.script.mute = True
        for _ in range(50):
            begun = time.monotonic()
            b.drive.heartbeat()
            assert time.monotonic() - begun < 0.1
            time.sleep(0.005)


def test_reading_asks_for_blocks_of_its_own_capture_only() -> None:
    with armed() as b:
        taken(b.drive, HOLD)
        captures = {m.capture for m in b.device.received if isinstance(m, ReadBlock)}
    assert captures == {1, 0xFFFF}
