"""A moteus that is not there: registers, diagnostic stream, watchdog and a motor, behind the fdcanusb's text protocol.

Written from the reference of moteus (docs/protocol in github.com/mjbots/moteus) and judged by its official library,
which talks to it. The motor is a locked one, R and L in each axis, under the firmware's own current control: with its
gains at pole and zero the current follows as a first-order lag of 100 Hz.
"""

from __future__ import annotations

import cmath
import math
import os
import select
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import can
import numpy as np
from moteus.multiplex import FlowStreamSubframe, RegisterSubframe, StreamSubframe, SubframeType, parse_frame
from moteus.protocol import Register, scale_register

LAG_S = 1.0 / (2.0 * math.pi * 100.0)
ENABLE_S = 0.01
IN_POWER = 10
_FORMATS = ("<b", "<h", "<i", "<f")


class Servo:
    """The board and its motor; one frame in, one frame out."""

    def __init__(self, poles: int = 14, resistance_ohm: float = 0.4, inductance_h: float = 2e-4) -> None:
        self.configuration: dict[str, float] = {
            "motor.poles": poles,
            "motor_position.output.sign": -1,
            "motor_position.rotor_to_output_ratio": 0.25,
            "servo.max_current_A": 20.0,
            "servo.pwm_rate_hz": 30000,
            "servo.timeout_mode": 12,
            "servo.voltage_mode_control": 0,
            "servo.fixed_voltage_mode": 0,
        }
        self.resistance_ohm, self.inductance_h = resistance_ohm, inductance_h
        self.origin = 0.137
        """Where the output's zero was put: the firmware's angle does not count it [revolutions]."""
        self.mode, self.code, self.bus_v = 0, 0, 24.0
        self.register_map, self.knows_flow_control = 5, True
        self.mute, self.angle_error_rad = False, 0.0
        self.answers_twice: Callable[[str], bool] = lambda question: False
        """Whether the answer to a question on the diagnostic stream comes twice."""
        self.position_commands = 0
        self._command: dict[int, float] = {}
        self._expires_s = self._enabled_s = math.inf
        self._seen_s = time.monotonic()
        self._i, self._target, self._theta, self._v = 0j, 0j, 0.0, 0j
        self._noise = np.random.default_rng(7)
        self._output, self._input = b"", b""
        self._packet, self._pending = 0, b""

    # Physics and modes

    def _advance(self) -> None:
        now_s = time.monotonic()
        passed_s, self._seen_s = now_s - self._seen_s, now_s
        if self.mode in (2, 3, 4) and now_s >= self._enabled_s:
            self.mode = IN_POWER
        if self.mode == IN_POWER and now_s >= self._expires_s:
            self.mode = 11
        target = self._target if self.mode == IN_POWER else 0j
        if self.mode in (0, 1):
            self._i = 0j
        self._i = target + (self._i - target) * math.exp(-passed_s / LAG_S)
        self._v = self.resistance_ohm * self._i + self.inductance_h * (target - self._i) / LAG_S
        if self.mode in (0, 1):
            self._v = 0j

    def trip(self, code: int) -> None:
        """A fault, as the firmware shows it."""
        self.mode, self.code = 1, code

    def _start(self) -> None:
        """The frame wrote a mode and what belongs to it."""
        wanted = int(self._command[Register.MODE])
        if wanted == 0:
            self.mode, self.code = 0, 0
            return
        assert wanted == IN_POWER, f"mode {wanted} is not emulated"
        self.position_commands += 1
        if self.mode in (1, 11):
            return  # left through stopped alone
        if self.mode == 0:
            self.mode, self._enabled_s = 2, time.monotonic() + ENABLE_S
        command = self._command
        self._expires_s = time.monotonic() + command[Register.COMMAND_TIMEOUT]
        turns = (command[Register.COMMAND_POSITION] - self.origin) / self._number("rotor_to_output_ratio")
        self._theta = self._sign * turns * self._number("poles") * math.pi + self.angle_error_rad
        most = self.configuration["servo.max_current_A"]
        current = command[Register.COMMAND_FIXED_CURRENT_OVERRIDE]
        self._target = min(max(current, -most), most) * cmath.exp(1j * self._theta)

    @property
    def _sign(self) -> float:
        return self._number("sign")

    def _number(self, ending: str) -> float:
        return next(value for name, value in self.configuration.items() if name.endswith(ending))

    def _dq(self, vector: complex) -> complex:
        own = vector * cmath.exp(-1j * self._theta)
        return complex(own.real, self._sign * own.imag)

    # Registers

    def _read(self, register: int) -> float:
        if register in (Register.D_CURRENT, Register.Q_CURRENT):
            if self.mode in (0, 1):
                return 1.7  # the amplifiers are off, and what the converters see is no current
            noisy = self._dq(self._i) + complex(*self._noise.normal(0.0, 0.01, 2))
            return noisy.real if register == Register.D_CURRENT else noisy.imag
        return {
            Register.MODE: self.mode,
            Register.FAULT: self.code,
            Register.VOLTAGE: self.bus_v,
            Register.TEMPERATURE: 31.5,
            Register.FIRMWARE_VERSION: 0x010100,
            Register.REGISTER_MAP_VERSION: self.register_map,
        }[Register(register)]

    def answer(self, frame: bytes) -> bytes | None:
        """What comes back for a frame's data; None for silence."""
        self._advance()
        self._command = {}
        out = b""
        for part in parse_frame(frame):
            if isinstance(part, RegisterSubframe):
                if part.type is SubframeType.WRITE:
                    self._command[part.register] = scale_register(part.register, part.resolution, part.value)
                else:
                    out += self._reply(part)
            elif isinstance(part, StreamSubframe | FlowStreamSubframe):
                out += self._stream(part)
        if Register.MODE in self._command:
            self._start()
        return None if self.mute else out or None

    def _reply(self, part: RegisterSubframe) -> bytes:
        register = part.register
        number = bytes([register]) if register < 0x80 else bytes([register & 0x7F | 0x80, register >> 7])
        value = self._read(register)
        scaled = value if part.resolution == 3 else int(value)
        return bytes([0x21 | part.resolution << 2]) + number + struct.pack(_FORMATS[part.resolution], scaled)

    # Diagnostic stream

    def _stream(self, part: StreamSubframe | FlowStreamSubframe) -> bytes:
        if part.type is SubframeType.STREAM_CLIENT_TO_SERVER:
            self._input += part.data
            while b"\n" in self._input:
                line, _, self._input = self._input.partition(b"\n")
                question = line.decode()
                self._output += self._talk(question) * (2 if self.answers_twice(question) else 1)
            return b""
        if part.type is SubframeType.STREAM_CLIENT_POLL_SERVER:
            data, self._pending = self._taken(part.data[0]), b""
            return bytes([0x41, 1, len(data)]) + data
        if not self.knows_flow_control:
            return b""
        assert isinstance(part, FlowStreamSubframe)
        if not self._pending or part.packet_number == self._packet:
            self._packet, self._pending = (self._packet + 1) % 256, self._taken(part.data[0])
        return bytes([0x43, 1, self._packet, len(self._pending)]) + self._pending

    def _taken(self, most: int) -> bytes:
        data, self._output = self._output[:most], self._output[most:]
        return data

    def _talk(self, line: str) -> bytes:
        words = line.split()
        if words[:2] == ["conf", "get"]:
            known = words[2] in self.configuration
            return f"{self.configuration[words[2]]:.6f}\r\n".encode() if known else b"ERR error reading\r\n"
        if words[:2] == ["conf", "set"]:
            self.configuration[words[2]] = float(words[3])
        if words[:2] == ["tel", "schema"]:
            return _blob(f"schema {words[2]}", _schema(list(self._telemetry(words[2]))))
        if words[:2] == ["tel", "get"]:
            values = self._telemetry(words[2]).values()
            return _blob(f"emit {words[2]}", struct.pack(f"<{len(values)}f", *values))
        return b"OK\r\n"

    def _telemetry(self, name: str) -> dict[str, float]:
        v, i = self._dq(self._v), self._dq(self._i)
        if name == "servo_stats":
            return {"d_A": i.real, "q_A": i.imag, "electrical_theta": self._theta % (2.0 * math.pi)}
        return {"d_V": v.real, "q_V": v.imag, "i_d_A": i.real, "torque_Nm": 0.0}


