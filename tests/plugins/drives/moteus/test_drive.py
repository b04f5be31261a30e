"""The moteus drive against an emulated board that the official library accepts."""

from __future__ import annotations

import asyncio
import cmath
import math
import random
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest

pytest.importorskip("moteus", reason="the official library of moteus is an optional extra")

from pydantic import ValidationError

from orchestrator.testing._drive_bench import HeartbeatThread, measure
from plugins.drives.moteus import MoteusDrive, MoteusOptions
from plugins.drives.moteus._configuration import Frame
from protocols import (
    DriveFault,
    DriveRefused,
    DriveSetup,
    DriveState,
    FaultCause,
    GatesOff,
    Hold,
    Limits,
    Motor,
    PluginError,
)
from tests.plugins.drives.moteus.emulator import Fdcanusb, Servo, _checked, can_bus, fdcanusb
from tests.support.processes import wait_until

MOTOR = Motor(name="mj5208", pole_pairs=7, rated_current_rms_a=5.0, stator_resistance_ohm=0.4)
LIMITS = Limits(current_a=8.0, voltage_v=10.0)
RATE_HZ = 20.0
"""Slow enough for a machine that is busy with other tests: readings that come unevenly are refused."""
HOLD = Hold(current_d_a=3.0, current_q_a=-2.0, settle_s=0.1, duration_s=0.3, rotor_angle_rad=0.7)
ROWS = round(HOLD.duration_s * RATE_HZ)


def nothing(servo: Servo) -> None:
    """A board as it comes."""


def made(board: Fdcanusb, **options: Any) -> MoteusDrive:
    options = {"port": board.path, "sampling_frequency_hz": RATE_HZ, **options}
    return MoteusDrive(DriveSetup(motor=MOTOR, options=MoteusOptions(**options), seed=1))


@contextmanager
def connected(change: Callable[[Servo], Any] = nothing, **options: Any) -> Iterator[tuple[MoteusDrive, Fdcanusb]]:
    """A connected drive and the port that it is on."""
    with fdcanusb(change) as port:
        drive = made(port, **options)
        drive.connect()
        try:
            yield drive, port
        finally:
            drive.close()


@contextmanager
def armed(change: Callable[[Servo], Any] = nothing, limits: Limits = LIMITS) -> Iterator[tuple[MoteusDrive, Fdcanusb]]:
    """An armed drive with a beating heart."""
    with connected(change) as (drive, port), HeartbeatThread(drive, 0.05):
        drive.arm(limits)
        yield drive, port


def test_a_hold_is_captured_where_it_was_requested_and_its_voltage_is_the_resistance_times_it() -> None:
    with armed() as (drive, port):
        measured = measure(drive, HOLD)
        assert port.servo.configuration["servo.max_current_A"] == 8.0, "the board does not hold the limit"
        drive.ramp_down()
        drive.disarm()
        assert port.servo.configuration["servo.max_current_A"] == 20.0, "the board's own limit was not put back"
        assert drive.telemetry().state is DriveState.DISARMED
    expected = complex(3.0, -2.0) * cmath.exp(0.7j)
    i, v = (complex(*x.mean(axis=0)) for x in (measured.i_ab, measured.v_ab))
    assert len(measured.i_ab) == ROWS
    assert all(b.temperature_c is not None and (b.temperature_c == 31.5).all() for b in measured.blocks if len(b))
    assert abs(i - expected) < 0.02
    assert abs(v - 0.4 * expected) < 0.01


