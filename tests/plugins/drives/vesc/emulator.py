"""A VESC that is not there: its line, terminal, Lisp console, sampling and timeout, and a salient motor.

Written from the firmware's source (github.com/vedderb/bldc, release 7.00: comm/packet.c, comm/commands.c, terminal.c,
lispBM/lispif.c, motor/mc_interface.c, motor/mcpwm_foc.c, timeout.c); it shares no code with the drive. The control's
periods run as they do there, one after the other in real time: sample, control, tone, row. The voltage acts half a
period later.
"""

from __future__ import annotations

import cmath
import math
import os
import re
import select
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

SINGLE = np.float32
ANSWERS_S, DEAF_S, MOST_ROWS = 0.5, 0.5, 1000
OFF, CURRENT, OPENLOOP, OPENLOOP_PHASE = range(4)


class Motor:
    """A locked one: R, L_d, L_q, and the angle at which its d axis stands."""

    def __init__(self, resistance_ohm: float, ld_h: float, lq_h: float, angle_rad: float) -> None:
        self.resistance_ohm, self.ld_h, self.lq_h = resistance_ohm, ld_h, lq_h
        self._turn = cmath.exp(1j * angle_rad)
        self.i = 0j

    def decays(self, seconds: float) -> None:
        """Learn how far a current decays in half a period."""
        r = self.resistance_ohm
        self._d, self._q = (math.exp(-r * seconds / inductance) for inductance in (self.ld_h, self.lq_h))

    def step(self, v: complex) -> None:
        """Half a period at this voltage."""
        i, v = self.i / self._turn, v / self._turn / self.resistance_ohm
        d = v.real + (i.real - v.real) * self._d
        q = v.imag + (i.imag - v.imag) * self._q
        self.i = complex(d, q) * self._turn