def _blob(announced: str, data: bytes) -> bytes:
    return announced.encode() + b"\r\n" + struct.pack("<I", len(data)) + data


def _schema(names: list[str]) -> bytes:
    """An object of 32-bit floats, in the binary schema of mjlib's telemetry."""
    fields = b"".join(b"\x00" + bytes([len(n)]) + n.encode() + b"\x00\x07\x00" for n in names)
    return b"\x10\x00" + fields + b"\x00\x00\x00\x00\x00"


# The fdcanusb


def checksum(line: bytes) -> int:
    """CRC-8 with polynomial 0x97."""
    crc = 0
    for byte in line:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x97 if crc & 0x80 else crc << 1) & 0xFF
    return crc


class Fdcanusb:
    """An fdcanusb on a pty with one servo on its bus, served by a thread of its own."""

    def __init__(self, servo: Servo, servo_id: int = 1) -> None:
        self.servo, self._id = servo, servo_id
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="fdcanusb", daemon=True)
        self._thread.start()

    def pull_the_plug(self) -> None:
        """The port is gone."""
        if not self._done.is_set():
            self._done.set()
            self._thread.join()
            os.close(self._master)
            os.close(self._slave)

    def _serve(self) -> None:
        pending = b""
        while not self._done.is_set():
            if not select.select([self._master], [], [], 0.05)[0]:
                continue
            pending += os.read(self._master, 4096)
            *lines, pending = pending.split(b"\n")
            for line in lines:
                with suppress(BlockingIOError):
                    os.write(self._master, b"".join(self._answers(line)))

    def _answers(self, line: bytes) -> Iterator[bytes]:
        content, star, claimed = line.partition(b"*")
        if not star or int(claimed, 16) != checksum(content):
            yield _checked(b"ERR checksum")
            return
        _, _, identifier, data, *_ = content.split(b" ")
        if self.servo.mute:
            return
        yield _checked(b"OK")
        destination = int(identifier, 16)
        if destination & 0x7F != self._id:
            return
        answer = self.servo.answer(bytes.fromhex(data.decode()))
        if answer is not None and destination & 0x8000:
            yield _checked(b"rcv %04x %s b F" % (self._id << 8, answer.hex().upper().encode()))