@pytest.mark.parametrize("theta_rad", [-3.0, 0.0, 0.4, 3.1])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_position_stands_for_its_angle(theta_rad: float, sign: int) -> None:
    frame = Frame(poles=14, sign=sign, ratio=0.25, zero_rad=1.1)
    found = frame.zero_rad + sign * frame.position(theta_rad) / 0.25 * 7 * 2.0 * math.pi
    assert math.remainder(found - theta_rad, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_with_the_power_stage_off_amplifiers_that_are_off_are_not_believed() -> None:
    with connected() as (drive, _):
        telemetry = drive.telemetry()
    assert (telemetry.i_d_a, telemetry.i_q_a) == (0.0, 0.0)
    assert telemetry.v_dc_v == 24.0
    assert telemetry.temperature_c == 31.5


def test_capabilities_claim_what_the_board_is_configured_for() -> None:
    with fdcanusb() as port:
        drive = made(port)
        says = drive.connect()
        drive.close()
    assert says.name == "moteus (firmware 1.1.0)"
    assert says.max_current_a == 20.0
    assert says.max_voltage_v == 12.0
    assert says.watchdog_covers == says.excitations == {"hold"}
    assert not says.has_brake


def test_without_a_safe_timeout_mode_no_watchdog_is_claimed() -> None:
    with fdcanusb(lambda servo: servo.configuration.update({"servo.timeout_mode": 10})) as port:
        drive = made(port)
        says = drive.connect()
        drive.close()
    assert says.watchdog_s is None
    assert not says.watchdog_covers


def test_without_a_heartbeat_the_board_hears_no_setpoint_and_stops_by_itself() -> None:
    with connected() as (drive, port):
        drive.arm(LIMITS)
        time.sleep(0.5)
        assert port.servo.position_commands == 1, "somebody else than the heartbeat fed the board's watchdog"
        telemetry = drive.telemetry()
        assert telemetry.state is DriveState.FAULTED
        assert telemetry.faults == ("heartbeat_lost: the board received no heartbeat for 0.3 s (mode 11)",)
        with pytest.raises(DriveRefused, match="clear it first"):
            drive.arm(LIMITS)
        drive.clear_fault()
        drive.arm(LIMITS)
        assert drive.telemetry().state is DriveState.ARMED


@pytest.mark.parametrize(
    ("code", "cause", "words"),
    [
        (33, FaultCause.INTERNAL, "gate driver"),
        (34, FaultCause.BUS_VOLTAGE, "max_voltage"),
        (38, FaultCause.OVERTEMPERATURE, "hotter"),
        (40, FaultCause.BUS_VOLTAGE, "too low"),
        (77, FaultCause.INTERNAL, "moteus fault 77: unknown"),
    ],
)
def test_a_fault_is_reported_in_words_and_latched(code: int, cause: FaultCause, words: str) -> None:
    with armed() as (drive, port):
        port.servo.trip(code)
        with pytest.raises(DriveFault, match=words) as fault:
            measure(drive, HOLD)
        assert fault.value.cause is cause
        drive.disarm()
        assert drive.telemetry().state is DriveState.FAULTED
        drive.clear_fault()
        assert drive.telemetry().state is DriveState.DISARMED


def test_a_current_that_the_board_limits_is_no_hold() -> None:
    with armed() as (drive, port):
        port.servo.code = 98
        with pytest.raises(DriveFault, match="below its target because of the bus voltage"):
            measure(drive, HOLD)
        assert port.servo.mode == 0, "the power stage is still on"


def test_more_voltage_than_allowed_trips() -> None:
    with (
        armed(lambda servo: setattr(servo, "resistance_ohm", 3.0)) as (drive, _),
        pytest.raises(DriveFault, match="above the limit of 10 V"),
    ):
        measure(drive, HOLD)


def test_more_current_than_allowed_trips(monkeypatch: pytest.MonkeyPatch) -> None:
    with armed() as (drive, port):
        read = port.servo._read
        monkeypatch.setattr(port.servo, "_read", lambda r: 10.5 if r == 5 else read(r))
        with pytest.raises(DriveFault, match="with a limit of 8 A") as fault:
            measure(drive, HOLD)
        assert fault.value.cause is FaultCause.OVERCURRENT
        assert port.servo.mode == 0, "the power stage is still on"


def test_a_board_at_another_angle_is_not_energised() -> None:
    with armed() as (drive, port):
        port.servo.angle_error_rad = 0.1
        with pytest.raises(DriveFault, match="electrical angle") as fault:
            measure(drive, HOLD)
        assert fault.value.cause is FaultCause.WRONG_DATA
        assert port.servo.mode == 0


def test_readings_that_never_come_evenly_are_reported() -> None:
    with armed() as (drive, port):
        answer = port.servo.answer

        def slowly(frame: bytes) -> bytes | None:
            time.sleep(0.015)
            return answer(frame)

        port.servo.answer = slowly  # type: ignore[method-assign]
        with pytest.raises(DriveFault, match="ask for a lower sampling_frequency_hz"):
            measure(drive, HOLD)


def test_a_silent_board_is_a_lost_link() -> None:
    with connected() as (drive, port):
        port.servo.mute = True
        with pytest.raises(DriveFault) as fault:
            drive.telemetry()
        assert fault.value.cause is FaultCause.LINK_LOST
        with pytest.raises(DriveFault, match="link_lost"):
            drive.arm(LIMITS)


def test_a_pulled_plug_is_a_lost_link() -> None:
    with armed() as (drive, port):
        under_way = iter(drive.execute(HOLD.model_copy(update={"duration_s": 2.0})))
        next(under_way)
        port.pull_the_plug()
        begun_s = time.monotonic()
        with pytest.raises(DriveFault) as fault:
            list(under_way)
        assert fault.value.cause is FaultCause.LINK_LOST
        assert time.monotonic() - begun_s < 2.0
        with pytest.raises(DriveFault, match="link_lost"):
            drive.disarm()


def deaf(drive: MoteusDrive, _: threading.Event) -> None:
    """Exchanges that never end, and do not let themselves be cancelled."""

    async def execute(command: Any) -> Any:
        while True:
            with suppress(asyncio.CancelledError):
                await asyncio.sleep(3600.0)

    drive.connected()[0]._controller.execute = execute


def blocking(drive: MoteusDrive, over: threading.Event) -> None:
    """Exchanges that block the event loop until all is over."""

    async def execute(command: Any) -> Any:
        over.wait(20.0)

    drive.connected()[0]._controller.execute = execute


@pytest.mark.parametrize("fall_silent", [deaf, blocking])
def test_a_library_that_never_comes_back_is_a_lost_link_within_three_seconds(
    fall_silent: Callable[[MoteusDrive, threading.Event], None],
) -> None:
    over = threading.Event()
    with armed() as (drive, port):
        under_way = iter(drive.execute(HOLD.model_copy(update={"duration_s": 60.0})))
        next(under_way)
        fall_silent(drive, over)
        begun_s = time.monotonic()
        with pytest.raises(DriveFault) as fault:
            list(under_way)
        assert time.monotonic() - begun_s < 3.0
        assert fault.value.cause is FaultCause.LINK_LOST
        # No setpoint feeds the board's watchdog any more.
        wait_until(lambda: port.servo.answer(b"\x50") is None and port.servo.mode == 11, 2.0)
        begun_s = time.monotonic()
    assert time.monotonic() - begun_s < 5.0, "closing waits for the library"
    over.set()
    wait_until(lambda: not any(thread.name == "moteus" for thread in threading.enumerate()), 5.0)


def test_an_iterator_that_was_left_commands_nothing_any_more() -> None:
    with armed() as (drive, _):
        left = iter(drive.execute(HOLD.model_copy(update={"duration_s": 5.0})))
        next(left)
        drive.ramp_down()
        with pytest.raises(DriveRefused, match="given up"):
            next(left)
        time.sleep(0.1)
        telemetry = drive.telemetry()
        assert math.hypot(telemetry.i_d_a, telemetry.i_q_a) < 0.1
        assert len(measure(drive, HOLD).i_ab) == ROWS, "the conversation was spoilt"


def test_what_it_cannot_do_is_refused_with_its_reason() -> None:
    with armed() as (drive, _):
        with pytest.raises(DriveRefused, match="amplifiers are switched off"):
            drive.execute(GatesOff(duration_s=0.1))
        with pytest.raises(DriveRefused, match="lock it by hand"):
            drive.set_brake(True)


def test_more_voltage_than_allowed_by_the_nameplate_is_refused_before_moving() -> None:
    with (
        armed(limits=Limits(current_a=8.0, voltage_v=1.0)) as (drive, _),
        pytest.raises(DriveRefused, match="above the limit of 1 V"),
    ):
        drive.execute(HOLD)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda servo: setattr(servo, "register_map", 4), "register map 4"),
        (lambda servo: setattr(servo, "mode", 10), "somebody else drives it"),
        (lambda servo: servo.configuration.update({"motor.poles": 8}), "configured for 8 poles"),
        (lambda servo: servo.configuration.update({"servo.fixed_voltage_mode": 1}), "controls no current"),
    ],
)
def test_a_board_that_does_not_fit_is_refused(change: Callable[[Servo], Any], message: str) -> None:
    def made_so(servo: Servo) -> None:
        servo._expires_s = math.inf
        change(servo)

    with fdcanusb(made_so) as port:
        drive = made(port)
        with pytest.raises(DriveRefused, match=message):
            drive.connect()
        drive.close()