class Firmware:
    """Control, timeout and rows. `advance` runs the periods that have passed; all under one lock."""

    def __init__(self) -> None:
        self.configuration: dict[str, float] = {
            "l-current-max": 20.0,
            "l-current-min": -20.0,
            "l-current-max-scale": 1.0,
            "l-current-min-scale": 1.0,
            "l-abs-current-max": 60.0,
            "l-max-duty": 0.95,
            "foc-f-zv": 16000.0,
            "foc-current-kp": 0.25,
            "foc-current-ki": 200.0,
            "foc-sensor-mode": 0,
            "motor-type": 2,
            "m-invert-direction": 0,
            "timeout-msec": 1000,
        }
        self.motor = Motor(0.2, 250e-6, 400e-6, 0.7)
        self.bus_v, self.noise_a, self.fault, self.version = 24.0, 0.02, 0, (7, 0)
        self.lock = threading.RLock()
        self.running, self.deaf = False, False
        self.drops_row: int | None = None
        self._mode, self._id, self._angle, self._turning, self._speed = OFF, 0.0, 0.0, 0.0, 0.0
        self._integral, self._v = 0j, 0j
        self._tone = (SINGLE(0.0), SINGLE(0.0), SINGLE(0.0))
        self._playing, self._off_delay_s = False, 0.0
        self._fed_s, self.timed_out = -math.inf, False
        self._sampling, self._wanted, self._rows = 0, 0, list[bytes]()
        self._sums, self._count = np.zeros(4), 0
        self._noise, self._seen_s, self._periods = np.random.default_rng(3), time.monotonic(), 0
        self.sent: Callable[[bytes], None] = lambda payload: None

    @property
    def rate_hz(self) -> float:
        return self.configuration["foc-f-zv"] / 2.0

    # Time

    def advance(self) -> None:
        """Run what has passed since; periods in which nothing is seen of them are passed over."""
        with self.lock:
            now_s = time.monotonic()
            self.timed_out = now_s - self._fed_s > self.configuration["timeout-msec"] / 1e3
            if self.timed_out and self._mode != OFF:
                self._mode, self._id = CURRENT, 0.0
            periods = int((now_s - self._seen_s) * self.rate_hz)
            self._seen_s += periods / self.rate_hz
            if not self.running and not self._sampling:
                self._count, self._sums = 1, np.zeros(4)
                return
            self.motor.decays(0.5 / self.rate_hz)
            noise = self._noise.normal(0.0, self.noise_a, (periods, 2))
            for k in range(periods):
                self._period(complex(*noise[k]))

    def _period(self, noise: complex) -> None:
        dt = 1.0 / self.rate_hz
        read = self.motor.i + noise
        angle = 0.3  # the observer's, while nothing is open loop
        if self.running:
            if self._mode == OPENLOOP:
                self._turning = (self._turning + dt * self._speed) % (2.0 * math.pi)
                angle = self._turning
            elif self._mode == OPENLOOP_PHASE:
                angle = self._angle
            held, self._v = self._v, self._control(read, angle, dt)
            self.motor.step(held)
            self.motor.step(self._v)
            if abs(self.motor.i) > self.configuration["l-abs-current-max"]:
                self.trip(4)
            self._off_delay_s = max(0.0, self._off_delay_s - dt)
            if abs(self._id) < 0.05 and self._off_delay_s < dt:
                self._switch_off()
        self._count += 1
        self._sample(read, angle, dt)

    def _control(self, read: complex, angle: float, dt: float) -> complex:
        turn = cmath.exp(1j * angle)
        i, target = read / turn, self._id if self._mode == OPENLOOP_PHASE else 0.0
        error = target - i
        self._integral += error * self.configuration["foc-current-ki"] * dt
        v = self._integral + error * self.configuration["foc-current-kp"]
        self._sums += (i.real, i.imag, v.real, v.imag)
        if self._playing:
            frequency, volts, place = self._tone
            place = SINGLE(place + SINGLE(SINGLE(32.0) * frequency) * SINGLE(dt))
            if place >= 32.0:
                place = SINGLE(place - SINGLE(32.0))
            self._tone = (frequency, volts, place)
            v += 1j * float(volts) * math.sin(2.0 * math.pi * int(place) / 32)
        return v * turn

    def _switch_off(self) -> None:
        self.running, self._mode, self._id = False, OFF, 0.0
        self.motor.i, self._v, self._integral = 0j, 0j, 0j

    def trip(self, code: int) -> None:
        """A fault."""
        with self.lock:
            self.fault = code
            self._switch_off()

    # Rows

    def _sample(self, i: complex, angle: float, dt: float) -> None:
        if self._sampling == 0 or (self._sampling == 2 and not self.running and not self._rows):
            return
        phases = [(i * cmath.exp(-2j * math.pi * k / 3)).real for k in range(3)]
        phases = [math.trunc(8.0 * p / 0.02) / 8.0 * 0.02 for p in phases]
        index, octet = len(self._rows), int(angle % (2.0 * math.pi) / (2.0 * math.pi) * 250.0)
        rate = int(0.1 / dt) * 10.0
        row = struct.pack(">Bh8ffBBi", 19, index, *phases, 0.1, -0.1, 0.0, 11.9, abs(i), rate, 5, octet, index)
        self._rows.append(row)
        if len(self._rows) == self._wanted:
            sending, self._rows, self._sampling = self._rows, [], 0
            for index, row in enumerate(sending):
                if index != self.drops_row:
                    self.sent(row)

    # Commands

    def answer(self, payload: bytes) -> None:
        """What COMM_... does."""
        self.advance()
        with self.lock:
            command, data = payload[0], payload[1:]
            if self.deaf:
                return
            if command == 0:
                self.sent(bytes([0, *self.version]) + b"60_MK6\0" + bytes(12) + b"\0\0\0\0\0\0\0\0\0\0")
            elif command == 30:
                self._feed()
            elif command == 50:
                self._tell(int.from_bytes(data[:4]))
            elif command == 19:
                self._sampling, self._wanted = data[0], min(int.from_bytes(data[1:3]), MOST_ROWS)
                self._rows = []
                assert data[3] == 1, "a decimation is not emulated"
            elif command == 20:
                self._terminal(data.rstrip(b"\0").decode())

    def _feed(self) -> None:
        self._fed_s, self.timed_out = time.monotonic(), False

    def _tell(self, mask: int) -> None:
        assert mask == 0x388130, f"a mask of {mask:#x} is not emulated"
        d, q, vd, vq = self._sums / max(self._count, 1)
        self._sums, self._count = np.zeros(4), 0
        whole = (round(100 * d), round(100 * q), round(10 * self.bus_v), self.fault, round(1e3 * vd), round(1e3 * vq))
        self.sent(struct.pack(">BIiihBiiB", 50, mask, *whole, self.timed_out))

    def _print(self, text: str) -> None:
        self.sent(b"\x15" + text.encode())

    def _terminal(self, line: str) -> None:
        words = line.split()
        assert (words[0], float(words[2])) == ("rotor_lock_openloop", 0.0), f"{line!r} is not emulated"
        current, degrees = float(words[1]), float(words[3])
        self._print("Locking rotor with openloop...")
        most = self.configuration["l-current-max"]
        if not (abs(current) <= most and 0.0 <= degrees <= 360.0):
            self._print("Invalid argument(s).")
            self._print(f"Current must be less than {most:.2f}")
            return
        self._feed()
        most *= self.configuration["l-current-max-scale"]
        self._mode, self._id = OPENLOOP_PHASE, min(max(current, -most), most)
        self._angle = math.radians(degrees)
        if abs(current) >= 0.05 and not self.fault:
            self.running = True
        self._print("OK\n")

    # What its Lisp can do

    def play_tone(self, frequency_hz: float, volts: float) -> None:
        self._feed()
        self._tone = (SINGLE(frequency_hz), SINGLE(volts), self._tone[2])
        self._playing, self._off_delay_s = True, 1.0
        if not self.running:
            self._mode, self._id, self.running = CURRENT, 0.0, True

    def play_stop(self) -> None:
        self._playing, self._tone = False, (SINGLE(0.0), SINGLE(0.0), SINGLE(0.0))

    def openloop(self, current: float, rpm: float) -> None:
        assert current == 0.0, "a rotating current is not emulated"
        self._feed()
        self._mode, self._id, self._speed = OPENLOOP, 0.0, rpm * 2.0 * math.pi / 60.0


