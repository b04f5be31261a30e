"""The device alone, on a clock of its own: what it refuses, when it trips, what it keeps, how much it says."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from plugins.commands.emulator import Device, DeviceSettings
from plugins.drives.simulated import SimulatedOptions
from plugins.wire import (
    CLASSIC_LAYOUT,
    HEARTBEAT_PERIOD_S,
    PROTOCOL_MAJOR,
    Ack,
    AckStatus,
    BlockLayout,
    CaptureFormat,
    Channel,
    Conversation,
    EStop,
    Fault,
    Frame,
    Measurement,
    Message,
    Op,
    ParameterValue,
    ParameterWrite,
    Phase,
    PowerState,
    Progress,
    ReadBlock,
    RippleD,
    Setpoint,
    SetpointKind,
    Status,
    Tick,
    answers,
    capture_registers,
    decode,
    encode,
    limit_registers,
    motor_registers,
    program_registers,
    register_index,
)
from protocols import Excitation, GatesOff, Hold, Injection, Limits, Motor, Trapezoid

FS = 10_000.0
PM400 = Motor(
    name="400 W test PMSM",
    pole_pairs=2,
    rated_voltage_rms_v=139.3,
    rated_current_rms_a=1.66,
    rated_torque_nm=2.12,
    stator_resistance_ohm=4.25,
    d_inductance_h=0.04325,
    q_inductance_h=0.06905,
    pm_flux_wb=0.30,
)
LIMITS = Limits(current_a=3.0, voltage_v=150.0)
HOLD = Hold(current_d_a=0.5, current_q_a=1.0, settle_s=0.2, duration_s=0.3)


def injection(**changes: Any) -> Injection:
    fields: dict[str, Any] = {
        "target_d_a": 0.5,
        "target_q_a": 1.0,
        "settle_s": 0.2,
        "duration_s": 1.0,
        "amplitude_v": 20.0,
        "frequency_hz": 500.0,
        "rotation_hz": 4.0,
    }
    return Injection(**{**fields, **changes})


def classic(block_bytes: int) -> BlockLayout:
    return CLASSIC_LAYOUT


class Desk:
    """A device, its clock, and a host that is always right there."""

    def __init__(self, settings: DeviceSettings | None = None, **options: Any) -> None:
        self.now_s = 100.0
        self.events: list[dict[str, Any]] = []
        quiet = {"plant": {"sensors": {"noise_a": 0.0, "quantum_a": 0.0}}}
        made = SimulatedOptions.model_validate({**quiet, **options})
        self.device = Device(made, PM400, 1, classic, settings, self._log, lambda: self.now_s)
        self.conversation = Conversation()
        self.beating = False
        self.received: list[Frame] = []

    def _log(self, event: str, **details: Any) -> None:
        self.events.append({"event": event, **details})

    def logged(self, event: str) -> list[dict[str, Any]]:
        return [e for e in self.events if e["event"] == event]

    def send(self, message: Message) -> list[Message]:
        """One message; what is answered at once."""
        self.device.receive([encode(message)])
        frames = [*self.device.urgent, *self.device.bulk]
        self.device.urgent.clear()
        self.device.bulk.clear()
        return [m for m in (decode(*frame) for frame in frames) if m is not None]

    def ask(self, op: Op, arg: int = 0) -> Ack:
        request = self.conversation.command(op, arg)
        reply = next(m for m in self.send(request) if answers(m, request))
        assert isinstance(reply, Ack)
        return reply

    def write(self, **values: float) -> AckStatus:
        for name, value in values.items():
            request = ParameterWrite(*self.conversation.write(register_index(name), 0.0)[:3], value)
            reply = next(m for m in self.send(request) if answers(m, request))
            if isinstance(reply, Ack):
                return reply.status
        return AckStatus.OK

    def read(self, name: str) -> float:
        reply = self.send(self.conversation.read(register_index(name)))[0]
        assert isinstance(reply, ParameterValue)
        return reply.value

    def arm(self, limits: Limits = LIMITS) -> AckStatus:
        self.ask(Op.IDENTIFY, PROTOCOL_MAJOR)
        status = self.write(**limit_registers(limits))
        if status is not AckStatus.OK:
            return status
        ack = self.ask(Op.ARM)
        if ack.status is AckStatus.OK:
            self.conversation.armed(ack)
            self.beating = True
        return ack.status

    def run(self, excitation: Excitation, **capture: Any) -> AckStatus:
        channels = capture.pop("channels", Channel.I_ALPHA | Channel.I_BETA)
        status = self.write(**program_registers(excitation, FS), **capture_registers(channels, **capture))
        return status if status is not AckStatus.OK else self.ask(Op.RUN_PROGRAM).status

    def pass_time(self, seconds: float, until: Callable[[], bool] = lambda: False) -> list[Frame]:
        """Turns of 2 ms with heartbeats; the device's frames."""
        frames: list[Frame] = []
        beat_s = -math.inf
        for _ in range(round(seconds / 2e-3)):
            self.now_s += 2e-3
            self.device.power.guard(self.now_s)
            if self.beating and self.now_s - beat_s >= HEARTBEAT_PERIOD_S:
                beat_s = self.now_s
                self.device.receive([encode(self.conversation.heartbeat(self.now_s))])
            self.device.turn()
            frames += self.device.urgent
            self.device.urgent.clear()
            if until():
                break
        return frames

    @property
    def state(self) -> PowerState:
        return self.device.power.state


