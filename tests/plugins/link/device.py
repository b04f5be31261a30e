"""A small drive for tests of the host: the drive's half of the protocol, instant currents, and ways to misbehave."""

from __future__ import annotations

import contextlib
import math
import os
import threading
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from plugins.wire import (
    CAN_FD_LAYOUT,
    CLASSIC_LAYOUT,
    DESCRIPTION_CAPTURE,
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    RIPPLE_FLAG,
    Ack,
    AckStatus,
    Answer,
    BlockLayout,
    Capability,
    CaptureFormat,
    CaptureSource,
    Channel,
    Command,
    DriveFacts,
    EStop,
    Fault,
    Frame,
    Heartbeat,
    Ledger,
    Measurement,
    Message,
    Op,
    ParameterRead,
    ParameterValue,
    ParameterWrite,
    Phase,
    PowerState,
    Progress,
    ReadBlock,
    RegisterFile,
    RippleGrid,
    RowFormat,
    Scales,
    SerialDecoder,
    Status,
    Tick,
    Verdict,
    Watchdog,
    all_to_serial,
    capability_registers,
    decode,
    demodulate,
    encode,
    limits_of,
    program_of,
    register_name,
    serial_blocks,
)
from protocols import Capabilities, Excitation, GatesOff, Hold, Injection, Trapezoid

FS = 2000.0
WATCHDOG_S = 0.6
"""Longer than that of drives: here both ends share one interpreter with everything else on the machine."""
RESISTANCE_OHM, INDUCTANCE_H = 4.0, 0.05
OWN = Capabilities(
    name="test device",
    sampling_frequency_hz=FS,
    pwm_frequency_hz=8000.0,
    pwm_frequencies_hz=(4000.0, 8000.0),
    dc_bus_voltage_v=300.0,
    voltage_delay_samples=1.0,
    max_current_a=5.6,
    max_voltage_v=170.0,
    excitations=frozenset({"gates_off", "hold", "trapezoid", "injection"}),
    watchdog_s=WATCHDOG_S,
    watchdog_covers=frozenset({"gates_off", "hold", "trapezoid", "injection"}),
    motor_name="test motor",
)
TELEMETRY_S = 0.05


@dataclass
class Script:
    """How this device differs from one that works; a test changes it while the device runs."""

    mute: bool = False
    """Sends nothing, and hears nothing."""
    no_status: bool = False
    no_answer_to: frozenset[Op] = frozenset()
    drop_every: int = 0
    """Loses each n-th frame that it sends."""
    hold_other: dict[str, float] = field(default_factory=dict)
    """Registers that take another value than what is written."""
    progress_lost: bool = False
    wrong_crc: bool = False
    """Ends what it reads out with a CRC that is not that of the rows."""
    ring_bytes: int | None = None
    speed: float = 10.0
    """Programs run so much faster than real time."""
    bits: Capability = (
        Capability.RAW_CAPTURE | Capability.CAPTURE_RING | Capability.RIPPLE_ON_DRIVE | Capability.RIPPLE_CURVATURE
    )
    slow_blocks_s: float = 0.0
    """Takes so long to answer a request for blocks of a capture."""
    lie: Callable[[Message], Message] | None = None
    """What it says instead of each message, blocks of captures apart."""
    memory_bytes: int = 65536
    deaf_to: frozenset[Op] = frozenset()
    """Commands that it acknowledges and does not do."""
    saturated: int = 0
    """So many rows of a capture, from the first, stand at the end of the scale."""
    voltage_step_v: float = 0.0
    """Its voltages are rounded to whole multiples of this."""
    noise: Callable[[bytes], bytes] = bytes
    """What a serial line makes of the bytes that it sends at once."""
    described: str = "\nclock: simulated"
    """More lines of its description."""