def _checked(line: bytes) -> bytes:
    return b"%s *%02X\r\n" % (line, checksum(line + b" "))


@contextmanager
def can_bus(channel: str) -> Iterator[Servo]:
    """A servo on python-can's virtual bus, for the length of a `with` block."""
    servo, done = Servo(), threading.Event()
    bus = can.Bus(interface="virtual", channel=channel, ignore_config=True)

    def serve() -> None:
        while not done.is_set():
            message = bus.recv(0.05)
            if message is None or message.arbitration_id & 0x7F != 1:
                continue
            answer = servo.answer(bytes(message.data))
            if answer is not None and message.arbitration_id & 0x8000:
                padded = answer + b"\x50" * (can.util.dlc2len(can.util.len2dlc(len(answer))) - len(answer))
                bus.send(can.Message(arbitration_id=0x100, data=padded, is_extended_id=False, is_fd=True))

    thread = threading.Thread(target=serve, name="can", daemon=True)
    thread.start()
    try:
        yield servo
    finally:
        done.set()
        thread.join()
        bus.shutdown()


@contextmanager
def fdcanusb(change: Callable[[Servo], Any] = lambda servo: None, servo_id: int = 1) -> Iterator[Fdcanusb]:
    """An emulated fdcanusb for the length of a `with` block."""
    servo = Servo()
    change(servo)
    port = Fdcanusb(servo, servo_id)
    try:
        yield port
    finally:
        port.pull_the_plug()