@pytest.fixture
def desk() -> Desk:
    return Desk()


# What it refuses


def test_what_is_no_number_or_past_a_limit_is_not_taken(desk: Desk) -> None:
    desk.ask(Op.IDENTIFY, PROTOCOL_MAJOR)
    own = desk.read("max_current_a")
    assert desk.write(limit_current_a=math.nan) is AckStatus.NOT_A_NUMBER
    assert desk.write(limit_current_a=math.inf) is AckStatus.NOT_A_NUMBER
    assert desk.write(limit_current_a=1.01 * own) is AckStatus.PAST_LIMIT
    assert desk.write(limit_current_a=own) is AckStatus.OK
    assert desk.write(max_current_a=1.0) is AckStatus.READ_ONLY
    assert desk.read("limit_current_a") == own


def test_limits_cannot_be_moved_while_armed(desk: Desk) -> None:
    desk.arm()
    assert desk.write(limit_current_a=1.0) is AckStatus.WRONG_STATE


@pytest.mark.parametrize(
    ("excitation", "status"),
    [
        (Hold(current_d_a=-2.5, current_q_a=2.5, settle_s=0.1, duration_s=0.1), AckStatus.PAST_LIMIT),
        (injection(amplitude_v=149.0), AckStatus.PAST_LIMIT),
        (Hold(current_d_a=0.0, current_q_a=1.0, settle_s=3600.0, duration_s=1.0), AckStatus.TOO_LONG),
        (Trapezoid(swept_axis="q", amplitude_a=1.0, period_s=1e-3, periods=20_000, settle_s=0.0), AckStatus.TOO_LONG),
        (HOLD.model_copy(update={"pwm_frequency_hz": 7777.0}), AckStatus.NOT_SUPPORTED),
        (GatesOff(duration_s=1e-6), AckStatus.OUT_OF_RANGE),
    ],
)
def test_a_program_that_is_not_allowed_does_not_start(desk: Desk, excitation: Excitation, status: AckStatus) -> None:
    desk.arm()
    assert desk.run(excitation) is status
    assert desk.state is PowerState.HOLDING
    assert desk.logged("refused")


def test_memory_is_as_large_as_it_says() -> None:
    desk = Desk(DeviceSettings(memory_rows=1000, ring=False))
    desk.arm()
    assert desk.read("capture_memory_bytes") == 8000.0
    assert desk.run(HOLD, channels=Channel(15)) is AckStatus.NO_MEMORY
    assert desk.run(HOLD.model_copy(update={"duration_s": 0.1}), channels=Channel(15)) is AckStatus.OK