def test_an_answer_that_comes_twice_spoils_no_conversation(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame whose answer was late is sent again, and answered again: the next question meets that line."""
    import moteus

    requested, answered = list[str](), moteus.Stream.read_data

    async def read_data(stream: Any, name: str) -> Any:
        requested.append(name)
        if len(requested) == 1:
            raise RuntimeError(f"Unexpected schema announce for '{name}' : 'b'12.000000''")
        return await answered(stream, name)

    monkeypatch.setattr(moteus.Stream, "read_data", read_data)
    with connected() as (drive, _):
        assert drive.telemetry().state is DriveState.DISARMED
    assert requested[:2] == ["servo_control", "servo_control"]


@pytest.mark.parametrize("question", ["conf get motor.poles", "conf get servo.timeout_mode", "tel fmt servo_stats 0"])
def test_a_line_that_comes_twice_is_not_the_next_answer(question: str) -> None:
    left = [question]

    def once(requested: str) -> bool:
        if requested not in left:
            return False
        left.remove(requested)
        return True

    with fdcanusb(lambda servo: setattr(servo, "answers_twice", once)) as port:
        drive = made(port)
        says = drive.connect()
        assert (says.max_current_a, says.pwm_frequency_hz, says.watchdog_s) == (20.0, 30000.0, 0.3)
        assert left == []
        left.append("conf set servo.max_current_A 8.000000")
        drive.arm(LIMITS)
        assert left == []
        assert port.servo.configuration["servo.max_current_A"] == 8.0
        drive.close()


def test_lines_that_always_come_twice_are_one_clear_error() -> None:
    with fdcanusb(
        lambda servo: setattr(servo, "answers_twice", lambda requested: requested.startswith("conf"))
    ) as port:
        drive = made(port)
        with pytest.raises(DriveFault, match="not those of their questions") as fault:
            drive.connect()
        drive.close()
    assert fault.value.cause is FaultCause.WRONG_DATA
    assert "\n" not in str(fault.value)


def test_a_fault_found_on_connecting_stays_unless_it_was_seen_to() -> None:
    with connected(lambda servo: servo.trip(34)) as (drive, _):
        assert drive.telemetry().state is DriveState.FAULTED
    with connected(lambda servo: servo.trip(34), clear_fault=True) as (drive, _):
        assert drive.telemetry().state is DriveState.DISARMED
    with connected(lambda servo: setattr(servo, "mode", 11)) as (drive, _):
        assert drive.telemetry().state is DriveState.DISARMED


def test_firmware_without_flow_control_is_talked_to_as_well() -> None:
    with connected(lambda servo: setattr(servo, "knows_flow_control", False)) as (drive, _):
        assert drive.telemetry().state is DriveState.DISARMED


@pytest.mark.parametrize("problem", ["no port", "nobody there"])
def test_nobody_there_is_one_clear_line(problem: str) -> None:
    with fdcanusb(servo_id=5) as port:
        drive = made(port, port="/dev/no-such-port") if problem == "no port" else made(port)
        with pytest.raises(DriveFault) as fault:
            drive.connect()
        drive.close()
    assert fault.value.cause is FaultCause.LINK_LOST
    assert "moteus 1 on" in str(fault.value)
    assert "\n" not in str(fault.value)


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "moteus", None)
    drive = MoteusDrive(DriveSetup(motor=MOTOR, options=MoteusOptions(port="/dev/null"), seed=1))
    with pytest.raises(PluginError, match=r"pip install 'fluxbench\[moteus\]'"):
        drive.connect()
    drive.close()


@pytest.mark.parametrize("options", [{}, {"port": "/dev/ttyACM0", "channel": "can0"}])
def test_one_way_to_the_board_is_to_be_given(options: dict[str, str]) -> None:
    with pytest.raises(ValidationError, match="either port"):
        MoteusOptions(**options)


def test_the_clock_goes_on_where_the_experiment_s_stands() -> None:
    with connected() as (drive, _):
        drive.checkpoint("p-000")
        drive.restore("p-000", 120.0)
        assert drive.telemetry().time_s == pytest.approx(120.0, abs=1.0)


def test_rows_are_no_copies_of_each_other() -> None:
    with armed() as (drive, _):
        i_ab = measure(drive, HOLD).i_ab
    assert len(np.unique(i_ab, axis=0)) == len(i_ab)


def test_a_board_on_a_can_bus_is_reached_as_well() -> None:
    options = MoteusOptions(interface="virtual", channel="moteus-test", sampling_frequency_hz=RATE_HZ)
    with can_bus("moteus-test") as servo:
        drive = MoteusDrive(DriveSetup(motor=MOTOR, options=options, seed=1))
        drive.connect()
        with HeartbeatThread(drive, 0.05):
            drive.arm(LIMITS)
            i_ab = measure(drive, HOLD).i_ab
            drive.ramp_down()
            drive.disarm()
        drive.close()
    assert abs(complex(*i_ab.mean(axis=0)) - complex(3.0, -2.0) * cmath.exp(0.7j)) < 0.02
    assert servo.mode == 0


# Lies


def configured(name: str, value: float) -> Callable[[Servo], Any]:
    return lambda servo: servo.configuration.update({name: value})


def reads(register: int, value: float) -> Callable[[Servo], Any]:
    """The register has this value while the power stage is on."""

    def change(servo: Servo) -> None:
        honest = servo._read
        vars(servo)["_read"] = lambda wanted: value if wanted == register and servo.mode == 10 else honest(wanted)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda servo: setattr(servo, "bus_v", math.nan), "a bus voltage of nan V"),
        (lambda servo: setattr(servo, "bus_v", math.inf), "moteus gave an impossible value: dc_bus_voltage_v: Input"),
        (configured("motor.poles", math.nan), "the board has no number for motor.poles: nan"),
        (configured("motor.poles", math.inf), "the board has no number for motor.poles: inf"),
        (configured("servo.max_current_A", -1.0), "moteus gave an impossible value: max_current_a: Input"),
        (configured("servo.pwm_rate_hz", 0.0), "moteus gave an impossible value: pwm_frequency_hz: Input"),
    ],
)
def test_what_no_board_is_configured_for_is_its_fault_in_one_line(change: Callable[[Servo], Any], message: str) -> None:
    with fdcanusb(change) as port:
        drive = made(port)
        with pytest.raises(DriveFault, match=re.escape(message)) as fault:
            drive.connect()
        drive.close()
    assert fault.value.cause is FaultCause.WRONG_DATA
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize(
    ("register", "value", "cause"),
    [(0x005, math.nan, FaultCause.OVERCURRENT), (0x004, 1e30, FaultCause.OVERCURRENT)],
)
def test_a_current_that_is_none_trips(register: int, value: float, cause: FaultCause) -> None:
    with connected(reads(register, value)) as (drive, port):
        with HeartbeatThread(drive, 0.1), pytest.raises(DriveFault) as fault:
            arm_and_hold(drive)
        assert fault.value.cause is cause
        assert port.servo.mode in (0, 11)


def arm_and_hold(drive: MoteusDrive) -> None:
    drive.arm(LIMITS)
    list(drive.execute(HOLD))


def twice(port: Fdcanusb) -> None:
    """Every line of the board comes twice."""
    honest = port._answers
    vars(port)["_answers"] = lambda line: [answer for answer in honest(line) for _ in range(2)]


def of_another(port: Fdcanusb) -> None:
    """Before each answer comes one of another board on the bus, with wild readings."""
    honest = port._answers
    stranger = _checked(b"rcv 0500 240D01 b F")
    vars(port)["_answers"] = lambda line: [part for answer in honest(line) for part in (stranger, answer)]


def noisy(port: Fdcanusb) -> None:
    """Random octets between the lines."""
    honest, rng = port._answers, random.Random(3)

    def answers(line: bytes) -> Iterator[bytes]:
        for answer in honest(line):
            yield rng.randbytes(rng.randrange(40)) + b"\n"
            yield answer

    vars(port)["_answers"] = answers


@pytest.mark.parametrize("disturb", [twice, of_another, noisy])
def test_disturbed_lines_are_a_true_capture_or_a_named_fault(disturb: Callable[[Fdcanusb], None]) -> None:
    with connected() as (drive, port):
        disturb(port)
        expected = HOLD.current_d_a + 1j * HOLD.current_q_a
        with HeartbeatThread(drive, 0.1), suppress(DriveFault):
            drive.arm(LIMITS)
            capture = measure(drive, HOLD)
            mean = complex(*capture.i_ab.mean(axis=0)) * cmath.exp(-1j * HOLD.rotor_angle_rad)
            assert abs(mean - expected) < 0.05
        with suppress(DriveFault):
            drive.disarm()
        wait_until(lambda: port.servo.answer(b"\x50") is None and port.servo.mode in (0, 1, 11), 5.0)
