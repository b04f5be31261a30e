"""The device: the drive's side of the protocol, from received to sent frames.

This module processes and refuses requests; `_power` acts on its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from plugins.commands.emulator._bounds import BOUNDS
from plugins.commands.emulator._log import Log, no_log
from plugins.commands.emulator._memory import Capture
from plugins.commands.emulator._power import PowerStage
from plugins.commands.emulator._programs import DeviceSettings, Programs, facts_of_rig
from plugins.commands.emulator._telemetry import Telemetry
from plugins.drives.simulated import SimulatedOptions
from plugins.drives.simulated.rig import Rig
from plugins.wire import (
    DESCRIPTION_CAPTURE,
    NO_TEMPERATURE_C,
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    Ack,
    AckStatus,
    Answer,
    BlockLayout,
    CaptureSource,
    Command,
    EStop,
    Fault,
    Frame,
    Heartbeat,
    Ledger,
    Message,
    Op,
    ParameterRead,
    ParameterValue,
    ParameterWrite,
    PowerState,
    ReadBlock,
    RegisterFile,
    Setpoint,
    Verdict,
    capability_registers,
    decode,
    encode,
    frame_id,
    interlocks_line,
    limits_of,
    register_name,
    single,
)
from protocols import Motor

_LIMIT_OF = {"limit_current_a": "max_current_a", "limit_voltage_v": "max_voltage_v"}
_FROM_HOST = ("EStop", "Heartbeat", "Command", "ParameterWrite", "ParameterRead", "Setpoint", "ReadBlock")


class Device:
    """An emulated drive with firmware.

    Parameters
    ----------
    options : SimulatedOptions
    motor : Motor
        The nameplate from which the plant is scaled; the control uses it until a host writes another one.
    seed : int
    layout : callable
        Maps the device's block size to the link's block layout.
    settings : DeviceSettings
    log : Log
    clock : callable
        Wall time [s], monotonic.

    Raises `InputError` where the options do not describe a motor.
    """

    def __init__(
        self,
        options: SimulatedOptions,
        motor: Motor,
        seed: int,
        layout: Callable[[int], BlockLayout],
        settings: DeviceSettings | None = None,
        log: Log = no_log,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._settings, self._log, self._clock = settings or DeviceSettings(), log, clock
        self.rig = Rig(options, motor, seed)
        self.rig.warm_up()
        if self._settings.directory is not None:
            self.rig.load(self._settings.directory)
        own = self.rig.capabilities
        inputs = partial(open_inputs, own.interlocks, self._settings.interlocks if own.interlocks else None)
        self.power = PowerStage(self.rig, clock, self._settings.speed, log, self._settings.directory, inputs)
        about = {"name": "fluxbench emulator", "motor": own.motor_name or motor.name, "serial": str(seed)}
        lines = [f"{key}: {' '.join(value.split())}" for key, value in (about | {"clock": "simulated"}).items()]
        text = "\n".join([*lines, *([interlocks_line(own.interlocks)] if own.interlocks else [])])
        self._description = CaptureSource.complete_with(DESCRIPTION_CAPTURE, text.encode())
        self._layout = layout(self._settings.block_bytes)
        self._facts = facts_of_rig(self.rig, self._settings, text)
        self._file = RegisterFile(capability_registers(own, self._facts))
        self._update_temperature()
        self._file["brake"] = float(self.rig.braked)
        self._programs = Programs(self.rig, self._file, self._facts, self._settings)
        self._ledger = Ledger()
        self._telemetry = Telemetry(clock())
        self._armed_capture: Capture | None = None
        self._live_credit, self._live_s = 0.0, clock()
        self._host_ids = {frame_id(name) for name in _FROM_HOST}
        self.urgent: list[Frame] = []
        """Frames for the caller to send, before `bulk`."""
        self.bulk: list[Frame] = []

    # Cycle

    def receive(self, frames: Iterable[Frame]) -> None:
        """Process received frames; to be called after `power.guard`."""
        for frame in frames:
            message = decode(*frame) if frame.frame_id in self._host_ids else None
            if message is not None:
                for reply in self._respond(message):
                    self.urgent.append(encode(reply))

    def turn(self) -> None:
        """Advance the plant and queue the messages that are due."""
        rows = self.power.advance()
        if rows and self._file["ripple_live"]:
            self.urgent += map(encode, self._limit_rate(rows))
        self.urgent += map(encode, self._telemetry_messages())

    def wait_s(self) -> float:
        """Time until the next action [s]."""
        return min(self.power.wait_s(), self._telemetry.wait_s(self._clock()))

    def _limit_rate(self, rows: list[Message]) -> list[Message]:
        """Live rows within the permitted rate of 500 a second; each row has two messages."""
        now_s = self._clock()
        earned = self._live_credit + (now_s - self._live_s) * BOUNDS.ripple_rate_hz
        self._live_s, room = now_s, min(earned, 0.05 * BOUNDS.ripple_rate_hz)
        sent = min(len(rows) // 2, int(room + 1e-6))
        self._live_credit = room - sent
        return rows[: 2 * sent]

    def _telemetry_messages(self) -> Iterator[Message]:
        now_s, power, period_s = self._clock(), self.power, self._file["telemetry_period_s"]
        shown = self.rig.simulator.filtered
        temperature_c = self._update_temperature()
        yield from self._telemetry.status(
            now_s, power.state, power.cause, power.faults, power.last_beat, shown[2], temperature_c
        )
        scale_a, inputs = self._facts.scales.current_a, power.open_interlocks
        yield from self._telemetry.periodic(now_s, period_s, shown, scale_a, self.rig.ticks, inputs)
        rows = power.capture.done if power.capture else 0
        number = power.capture.number if power.capture else 0
        busy = power.state is PowerState.RUNNING
        yield from self._telemetry.progress(now_s, power.phase, number, rows, busy)

    def _update_temperature(self) -> int:
        """Write the winding temperature to its register; returns it in telemetry's form."""
        measured = self.rig.simulator.temperature_c
        self._file["temperature_c"] = -273.0 if measured is None else measured
        return NO_TEMPERATURE_C if measured is None else round(min(max(measured, -127.0), 127.0))

    # Messages

    def _respond(self, message: Message) -> Iterator[Message]:
        match message:
            case EStop():
                self.power.trip(Fault.EMERGENCY_STOP)
            case Heartbeat():
                self.power.feed(message, self._ledger.session, self._clock())
            case ReadBlock():
                yield from self._read_blocks(message)
            case ParameterRead():
                self._ledger.judge(message)
                yield self._read(message)
            case Setpoint() if message.session_low == self._ledger.session & 15:
                status = AckStatus.NOT_SUPPORTED
                yield Ack(self._ledger.session, message.seq, Op.SETPOINT, status, self.power.state)
            case Command() | ParameterWrite():
                yield from self._request(message)
            case _:
                pass

    def _request(self, request: Command | ParameterWrite) -> Iterator[Message]:
        op = request.op if isinstance(request, Command) else Op.PARAMETER_WRITE
        match self._ledger.judge(request):
            case Verdict.OLD:
                return
            case Verdict.STALE:
                yield Ack(request.session, request.seq, op, AckStatus.STALE_SESSION, self.power.state)
            case Verdict.REPEATED:
                yield self._ledger.reply
            case Verdict.NEW:
                reply = self._ledger.store(request, self._reply(request, op))
                if isinstance(reply, Ack) and reply.status is not AckStatus.OK:
                    self._log("refused", op=op.name.lower(), status=reply.status.name.lower())
                yield reply
                if op is Op.TIME_SYNC:
                    yield self._telemetry.tick(self._clock(), self.rig.ticks)

    def _reply(self, request: Command | ParameterWrite, op: Op) -> Ack | ParameterValue:
        if isinstance(request, ParameterWrite):
            status = self._write(request.parameter, request.value)
            if status is AckStatus.OK:
                held = self._file.read(request.parameter)
                return ParameterValue(request.session, request.seq, request.parameter, float(held))
            value = 0
        else:
            status, value = self._execute(request)
        return Ack(request.session, request.seq, op, status, self.power.state, value)

    def _execute(self, command: Command) -> tuple[AckStatus, int]:
        match command.op:
            case Op.IDENTIFY:
                return self._identify(command)
            case Op.ARM:
                return self._arm()
            case Op.DISARM:
                was_energised = self.power.energised
                self.power.disarm()
                if was_energised:
                    self._log("disarmed")
            case Op.CLEAR_FAULT:
                self._log("cleared", faults=self.power.faults)
                self.power.clear()
            case Op.RUN_PROGRAM:
                return self._run_program()
            case Op.STOP:
                if self.power.energised:
                    self._log("stop")
                self.power.stop()
            case Op.CAPTURE_ARM:
                return self._capture_arm(command.arg)
            case Op.CAPTURE_TRIGGER:
                return self._capture_trigger()
            case Op.TIME_SYNC:
                pass
            case _:
                return AckStatus.UNKNOWN, 0
        return AckStatus.OK, 0

    # Sessions and arming

    def _identify(self, command: Command) -> tuple[AckStatus, int]:
        version = PROTOCOL_MAJOR * 256 + PROTOCOL_MINOR
        if self.power.energised and command.session != self._ledger.session:
            return AckStatus.BUSY, version
        self._ledger.open(command)
        self._file["ripple_curvature"] = 0.0  # a host of version 1.0 does not write it
        self._log("identified", session=command.session)
        return (AckStatus.OK if command.arg == PROTOCOL_MAJOR else AckStatus.WRONG_VERSION), version

    def _arm(self) -> tuple[AckStatus, int]:
        if self.power.faults or self.power.state is PowerState.FAULTED:
            return AckStatus.FAULT_LATCHED, 0
        if self.power.state is not PowerState.DISARMED:
            return AckStatus.WRONG_STATE, 0
        try:
            limits = limits_of(self._file.values())
        except ValueError:
            return AckStatus.OUT_OF_RANGE, 0
        if any(self._file[name] > self._file[own] for name, own in _LIMIT_OF.items()):
            return AckStatus.PAST_LIMIT, 0
        if self.power.open_interlocks:
            return AckStatus.INTERLOCK_OPEN, self.power.open_interlocks
        self._apply_nameplate()
        self.power.arm(limits)
        session = self._ledger.issue()
        self._log("armed", session=session, limits=limits.model_dump())
        return AckStatus.OK, session

    def _apply_nameplate(self) -> None:
        """Use the host's nameplate, except for values that equal the device's own, which are more precise."""
        own, file = self.rig.own_nameplate, self._file

        def register(name: str, value: float) -> float:
            return value if file[name] in (0.0, single(value)) else file[name]

        self.rig.retune(
            replace(
                own,
                pole_pairs=int(register("motor_pole_pairs", own.pole_pairs)),
                rated_a=register("motor_rated_current_a", own.rated_a),
                resistance_ohm=register("motor_resistance_ohm", own.resistance_ohm),
                l_d_h=register("motor_inductance_d_h", own.l_d_h),
                l_q_h=register("motor_inductance_q_h", own.l_q_h),
                pm_flux_wb=register("motor_flux_wb", own.pm_flux_wb),
            )
        )

    # Registers

    def _read(self, request: ParameterRead) -> Message:
        self._refresh()
        value = self._file.read(request.parameter)
        if isinstance(value, AckStatus):
            return Ack(request.session, request.seq, Op.PARAMETER_READ, value, self.power.state)
        return ParameterValue(request.session, request.seq, request.parameter, value)

    def _refresh(self) -> None:
        power, file = self.power, self._file
        file["fault_cause"], file["fault_bits"] = float(power.cause), float(power.faults)
        file["fault_value"], file["fault_limit"] = power.value, power.limit
        file["energy_used_j"] = min(power.energy_j, 1e9)
        file["capture_start_low"] = float(power.capture_start % 65536)
        file["capture_start_high"] = float(power.capture_start // 65536 % 65536)
        if power.capture is not None and power.capture.ripple is not None:
            file["base_voltage_d_v"], file["base_voltage_q_v"] = power.capture.ripple.base_v

    def _write(self, index: int, value: float) -> AckStatus:
        status = self._file.check(index, value, self.power.state)
        if status is not AckStatus.OK:
            return status
        name = register_name(index) or ""
        own = _LIMIT_OF.get(name)
        if own is not None and value > self._file[own]:
            return AckStatus.PAST_LIMIT
        if name == "brake":
            if not self.rig.capabilities.has_brake:
                return AckStatus.NOT_SUPPORTED
            self.rig.set_brake(value == 1.0)
            self._log("brake", engaged=self.rig.braked)
        return self._file.write(index, value, self.power.state)

    # Programs

    def _run_program(self) -> tuple[AckStatus, int]:
        if (status := self._require_holding()) is not AckStatus.OK:
            return status, 0
        excitation = self._programs.excitation()
        if isinstance(excitation, AckStatus):
            return excitation, 0
        rows = excitation.rows(self.rig.capabilities.sampling_frequency_hz)
        capture = self._programs.capture(rows, excitation)
        if isinstance(capture, AckStatus):
            return capture, 0
        self._armed_capture = None
        self._log("program", capture=capture.number, kind=excitation.kind, rows=rows)
        self.power.run(excitation, capture)
        return AckStatus.OK, capture.number

    def _require_holding(self) -> AckStatus:
        if self.power.state is PowerState.FAULTED:
            return AckStatus.FAULT_LATCHED
        return AckStatus.OK if self.power.state is PowerState.HOLDING else AckStatus.WRONG_STATE

    def _capture_arm(self, rows: int) -> tuple[AckStatus, int]:
        if (status := self._require_holding()) is not AckStatus.OK:
            return status, 0
        if not 1 <= rows <= 16_000_000:
            return AckStatus.OUT_OF_RANGE, 0
        capture = self._programs.capture(rows, None)
        if isinstance(capture, AckStatus):
            return capture, 0
        self._armed_capture = capture
        return AckStatus.OK, capture.number

    def _capture_trigger(self) -> tuple[AckStatus, int]:
        if (status := self._require_holding()) is not AckStatus.OK:
            return status, 0
        if self._armed_capture is None:
            return AckStatus.WRONG_STATE, 0
        capture, self._armed_capture = self._armed_capture, None
        self.power.record(capture)
        return AckStatus.OK, capture.number

    # Captures

    def _read_blocks(self, request: ReadBlock) -> Iterator[Message]:
        source = self._source(request.capture)
        # An answer may be shorter than its request, so that it does not delay the watchdog.
        request = request._replace(blocks=min(request.blocks, max(1, BOUNDS.max_answer_bytes // self._layout.block)))
        answer = AckStatus.NOT_CAPTURED if source is None else source.answer(request, self._layout)
        if isinstance(answer, Answer):
            self.bulk += [Frame(self._layout.frame_id, payload) for payload in answer.payloads]
            self.bulk.append(encode(answer.end))
        else:
            yield Ack(self._ledger.session, request.window, Op.READ_BLOCK, answer, self.power.state)

    def _source(self, number: int) -> CaptureSource | None:
        if number == DESCRIPTION_CAPTURE:
            return self._description
        return self.power.capture.source(number) if self.power.capture is not None else None


def open_inputs(names: Sequence[str], file: Path | None) -> int:
    """Bits of the open interlock inputs, which a file lists one per line, in the order of `names`."""
    try:
        lines = set() if file is None else set(map(str.strip, file.read_text("utf-8", "replace").splitlines()))
    except OSError:
        return 0
    return sum(1 << bit for bit, name in enumerate(names) if name in lines)