class Device:
    """The drive's side: `hear` frames, `turn` the clock; both hand back what goes out."""

    def __init__(self, layout: BlockLayout, script: Script | None = None) -> None:
        self.script = script or Script()
        self.layout = layout
        text = f"name: {OWN.name}\nmotor: {OWN.motor_name}\nfirmware: 0.1" + self.script.described
        self.facts = DriveFacts(
            bits=self.script.bits,
            channels=Channel(511),
            scales=Scales.spanning(12.0, 200.0, 400.0, 6.0),
            memory_bytes=self.script.memory_bytes,
            block_bytes=240,
            ripple_rate_max_hz=100.0,
            ripple_memory_rows=4000,
            description=text,
        )
        self.description = CaptureSource.complete_with(DESCRIPTION_CAPTURE, text.encode())
        self.file = RegisterFile(capability_registers(OWN, self.facts))
        self.ledger, self.watchdog = Ledger(), Watchdog(WATCHDOG_S)
        self.state, self.fault, self.faults = PowerState.DISARMED, Fault.NONE, 0
        self.capture: CaptureSource | None = None
        self.ripple: CaptureSource | None = None
        self.arms: list[float] = []
        self.beats = 0
        self.received: list[Message] = []
        self._program: Excitation | None = None
        self._rows = b""
        self._counts = np.zeros((0, 6), dtype="<i2")
        self._begun_s = self._born_s = time.monotonic()
        self._phase = Phase.IDLE
        self._number = 0
        self._due_s = 0.0
        self._seqs = {"status": 0, "measurement": 0, "progress": 0}
        self.i_dq = (0.0, 0.0)

    # Frames

    def receive(self, frames: Sequence[Frame]) -> list[Frame]:
        out: list[Frame] = []
        for frame in frames:
            message = decode(*frame)
            if message is None or self.script.mute:
                continue
            self.received.append(message)
            out += self._respond(message)
        return self._through(out)

    def turn(self) -> list[Frame]:
        now_s = time.monotonic()
        if self.state not in (PowerState.DISARMED, PowerState.FAULTED) and self.watchdog.expired(now_s):
            self.trip(Fault.WATCHDOG, WATCHDOG_S, WATCHDOG_S)
        out = self._run(now_s)
        if now_s >= self._due_s:
            self._due_s = now_s + TELEMETRY_S
            out += self._telemetry()
        return self._through(out)

    def _through(self, frames: list[Frame]) -> list[Frame]:
        if self.script.mute:
            return []
        every, lie = self.script.drop_every, self.script.lie
        if lie is not None:
            frames = [encode(lie(message)) if (message := decode(*f)) is not None else f for f in frames]
        return [f for f in frames if not every or np.random.default_rng().integers(every)]

    def _respond(self, message: Message) -> list[Frame]:
        match message:
            case EStop():
                self.trip(Fault.EMERGENCY_STOP)
                return self._telemetry()
            case Heartbeat():
                self.beats += self.watchdog.feed(message, self.ledger.session, time.monotonic())
                return []
            case ReadBlock():
                return self._blocks(message)
            case ParameterRead():
                self.ledger.judge(message)
                value = self.file.read(message.parameter)
                if isinstance(value, AckStatus):
                    return [encode(self._ack(message, Op.PARAMETER_READ, value))]
                return [encode(ParameterValue(message.session, message.seq, message.parameter, value))]
            case Command() | ParameterWrite():
                return self._request(message)
        return []

    def _request(self, message: Command | ParameterWrite) -> list[Frame]:
        op = message.op if isinstance(message, Command) else Op.PARAMETER_WRITE
        if op in self.script.no_answer_to:
            return []
        match self.ledger.judge(message):
            case Verdict.OLD:
                return []
            case Verdict.STALE:
                return [encode(self._ack(message, op, AckStatus.STALE_SESSION))]
            case Verdict.REPEATED:
                return [encode(self.ledger.reply)]
        before = self.state
        if isinstance(message, ParameterWrite):
            reply: Ack | ParameterValue = self._written(message)
        else:
            reply = self._done(message)
        self.ledger.store(message, reply)
        out = [encode(reply)]
        if op is Op.TIME_SYNC:
            tick = int((time.monotonic() - self._born_s) * FS * self.script.speed)
            out.append(encode(Tick(tick % (1 << 32), 0)))
        return out + (self._telemetry() if self.state is not before else [])

    def _ack(self, request: Any, op: Op, status: AckStatus, value: int = 0) -> Ack:
        return Ack(request.session, request.seq, op, status, self.state, value)

    def _written(self, message: ParameterWrite) -> Ack | ParameterValue:
        status = self.file.write(message.parameter, message.value, self.state)
        if status is not AckStatus.OK:
            return self._ack(message, Op.PARAMETER_WRITE, status)
        held = self.file.read(message.parameter)
        held = self.script.hold_other.get(register_name(message.parameter) or "", held)
        return ParameterValue(message.session, message.seq, message.parameter, float(held))

    def _done(self, message: Command) -> Ack:
        status, value = AckStatus.OK, 0
        if message.op in self.script.deaf_to:
            return self._ack(message, message.op, status)
        energised = self.state in (PowerState.HOLDING, PowerState.RUNNING, PowerState.STOPPING)
        match message.op:
            case Op.IDENTIFY:
                if energised and message.session != self.ledger.session:
                    return self._ack(message, message.op, AckStatus.BUSY)
                self.ledger.open(message)
                value = PROTOCOL_MAJOR * 256 + PROTOCOL_MINOR
            case Op.ARM:
                if self.state is PowerState.FAULTED:
                    status = AckStatus.FAULT_LATCHED
                elif self.state is not PowerState.DISARMED:
                    status = AckStatus.WRONG_STATE
                else:
                    limits_of(self.file.values())
                    self.state, self.i_dq = PowerState.HOLDING, (0.0, 0.0)
                    self.arms.append(time.monotonic())
                    self.watchdog.start(time.monotonic())
                    value = self.ledger.issue()
            case Op.DISARM:
                self._give_up()
                if self.state is not PowerState.FAULTED:
                    self.state = PowerState.DISARMED
                self.i_dq = (0.0, 0.0)
            case Op.STOP:
                self._give_up()
                if energised:
                    self.state, self.i_dq = PowerState.HOLDING, (0.0, 0.0)
            case Op.CLEAR_FAULT:
                self.fault, self.faults = Fault.NONE, 0
                self.file["fault_cause"] = self.file["fault_bits"] = 0.0
                if self.state is PowerState.FAULTED:
                    self.state = PowerState.DISARMED
            case Op.RUN_PROGRAM:
                if self.state is not PowerState.HOLDING:
                    status = AckStatus.WRONG_STATE
                else:
                    status, value = self._start()
            case Op.TIME_SYNC:
                pass
            case _:
                status = AckStatus.UNKNOWN
        return self._ack(message, message.op, status, value)

    def _give_up(self) -> None:
        if self._program is not None:
            self._program, self._phase = None, Phase.GIVEN_UP

    def trip(self, fault: Fault, value: float = 0.0, limit: float = 0.0) -> None:
        """Latch a fault, as the device's own protection would."""
        self.state, self.i_dq, self._program = PowerState.FAULTED, (0.0, 0.0), None
        self.fault, self.faults = fault, self.faults | 1 << fault
        registers = {"fault_cause": fault, "fault_bits": self.faults, "fault_value": value, "fault_limit": limit}
        for name, number in registers.items():
            self.file[name] = float(number)
        self._due_s = 0.0

    # Programs

    def _start(self) -> tuple[AckStatus, int]:
        try:
            program = program_of(self.file.values())
        except ValueError:
            return AckStatus.OUT_OF_RANGE, 0
        if isinstance(program, Hold):
            length = math.hypot(program.current_d_a, program.current_q_a)
            if length > self.file["limit_current_a"]:
                return AckStatus.PAST_LIMIT, 0
        self._number += 1
        self._program, self._begun_s, self._phase = program, time.monotonic(), Phase.RAMPING
        self.state = PowerState.RUNNING
        rows = program.rows(FS)
        i_dq, v_dq = waveforms(program, rows)
        mask = Channel(int(self.file["capture_mask"]))
        self._rows = b""
        turn = np.exp(1j * program.rotor_angle_rad)
        if mask:
            form = RowFormat(mask, CaptureFormat.INT16, self.facts.scales)
            i, v = ((x[:, 0] + 1j * x[:, 1]) * turn for x in (i_dq, v_dq))
            if step_v := self.script.voltage_step_v:
                v = step_v * (np.round(v.real / step_v) + 1j * np.round(v.imag / step_v))
            v[: self.script.saturated] += 1e6
            columns = {
                Channel.I_ALPHA: i.real,
                Channel.I_BETA: i.imag,
                Channel.V_ALPHA: v.real,
                Channel.V_BETA: v.imag,
                Channel.V_DC: np.full(rows, 300.0),
            }
            self._rows = form.pack(columns)
            self.file["capture_row_bytes"] = float(form.row_bytes)
        self.capture = CaptureSource(self._number, len(self._rows), self.script.ring_bytes)
        self.file["capture_rows"], self.file["capture_number"] = float(rows), float(self._number)
        self.ripple, periods = None, int(self.file["ripple_periods"])
        if isinstance(program, Injection) and periods:
            grid = RippleGrid(
                FS,
                program.frequency_hz,
                program.waveform,
                periods,
                round(program.discard_s * FS),
                OWN.voltage_delay_samples,
                bool(self.file["ripple_curvature"]),
            )
            base = base_voltage(program)
            self._counts = demodulate(i_dq, v_dq, base, grid).counts(self.facts.scales)
            self._counts[: self.script.saturated] = 32767
            self.ripple = CaptureSource(self._number + RIPPLE_FLAG, self._counts.nbytes)
            self.file["ripple_rows"] = float(len(self._counts))
            self.file["base_voltage_d_v"], self.file["base_voltage_q_v"] = base
        return AckStatus.OK, self._number

    def _run(self, now_s: float) -> list[Frame]:
        program = self._program
        if program is None:
            if self._phase is Phase.GIVEN_UP and not self.script.progress_lost:
                self._phase = Phase.IDLE
                return [self._progress(Phase.GIVEN_UP, 0)]
            return []
        elapsed_s = (now_s - self._begun_s) * self.script.speed
        settle_s = program.settling_s
        rows = int(self.file["capture_rows"])
        done = min(rows, max(0, int((elapsed_s - settle_s) * FS)))
        phase = Phase.SETTLING if done == 0 else Phase.CAPTURING if done < rows else Phase.COMPLETE
        if phase is not Phase.SETTLING and self._phase in (Phase.RAMPING, Phase.SETTLING):
            start = int((self._begun_s - self._born_s) * FS * self.script.speed + settle_s * FS)
            self.file["capture_start_low"], self.file["capture_start_high"] = float(start % 65536), start // 65536
        assert self.capture is not None
        size = len(self._rows) // rows
        fresh = self._rows[self.capture.captured : done * size]
        self.capture.append(fresh)
        if self.ripple is not None:
            made = len(self._counts) * done // rows
            self.ripple.append(self._counts[self.ripple.captured // (2 * self._counts.shape[1]) : made].tobytes())
        out: list[Frame] = []
        changed, self._phase = phase is not self._phase, phase
        if phase is Phase.COMPLETE:
            self._program, self.state = None, PowerState.HOLDING
            if isinstance(program, Hold):
                self.i_dq = (program.current_d_a, program.current_q_a)
        if not self.script.progress_lost and (changed or now_s >= self._due_s):
            out.append(self._progress(phase, done))
        return out + (self._telemetry() if phase is Phase.COMPLETE else [])

    def _progress(self, phase: Phase, rows: int) -> Frame:
        return encode(Progress(self._next("progress"), phase, self._number, rows))

    def _blocks(self, request: ReadBlock) -> list[Frame]:
        sources = [s for s in (self.capture, self.ripple, self.description) if s and s.number == request.capture]
        if request.capture != DESCRIPTION_CAPTURE:
            time.sleep(self.script.slow_blocks_s)
        answer = sources[0].answer(request, self.layout) if sources else AckStatus.NOT_CAPTURED
        if isinstance(answer, Answer):
            if self.script.wrong_crc and request.capture != DESCRIPTION_CAPTURE:
                answer = answer._replace(end=answer.end._replace(crc=answer.end.crc ^ 1))
            return [*(Frame(self.layout.frame_id, payload) for payload in answer.payloads), encode(answer.end)]
        return [encode(Ack(0, request.window, Op.READ_BLOCK, answer, self.state))]

    def _telemetry(self) -> list[Frame]:
        if self.script.no_status:
            return []
        scale = self.facts.scales.current_a
        d, q = (round(x / scale) for x in self.i_dq)
        beat = self.watchdog.last_seq
        return [
            encode(Status(self.state, self.fault, beat, self.faults, 300.0, 40, self._next("status"))),
            encode(Measurement(self._next("measurement"), d, q, 300.0)),
        ]

    def _next(self, counter: str) -> int:
        self._seqs[counter] = (self._seqs[counter] + 1) % 256
        return self._seqs[counter]


def base_voltage(injection: Injection) -> tuple[float, float]:
    """What the device's controller would have settled at."""
    return RESISTANCE_OHM * injection.target_d_a, RESISTANCE_OHM * injection.target_q_a


def waveforms(program: Excitation, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """(i_dq, v_dq) of a program, shape (rows, 2): a resistance and an inductance, all transients over."""
    if isinstance(program, GatesOff):
        return np.zeros((rows, 2)), np.zeros((rows, 2))
    if isinstance(program, Hold):
        i = np.tile((program.current_d_a, program.current_q_a), (rows, 1))
        return i, RESISTANCE_OHM * i
    if isinstance(program, Injection):
        k = np.arange(rows) + round(program.discard_s * FS)
        phase = k * program.frequency_hz / FS
        f = np.where(phase % 1.0 < 0.5 - 1e-9, 1.0, -1.0)
        turned = 2.0 * np.pi * program.rotation_hz * k / FS
        direction = np.column_stack((np.cos(turned), np.sin(turned)))
        delayed = ((k - 1) * program.frequency_hz / FS) % 1.0
        g = 1.0 - 4.0 * np.abs(delayed - 0.5)
        swing = program.amplitude_v / (4.0 * program.frequency_hz * INDUCTANCE_H)
        i = np.array((program.target_d_a, program.target_q_a)) + swing * g[:, None] * direction
        return i, np.array(base_voltage(program)) + program.amplitude_v * f[:, None] * direction
    assert isinstance(program, Trapezoid)
    t = np.arange(rows) / FS / program.period_s
    i = np.column_stack((np.full(rows, program.held_a), program.amplitude_a * np.sin(2.0 * np.pi * t)))
    return i, RESISTANCE_OHM * i


# Links


@contextlib.contextmanager
def on_a_pty(script: Script | None = None, link: str | None = None) -> Iterator[tuple[Device, str]]:
    """The device on the master of a pseudo-terminal, from a thread of this process; gives the slave's path."""
    device = Device(serial_blocks(240), script)
    master, slave = os.openpty()
    tty.setraw(slave)
    path = os.ttyname(slave)
    os.close(slave)
    os.set_blocking(master, False)
    decoder = SerialDecoder()

    def read() -> list[Frame]:
        try:
            return decoder.feed(os.read(master, 65536))
        except OSError:  # nothing there, or nobody has it open yet
            time.sleep(0.001)
            return []

    def write(frames: Sequence[Frame]) -> None:
        data = device.script.noise(all_to_serial(frames)) if frames else b""
        while data and not over.is_set():
            try:
                data = data[os.write(master, data) :]
            except BlockingIOError:
                time.sleep(0.001)
            except OSError:
                return

    over = threading.Event()
    with _running(device, read, write, over):
        yield device, path
    with contextlib.suppress(OSError):
        os.close(master)


@contextlib.contextmanager
def on_a_bus(channel: str, fd: bool, script: Script | None = None) -> Iterator[Device]:
    """The device on python-can's bus within this process."""
    import can

    device = Device(CAN_FD_LAYOUT if fd else CLASSIC_LAYOUT, script)
    bus = can.Bus(channel=channel, interface="virtual", ignore_config=True)

    def read() -> list[Frame]:
        frames = []
        message = bus.recv(0.001)
        while message is not None:
            frames.append(Frame(message.arbitration_id, bytes(message.data)))
            message = bus.recv(0.0)
        return frames

    def write(frames: Sequence[Frame]) -> None:
        for frame in frames:
            large = len(frame.payload) > 8
            bus.send(
                can.Message(
                    arbitration_id=frame.frame_id,
                    data=frame.payload,
                    is_extended_id=False,
                    is_fd=large,
                    bitrate_switch=large,
                )
            )

    with _running(device, read, write, threading.Event()):
        yield device
    bus.shutdown()


@contextlib.contextmanager
def _running(
    device: Device,
    read: Callable[[], list[Frame]],
    write: Callable[[Sequence[Frame]], None],
    over: threading.Event,
) -> Iterator[None]:
    def loop() -> None:
        while not over.is_set():
            write(device.turn())
            write(device.receive(read()))

    thread = threading.Thread(target=loop, name="device", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