def test_rows_that_the_ring_has_gone_over_are_refused() -> None:
    desk = Desk(DeviceSettings(memory_rows=1000))
    desk.arm()
    desk.run(HOLD, channels=Channel(15))
    desk.pass_time(0.7)
    reply = desk.send(ReadBlock(0, 5, 10, 1))[0]
    assert isinstance(reply, Ack)
    assert (reply.op, reply.seq, reply.status) == (Op.READ_BLOCK, 5, AckStatus.OVERWRITTEN)
    latest = desk.send(ReadBlock(2500 * 8 // 6 * 6, 6, 10, 1))
    assert latest[-1].length == 3000 * 8  # type: ignore[union-attr]


def test_channels_that_it_does_not_measure_are_refused(desk: Desk) -> None:
    desk.arm()
    assert desk.run(HOLD, channels=Channel.TEMPERATURE) is AckStatus.NOT_SUPPORTED


def test_set_points_are_refused_and_another_version_too(desk: Desk) -> None:
    assert desk.ask(Op.IDENTIFY, PROTOCOL_MAJOR + 1).status is AckStatus.WRONG_VERSION
    desk.arm()
    answer = desk.send(Setpoint(1, SetpointKind.CURRENT, desk.conversation.session & 15, 0.0, 1, 1))
    assert [m.status for m in answer if isinstance(m, Ack)] == [AckStatus.NOT_SUPPORTED]


def test_a_repeated_command_does_nothing_twice(desk: Desk) -> None:
    desk.arm()
    desk.write(**program_registers(HOLD, FS))
    request = desk.conversation.command(Op.RUN_PROGRAM)
    first, second = desk.send(request), desk.send(request)
    assert first == second
    assert desk.read("capture_number") == 1.0


# What it runs


def test_a_program_goes_through_its_phases_and_ends_holding(desk: Desk) -> None:
    desk.arm()
    desk.run(HOLD)
    messages = [decode(*frame) for frame in desk.pass_time(0.7)]
    phases = [m.phase for m in messages if isinstance(m, Progress)]
    assert list(dict.fromkeys(phases)) == [Phase.RAMPING, Phase.SETTLING, Phase.CAPTURING, Phase.COMPLETE]
    assert desk.state is PowerState.HOLDING
    measured = [m for m in messages if isinstance(m, Measurement)][-1]
    assert measured.i_q * desk.read("current_scale_a") == pytest.approx(1.0, abs=0.01)
    assert desk.read("energy_used_j") == pytest.approx(1.5 * 4.25 * 1.25 * 0.7, rel=0.2)


def test_stopping_gives_up_the_program_and_holds_zero(desk: Desk) -> None:
    desk.arm()
    desk.run(HOLD.model_copy(update={"duration_s": 10.0}))
    desk.pass_time(0.5)
    desk.ask(Op.STOP)
    assert desk.state is PowerState.STOPPING
    desk.pass_time(1.0, until=lambda: desk.state is PowerState.HOLDING)
    assert desk.device.power.phase is Phase.GIVEN_UP
    assert desk.device.rig.reading_a < 0.01


def test_what_is_held_can_be_captured(desk: Desk) -> None:
    desk.arm()
    desk.run(HOLD)
    desk.pass_time(0.6)
    assert desk.ask(Op.CAPTURE_TRIGGER).status is AckStatus.WRONG_STATE
    number = desk.ask(Op.CAPTURE_ARM, 500).value
    assert desk.ask(Op.CAPTURE_TRIGGER).value == number
    desk.pass_time(0.1)
    assert (number, desk.device.power.phase) == (2, Phase.COMPLETE)
    blocks = desk.send(ReadBlock(0, 0, 0, number))
    assert blocks[-1].length == 500 * 4  # type: ignore[union-attr]


def test_gates_stay_off_after_gates_off(desk: Desk) -> None:
    desk.arm()
    desk.run(HOLD)
    desk.pass_time(0.6)
    desk.run(GatesOff(duration_s=0.1))
    desk.pass_time(0.6)
    assert desk.state is PowerState.HOLDING
    assert desk.device.rig.reading_a < 1e-3


def test_without_a_pace_time_stands_still_between_programs() -> None:
    desk = Desk(DeviceSettings(speed=None))
    desk.arm()
    before = desk.device.rig.ticks
    desk.pass_time(0.5)
    assert desk.device.rig.ticks == before
    desk.run(HOLD)
    desk.pass_time(1.0, until=lambda: desk.state is PowerState.HOLDING)
    assert desk.device.rig.ticks == before + 5000


def test_the_nameplate_of_the_host_tunes_the_control(desk: Desk) -> None:
    desk.ask(Op.IDENTIFY, PROTOCOL_MAJOR)
    desk.write(**motor_registers(PM400))
    desk.arm()
    assert desk.device.rig.nameplate == desk.device.rig.own_nameplate
    desk.ask(Op.DISARM)
    desk.write(motor_resistance_ohm=5.5)
    desk.arm()
    assert desk.device.rig.nameplate.resistance_ohm == 5.5


# What makes it trip


def test_overcurrent_opens_the_gates_at_once_and_stays_latched(desk: Desk) -> None:
    desk.arm(Limits(current_a=1.5, voltage_v=150.0))
    assert desk.run(injection(amplitude_v=60.0, frequency_hz=5.0)) is AckStatus.OK
    desk.pass_time(2.0, until=lambda: desk.state is PowerState.FAULTED)
    assert desk.device.rig.reading_a < 0.01
    assert desk.read("fault_cause") == Fault.OVERCURRENT
    assert desk.read("fault_value") > desk.read("fault_limit") == pytest.approx(1.2 * 1.5)
    assert desk.ask(Op.RUN_PROGRAM).status is AckStatus.FAULT_LATCHED
    assert desk.ask(Op.ARM).status is AckStatus.FAULT_LATCHED
    desk.ask(Op.DISARM)
    assert desk.state is PowerState.FAULTED
    desk.ask(Op.CLEAR_FAULT)
    assert desk.arm(LIMITS) is AckStatus.OK


def test_too_much_current_for_too_long_is_an_overload() -> None:
    desk = Desk(overload_s=0.2)
    desk.arm(Limits(current_a=5.0, voltage_v=150.0))
    desk.run(Hold(current_d_a=0.0, current_q_a=4.5, settle_s=0.1, duration_s=5.0))
    desk.pass_time(3.0, until=lambda: desk.state is PowerState.FAULTED)
    assert desk.read("fault_cause") == Fault.OVERLOAD


@pytest.mark.parametrize("limits", [{"energy_j": 1.0}, {"duration_s": 0.4}])
def test_energy_and_duration_are_the_experiments(desk: Desk, limits: dict[str, float]) -> None:
    desk.arm(LIMITS.model_copy(update=limits))
    desk.run(HOLD.model_copy(update={"duration_s": 10.0}))
    desk.pass_time(3.0, until=lambda: desk.state is PowerState.FAULTED)
    assert desk.read("fault_cause") == Fault.LIMIT
    desk.pass_time(0.03)
    assert [e["cause"] for e in desk.logged("safe")] == ["limit"]


def test_a_program_that_does_not_end_is_given_up_and_stays_latched(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    desk.arm()
    rig = desk.device.rig
    monkeypatch.setattr(rig, "excite", lambda excitation, samples: rig.hold(samples))
    assert desk.run(HOLD) is AckStatus.OK
    desk.pass_time(0.49)
    assert desk.state is PowerState.RUNNING
    desk.pass_time(0.1, until=lambda: desk.state is PowerState.FAULTED)
    assert desk.read("fault_cause") == Fault.PROGRAM_TOO_LONG
    assert desk.read("fault_value") > desk.read("fault_limit") == pytest.approx(0.5)
    assert desk.device.power.phase is Phase.GIVEN_UP
    desk.pass_time(0.03)
    assert [e["cause"] for e in desk.logged("safe")] == ["program_too_long"]
    assert desk.ask(Op.RUN_PROGRAM).status is AckStatus.FAULT_LATCHED
    assert desk.ask(Op.ARM).status is AckStatus.FAULT_LATCHED
    desk.ask(Op.CLEAR_FAULT)
    assert desk.arm() is AckStatus.OK


def test_no_program_is_longer_than_the_device_says() -> None:
    desk = Desk(DeviceSettings(longest_program_s=0.4))
    desk.arm()
    assert desk.read("longest_program_s") == pytest.approx(0.4)
    assert desk.run(HOLD) is AckStatus.TOO_LONG
    assert desk.run(HOLD.model_copy(update={"duration_s": 0.2})) is AckStatus.OK
    desk.pass_time(0.5)
    assert (desk.state, desk.device.power.phase) == (PowerState.HOLDING, Phase.COMPLETE)


def test_the_first_cause_is_kept_and_what_follows_is_reported(desk: Desk) -> None:
    desk.arm()
    desk.run(HOLD)
    desk.pass_time(0.1)
    desk.beating = False
    desk.pass_time(0.3)
    desk.send(EStop())
    status = [m for m in (decode(*f) for f in desk.pass_time(0.1)) if isinstance(m, Status)][-1]
    assert (status.state, status.cause) == (PowerState.FAULTED, Fault.WATCHDOG)
    assert status.faults == 1 << Fault.WATCHDOG | 1 << Fault.EMERGENCY_STOP
    safe = desk.logged("safe")
    assert len(safe) == 1
    assert 0.2 < safe[0]["latency_s"] <= 0.22


def test_an_emergency_stop_while_disarmed_is_latched_too(desk: Desk) -> None:
    desk.send(EStop())
    assert desk.state is PowerState.FAULTED
    desk.ask(Op.IDENTIFY, PROTOCOL_MAJOR)
    assert desk.ask(Op.ARM).status is AckStatus.FAULT_LATCHED


def test_a_device_that_was_stopped_trips_before_it_hears_what_queued(desk: Desk) -> None:
    desk.arm()
    desk.pass_time(0.1)
    queued = [encode(desk.conversation.heartbeat(desk.now_s + 0.05 * k)) for k in range(10)]
    desk.now_s += 0.5
    desk.device.power.guard(desk.now_s)
    desk.device.receive(queued)
    assert desk.state is PowerState.FAULTED


def test_safety_does_not_wait_for_a_slow_plant() -> None:
    desk = Desk(DeviceSettings(speed=0.05))
    desk.arm()
    desk.run(HOLD)
    desk.pass_time(0.5)
    desk.beating = False
    desk.pass_time(0.4)
    assert 0.2 < desk.logged("safe")[0]["latency_s"] <= 0.22


# What it keeps


def test_the_plant_survives_a_restart(tmp_path: Path) -> None:
    settings = DeviceSettings(speed=None, directory=tmp_path)
    desk = Desk(settings)
    desk.arm()
    desk.run(HOLD)
    desk.pass_time(1.0, until=lambda: desk.state is PowerState.HOLDING)
    desk.ask(Op.DISARM)
    again = Desk(settings)
    assert again.device.rig.ticks >= desk.device.rig.ticks
    assert again.device.rig.number == 1


def test_the_brake_is_a_register() -> None:
    desk = Desk()
    desk.ask(Op.IDENTIFY, PROTOCOL_MAJOR)
    assert desk.read("brake") == 1.0
    assert desk.write(brake=0.0) is AckStatus.OK
    assert not desk.device.rig.braked
    without = Desk(has_brake=False)
    without.ask(Op.IDENTIFY, PROTOCOL_MAJOR)
    assert without.write(brake=0.0) is AckStatus.NOT_SUPPORTED


# How much it says


def test_live_ripple_and_telemetry_take_less_than_15_percent_of_a_classic_bus(desk: Desk) -> None:
    desk.arm()
    desk.write(**program_registers(injection(duration_s=2.0), FS))
    desk.write(**capture_registers(Channel(0), CaptureFormat.INT16, ripple_periods=1) | {"ripple_live": 1.0})
    desk.ask(Op.RUN_PROGRAM)
    desk.pass_time(1.0, until=lambda: desk.device.power.phase is Phase.CAPTURING)
    frames = desk.pass_time(1.0)
    rows = sum(isinstance(decode(*frame), RippleD) for frame in frames)
    assert rows == pytest.approx(500, abs=10)
    # 34 + 8 n of the 47 + 8 n bits can be stuffed: at worst one after the first five and one after every four more.
    bits = [47 + 8 * len(p) + (34 + 8 * len(p) - 1) // 4 for _, p in frames]
    heartbeats = 20 * (47 + 56 + (34 + 56 - 1) // 4)
    assert sum(bits) + heartbeats < 0.15 * 1e6


def test_telemetry_comes_at_its_pace(desk: Desk) -> None:
    kinds = [type(decode(*frame)) for frame in desk.pass_time(2.0)]
    assert kinds.count(Status) == pytest.approx(40, abs=2)
    assert kinds.count(Measurement) == pytest.approx(40, abs=2)
    assert kinds.count(Tick) == 2
