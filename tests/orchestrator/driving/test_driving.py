"""The drive shell: what is refused, how an excitation is given up, which way out is taken how often."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import pytest

from orchestrator.driving import DriveShell, in_blocks, keepalive
from protocols import (
    Capabilities,
    Capture,
    Drive,
    DriveFault,
    DriveRefused,
    DriveSetup,
    DriveState,
    Excitation,
    FaultCause,
    GatesOff,
    Hold,
    Injection,
    Limits,
    Motor,
    NoOptions,
    Telemetry,
)

HOLD = Hold(current_d_a=3.0, current_q_a=-4.0, settle_s=0.0, duration_s=1.0)
INJECTION = Injection(
    target_d_a=1.0,
    target_q_a=0.0,
    settle_s=0.1,
    duration_s=0.1,
    amplitude_v=9.0,
    frequency_hz=100.0,
    rotation_hz=10.0,
)
LIMITS = Limits(current_a=5.0, voltage_v=10.0)
LOST = DriveFault(FaultCause.LINK_LOST, "unplugged")


class Recorder(DriveShell):
    """Writes down which of its own parts were requested."""

    name: ClassVar[str] = "recorder"
    why_not: ClassVar = {"gates_off": "its gates are welded"}

    def __init__(self) -> None:
        motor = Motor(name="none", pole_pairs=1, stator_resistance_ohm=2.0)
        super().__init__(DriveSetup(motor=motor, options=NoOptions(), seed=1))
        self.done: list[str] = []
        self.lost = False
        self.refuses = False

    def open(self) -> Capabilities:
        return Capabilities(
            name="recorder",
            sampling_frequency_hz=100.0,
            pwm_frequency_hz=8e3,
            pwm_frequencies_hz=(8e3,),
            dc_bus_voltage_v=50.0,
            max_current_a=5.0,
            max_voltage_v=20.0,
            longest_capture_s=2.0,
            excitations=frozenset({"hold", "injection"}),
            watchdog_s=None,
        )

    def energise(self, limits: Limits) -> None:
        self.done.append("energise")
        if self.refuses:
            raise DriveRefused("not now")

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        try:
            while True:
                yield keepalive(0.0, 100.0)
        finally:
            self.done.append("left")

    def ramp(self) -> None:
        self.done.append("ramp")

    def switch_off(self) -> None:
        self.done.append("off")
        if self.lost:
            raise LOST

    def telemetry(self) -> Telemetry:
        return Telemetry(state=self.state, time_s=0.0, i_d_a=0.0, i_q_a=0.0, v_dc_v=50.0, faults=self.faults)


def armed() -> Recorder:
    drive = Recorder()
    drive.connect()
    drive.arm(LIMITS)
    return drive


def test_a_drive_in_the_shell_is_a_drive() -> None:
    assert isinstance(Recorder(), Drive)


class FormerName(Recorder):
    def attend(self) -> None:
        super().attend()
        raise LOST


def test_the_former_name_of_the_check_of_the_link_counts() -> None:
    drive = FormerName()
    drive.connect()
    with pytest.raises(DriveFault, match="unplugged"):
        drive.arm(LIMITS)
    assert drive.done == []


def test_nothing_is_done_before_connecting_and_after_closing() -> None:
    drive = Recorder()
    for _ in range(2):
        for call in (lambda: drive.arm(LIMITS), lambda: drive.execute(HOLD)):
            with pytest.raises(DriveRefused, match="not connected"):
                call()
        drive.ramp_down()
        drive.disarm()
        drive.close()
    assert drive.done == []


@pytest.mark.parametrize(
    ("limit", "reported"), [("current_a", "current limit 21 A"), ("voltage_v", "voltage limit 21 V")]
)
def test_a_limit_above_the_drive_s_own_is_refused(limit: str, reported: str) -> None:
    drive = Recorder()
    drive.connect()
    with pytest.raises(DriveRefused, match=reported):
        drive.arm(LIMITS.model_copy(update={limit: 21.0}))
    assert (drive.state, drive.done) == (DriveState.DISARMED, [])


def test_a_drive_that_refuses_to_be_armed_is_disarmed() -> None:
    drive = Recorder()
    drive.connect()
    drive.refuses = True
    with pytest.raises(DriveRefused, match="not now"):
        drive.arm(LIMITS)
    assert drive.state is DriveState.DISARMED


@pytest.mark.parametrize(
    ("excitation", "reported"),
    [
        (GatesOff(duration_s=1.0), "no gates_off: its gates are welded"),
        (HOLD.model_copy(update={"current_d_a": float("nan")}), "current_d_a is not a finite number"),
        (HOLD.model_copy(update={"current_d_a": -3.1}), "current 5.061 A is above the limit of 5 A"),
        (HOLD.model_copy(update={"pwm_frequency_hz": 9e3}), "PWM frequency 9000 Hz; this drive has 8000 Hz"),
        (HOLD.model_copy(update={"duration_s": 1e-3}), "nothing to capture"),
        (HOLD.model_copy(update={"duration_s": 2.1}), "longer than the drive's 2 s"),
        (INJECTION, "needs 11 V, above the limit of 10 V"),
    ],
)
def test_what_does_not_fit_is_refused_before_it_is_begun(excitation: Excitation, reported: str) -> None:
    drive = armed()
    with pytest.raises(DriveRefused, match=reported):
        drive.execute(excitation)
    assert drive.done == ["energise"]


def test_what_fits_by_a_single_s_rounding_fits() -> None:
    drive = armed()
    drive.execute(HOLD.model_copy(update={"current_d_a": 3.0 * (1.0 + 1e-7), "current_q_a": -4.0 * (1.0 + 1e-7)}))


@pytest.mark.parametrize("way_out", ["ramp_down", "disarm", "execute"])
def test_an_excitation_given_up_ends_at_once_whoever_holds_its_iterator(way_out: str) -> None:
    drive = armed()
    blocks = drive.execute(HOLD)
    next(blocks)
    drive.execute(HOLD) if way_out == "execute" else getattr(drive, way_out)()
    assert drive.done[1] == "left"
    with pytest.raises(DriveRefused, match="given up"):
        next(blocks)


def test_an_iterator_that_is_closed_leaves_the_excitation() -> None:
    drive = armed()
    blocks = drive.execute(HOLD)
    next(blocks)
    blocks.close()
    assert drive.done == ["energise", "left"]


def test_ways_out_may_be_taken_in_any_state_and_any_number_of_times() -> None:
    drive = armed()
    for _ in range(2):
        drive.ramp_down()
    for _ in range(2):
        drive.disarm()
        drive.ramp_down()
    assert drive.done == ["energise", "ramp", "ramp", "off"]


def test_a_trip_switches_off_and_is_latched_until_cleared() -> None:
    drive = armed()
    fault = drive.trip(DriveFault(FaultCause.OVERCURRENT, "much"))
    assert (drive.state, drive.faults, drive.done[-1]) == (DriveState.FAULTED, ("overcurrent",), "off")
    assert fault.detail == "much"
    with pytest.raises(DriveRefused, match=r"a fault is latched \(overcurrent\); clear it first"):
        drive.arm(LIMITS)
    with pytest.raises(DriveRefused, match=r"not armed \(faulted, overcurrent\)"):
        drive.execute(HOLD)
    drive.disarm()
    assert drive.telemetry().state is DriveState.FAULTED
    drive.clear_fault()
    assert drive.telemetry().state is DriveState.DISARMED
    drive.arm(LIMITS)


def test_a_drive_that_could_not_be_switched_off_is_reported_again() -> None:
    drive = armed()
    drive.lost = True
    drive.trip(LOST)
    with pytest.raises(DriveFault, match="unplugged"):
        drive.disarm()
    drive.lost = False
    drive.disarm()
    drive.disarm()
    assert drive.done == ["energise", "off", "off", "off"]


def test_blocks_follow_each_other_and_copy_nothing() -> None:
    i_ab = np.arange(20.0).reshape(10, 2)
    whole = Capture(start_s=1.0, sampling_frequency_hz=10.0, i_ab=i_ab, v_ab=i_ab, v_dc=i_ab[:, 0])
    blocks = list(in_blocks(whole, 0.4, rows=9))
    assert [len(block) for block in blocks] == [4, 4, 1]
    assert [block.start_s for block in blocks] == pytest.approx([1.0, 1.4, 1.8])
    assert all(np.shares_memory(block.i_ab, i_ab) for block in blocks)
    assert blocks[0].i_abc is None
