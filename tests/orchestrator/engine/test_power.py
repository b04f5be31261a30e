"""The owner of an energised drive: deadlines, and a way out that nothing keeps it from."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest

from orchestrator.engine import Interrupts, PowerStage, _power, handling_signals
from protocols import Capabilities, Capture, DriveFault, DriveState, FaultCause, GatesOff, Limits, Telemetry

CAPABILITIES = Capabilities(
    name="silent",
    sampling_frequency_hz=1e4,
    pwm_frequency_hz=1e4,
    pwm_frequencies_hz=(1e4,),
    dc_bus_voltage_v=48.0,
    max_current_a=10.0,
    max_voltage_v=24.0,
    excitations=frozenset({"gates_off"}),
    watchdog_s=0.2,
)


class SilentDrive:
    """Arms, and then neither yields nor returns."""

    def __init__(self, ramps: bool) -> None:
        self.ramps = ramps
        self.done: list[str] = []
        self.beats: list[float] = []

    def arm(self, limits: Limits) -> None:
        self.done.append("arm")

    def heartbeat(self) -> None:
        self.beats.append(time.monotonic())

    def execute(self, excitation: object) -> Iterator[Capture]:
        time.sleep(60.0)
        yield from ()

    def ramp_down(self) -> None:
        if not self.ramps:
            time.sleep(60.0)
        self.done.append("ramp_down")

    def disarm(self) -> None:
        self.done.append("disarm")


def stage(drive: Any, interrupts: Interrupts) -> PowerStage:
    return PowerStage(drive, CAPABILITIES, Limits(current_a=1.0, voltage_v=10.0), interrupts)


@pytest.fixture(autouse=True)
def _hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_power, "LEASE_S", 0.2)
    monkeypatch.setattr(_power, "SHUTDOWN_TIMEOUT_S", 0.2)


def test_a_drive_that_never_yields_is_given_up_and_ramped_down() -> None:
    drive = SilentDrive(ramps=True)
    with handling_signals() as interrupts:
        power = stage(drive, interrupts)
        power.arm()
        begun = time.monotonic()
        with pytest.raises(DriveFault) as caught:
            next(power.execute(GatesOff(duration_s=0.1), quiet_s=0.1))
        assert caught.value.cause is FaultCause.NO_ANSWER
        assert time.monotonic() - begun < 5.0
        assert power.stand_down() == "current ramped down, drive disarmed"
    assert drive.done == ["arm", "ramp_down", "disarm"]


def test_a_drive_that_does_not_even_ramp_down_is_disarmed_all_the_same() -> None:
    drive = SilentDrive(ramps=False)
    with handling_signals() as interrupts:
        power = stage(drive, interrupts)
        power.arm()
        message = power.stand_down()
    assert "ramping down failed" in message
    assert "watchdog" in message
    assert drive.done == ["arm", "disarm"]


def test_the_heart_beats_while_armed_and_no_longer() -> None:
    drive = SilentDrive(ramps=True)
    power = stage(drive, Interrupts())
    power.arm()
    time.sleep(0.3)
    power.stand_down()
    beats = list(drive.beats)
    assert len(beats) >= 3
    time.sleep(0.15)
    assert drive.beats == beats


def test_standing_down_twice_says_nothing_the_second_time() -> None:
    drive = SilentDrive(ramps=True)
    power = stage(drive, Interrupts())
    power.arm()
    assert power.stand_down()
    assert power.stand_down() == ""
    assert drive.done.count("disarm") == 1


def test_an_open_interlock_is_seen_before_anything_is_energised() -> None:
    class Guarded(SilentDrive):
        def telemetry(self) -> Telemetry:
            reading = {"time_s": 0.0, "i_d_a": 0.0, "i_q_a": 0.0, "v_dc_v": 48.0}
            return Telemetry(state=DriveState.DISARMED, open_interlocks=("door",), **reading)

    drive: Any = Guarded(ramps=True)
    limits, guarded = Limits(current_a=1.0, voltage_v=10.0), CAPABILITIES.model_copy(update={"interlocks": ("door",)})
    with pytest.raises(DriveFault, match="door"):
        PowerStage(drive, guarded, limits, Interrupts()).arm()
    assert drive.done == []