class Console:
    """LispBM's console: one expression at a time, answers within half a second, deaf for half a second after each."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware, self._received_s = firmware, -math.inf

    def receive(self, text: str) -> None:
        """Evaluate on a thread of its own; a fast second line is passed over without a word."""
        begun_s = time.monotonic()
        if begun_s - self._received_s <= DEAF_S:
            return
        self._received_s = begun_s

        def evaluate() -> None:
            value = self._value(_parsed(text))
            if time.monotonic() - begun_s < ANSWERS_S:
                self._firmware.sent(b"\x87" + f"> {_shown(value)}"[:128].encode())

        threading.Thread(target=evaluate, name="lisp", daemon=True).start()

    def _value(self, expression: Any) -> Any:
        if not isinstance(expression, list):
            return expression
        name, *rest = expression
        if name == "quote":
            return rest[0]
        values = [self._value(one) for one in rest]
        time.sleep(0.0005)  # it is no fast machine
        firmware = self._firmware
        if name == "sleep":
            time.sleep(values[0])
            return True
        firmware.advance()
        with firmware.lock:
            if name == "list":
                return values
            if name == "progn":
                return values[-1]
            if name == "*":
                return math.prod(values)
            if name == "conf-get":
                return firmware.configuration[values[0]]
            if name == "conf-set":
                firmware.configuration[values[0]] = values[1]
                return True
            deeds: dict[str, Callable[..., None]] = {
                "foc-play-stop": firmware.play_stop,
                "foc-play-tone": lambda channel, f, v: firmware.play_tone(f, v),
                "foc-openloop": firmware.openloop,
            }
            deeds[name](*values)
            return True


def _parsed(text: str) -> Any:
    words = re.findall(r"[()']|[^\s()']+", text)

    def one() -> Any:
        word = words.pop(0)
        if word == "'":
            return ["quote", one()]
        if word != "(":
            try:
                return int(word) if word.lstrip("-").isdecimal() else float(word)
            except ValueError:
                return word
        inside = []
        while words[0] != ")":
            inside.append(one())
        words.pop(0)
        return inside

    return one()


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return f"({' '.join(map(_shown, value))})"
    if value is True:
        return "t"
    return str(value) if isinstance(value, int) else f"{value:.6f}f32"


# The line


def crc(data: bytes) -> int:
    """CRC-16, polynomial 0x1021, bit by bit."""
    register = 0
    for octet in data:
        register ^= octet << 8
        for _ in range(8):
            register = (register << 1 ^ 0x1021 if register & 0x8000 else register << 1) & 0xFFFF
    return register


_TABLE = [crc(bytes([n])) for n in range(256)]


def packet(payload: bytes) -> bytes:
    """As packet_send_packet writes it."""
    register = 0
    for octet in payload:
        register = (register << 8 ^ _TABLE[register >> 8 ^ octet]) & 0xFFFF
    head = bytes([2, len(payload)]) if len(payload) <= 255 else bytes([3, len(payload) >> 8, len(payload) & 255])
    return head + payload + register.to_bytes(2) + b"\x03"


class Port:
    """A board at the end of a descriptor; one thread reads, one lets time pass."""

    def __init__(self, firmware: Firmware, descriptor: int) -> None:
        self.firmware, self._fd = firmware, descriptor
        self._console = Console(firmware)
        self._done, self._sending = threading.Event(), threading.Lock()
        firmware.sent = self._send
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._serve, self._pass_time)]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._done.set()
        for thread in self._threads:
            thread.join()

    def _pass_time(self) -> None:
        while not self._done.wait(0.004):
            self.firmware.advance()

    def _send(self, payload: bytes) -> None:
        data, give_up_s = packet(payload), time.monotonic() + 0.5
        with self._sending, suppress(OSError):
            while data and time.monotonic() < give_up_s:
                if select.select([], [self._fd], [], 0.05)[1]:
                    data = data[os.write(self._fd, data) :]

    def _serve(self) -> None:
        received = b""
        while not self._done.is_set():
            if not select.select([self._fd], [], [], 0.05)[0]:
                continue
            try:
                octets = os.read(self._fd, 4096)
            except OSError:
                return
            if not octets:
                return
            received += octets
            while len(received) >= 5:
                wide = received[0] == 3
                start = 3 if wide else 2
                end = start + int.from_bytes(received[1:start])
                if len(received) < end + 3:
                    break
                payload, tail, received = received[start:end], received[end : end + 3], received[end + 3 :]
                assert tail == crc(payload).to_bytes(2) + b"\x03", "a damaged frame"
                self._take(payload)

    def _take(self, payload: bytes) -> None:
        if payload[0] == 138:
            self._console.receive(payload[1:].rstrip(b"\0").decode())
        else:
            self.firmware.answer(payload)


@contextmanager
def on_a_line(change: Callable[[Firmware], Any] = lambda firmware: None) -> Iterator[tuple[Firmware, str]]:
    """A board behind a pseudo-terminal, for the length of a `with` block; and the terminal's path."""
    firmware = Firmware()
    change(firmware)
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    port = Port(firmware, master)
    try:
        yield firmware, os.ttyname(slave)
    finally:
        port.close()
        os.close(master)
        os.close(slave)


@contextmanager
def on_tcp(change: Callable[[Firmware], Any] = lambda firmware: None) -> Iterator[tuple[Firmware, str]]:
    """A board behind a TCP bridge that takes one host."""
    firmware = Firmware()
    change(firmware)
    listener = socket.create_server(("127.0.0.1", 0))
    ports: list[Port] = []
    done = threading.Event()

    def accept() -> None:
        listener.settimeout(0.05)
        while not done.is_set():
            with suppress(TimeoutError):
                host, _ = listener.accept()
                hosts.append(host)
                host.setblocking(False)
                ports.append(Port(firmware, host.fileno()))

    hosts: list[socket.socket] = []
    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    try:
        yield firmware, f"socket://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        done.set()
        thread.join()
        for port in ports:
            port.close()
        for host in hosts:
            host.close()
        listener.close()
