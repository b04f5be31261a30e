"""An ODrive that is not there: its ASCII protocol, watchdog, axis states, and a locked motor behind its encoder.

Written from the firmware's source (github.com/odriverobotics/ODrive, 0.5.6: communication/ascii_protocol.cpp,
fibre-cpp/protocol.hpp, MotorControl/axis.cpp, encoder.cpp, motor.cpp, foc.cpp); it shares no code with the drive. With
gains at pole and zero the current follows as a first-order lag.
"""

from __future__ import annotations

import cmath
import math
import os
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

LAG_S = 1e-3
FLOATS = ("current_lim", "current_lim_margin", "watchdog_timeout", "phase_offset_float", "vel_limit", "torque_constant")


class Board:
    """Properties by name, and what moves behind them."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {
            "fw_version_major": 0,
            "fw_version_minor": 5,
            "fw_version_revision": 6,
            "vbus_voltage": 24.0,
            "axis0.error": 0,
            "axis0.motor.error": 0,
            "axis0.encoder.error": 0,
            "axis0.controller.error": 0,
            "axis0.current_state": 1,
            "axis0.motor.config.motor_type": 0,
            "axis0.motor.is_calibrated": 1,
            "axis0.encoder.is_ready": 1,
            "axis0.motor.config.pole_pairs": 7,
            "axis0.encoder.config.cpr": 8192,
            "axis0.encoder.config.direction": -1,
            "axis0.encoder.config.phase_offset": 311,
            "axis0.encoder.config.phase_offset_float": 0.37,
            "axis0.motor.config.torque_constant": 0.04,
            "axis0.motor.config.current_lim": 30.0,
            "axis0.motor.config.current_lim_margin": 8.0,
            "axis0.controller.config.vel_limit": 2.0,
            "axis0.controller.config.control_mode": 3,
            "axis0.controller.config.input_mode": 1,
            "axis0.config.watchdog_timeout": 0.0,
            "axis0.config.enable_watchdog": 0,
        }
        self.resistance_ohm, self.counts, self.mute, self.slow_s = 0.2, 2025, False, 0.0
        self.lock = threading.RLock()
        self._torque, self._i, self._v = 0.0, 0j, 0j
        self._fed_s = self._seen_s = time.monotonic()
        self._noise = np.random.default_rng(5)

    @property
    def armed(self) -> bool:
        """Whether its bridge is on."""
        with self.lock:
            self.advance()
            return self.values["axis0.current_state"] == 8

    def _of(self, name: str) -> float:
        return self.values[f"axis0.{name}"]

    @property
    def phase(self) -> float:
        counts = (self.counts - self._of("encoder.config.phase_offset")) + 0.5
        counts -= self._of("encoder.config.phase_offset_float")
        turn = 2.0 * math.pi * self._of("motor.config.pole_pairs") / self._of("encoder.config.cpr")
        return math.remainder(turn * counts, 2.0 * math.pi) * self._of("encoder.config.direction")

    def trip(self, part: str, error: int) -> None:
        """An error: disarmed."""
        with self.lock:
            self.values[f"axis0{part}.error"] = error
            self.values["axis0.current_state"] = 1

    def advance(self) -> None:
        """Time passes."""
        now_s = time.monotonic()
        passed_s, self._seen_s = now_s - self._seen_s, now_s
        watched = bool(self._of("config.enable_watchdog"))
        if watched and now_s - self._fed_s > self._of("config.watchdog_timeout"):
            self.trip("", 1 << 11)
        if self._of("current_state") != 8:
            self._i = self._v = 0j
            return
        limit = self._of("motor.config.current_lim")
        i_q = self._of("encoder.config.direction") * self._torque / self._of("motor.config.torque_constant")
        target = 1j * min(max(i_q, -limit), limit) * cmath.exp(1j * self.phase)
        self._i = target + (self._i - target) * math.exp(-passed_s / LAG_S)
        self._v = self.resistance_ohm * self._i
        if abs(self._i) > limit + self._of("motor.config.current_lim_margin"):
            self.trip(".motor", 1 << 12)

    def _measured(self, name: str) -> float:
        noisy = self._i + complex(*self._noise.normal(0.0, 0.01, 2)) if self._of("current_state") == 8 else 0j
        return {
            "Ialpha_measured": noisy.real,
            "Ibeta_measured": noisy.imag,
            "final_v_alpha": self._v.real,
            "final_v_beta": self._v.imag,
            "phase": self.phase,
        }[name]

    # Lines

    def answer(self, line: str) -> str | None:
        """What comes back for one line; None where nothing does."""
        with self.lock:
            self.advance()
            words = line.split()
            if words[0] == "r":
                return self._read(words[1])
            if words[0] == "w":
                return self._write(words[1], words[2])
            if words[0] == "u":
                self._fed_s = time.monotonic()
                return None
            if words[0] == "c":
                self.values["axis0.controller.config.control_mode"] = 1
                self._torque, self._fed_s = float(words[2]), time.monotonic()
                return None
            if words[0] == "sc":
                for part in ("", ".motor", ".encoder", ".controller"):
                    self.values[f"axis0{part}.error"] = 0
                return None
            return "unknown command"

    def _read(self, name: str) -> str:
        if name.startswith("axis0.motor.current_control."):
            return f"{self._measured(name.rpartition('.')[2]):f}"[:9]
        if name not in self.values:
            return "invalid property"
        value = self.values[name]
        is_float = name == "vbus_voltage" or name.rpartition(".")[2] in FLOATS
        return f"{value:f}"[:9] if is_float else f"{value:d}"[:9]

    def _write(self, name: str, value: str) -> str | None:
        if name == "axis0.requested_state":
            wanted = int(value)
            blocked = any(self.values[f"axis0{part}.error"] for part in ("", ".motor"))
            self.values["axis0.current_state"] = 1 if blocked else wanted
            self._fed_s = time.monotonic()
            return None
        if name not in self.values:
            return "invalid property"
        short = name.rpartition(".")[2]
        self.values[name] = float(np.float32(value)) if short in FLOATS else int(value)
        return None


class Port:
    """The board at the end of a descriptor."""

    def __init__(self, board: Board, descriptor: int) -> None:
        self._board, self._fd, self._done = board, descriptor, threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._done.set()
        self._thread.join()

    def _serve(self) -> None:
        received = b""
        while not self._done.is_set():
            if not select.select([self._fd], [], [], 0.02)[0]:
                with self._board.lock:
                    self._board.advance()
                continue
            try:
                octets = os.read(self._fd, 4096)
            except OSError:
                return
            if not octets:
                return
            received += octets
            *lines, received = received.split(b"\n")
            for line in lines:
                answer = self._board.answer(line.decode())
                if answer is not None and not self._board.mute:
                    time.sleep(self._board.slow_s)
                    with suppress(OSError):
                        os.write(self._fd, f"{answer}\r\n".encode())


@contextmanager
def on_a_line(change: Callable[[Board], Any] = lambda board: None) -> Iterator[tuple[Board, str]]:
    """A board behind a pseudo-terminal, for the length of a `with` block; and the terminal's path."""
    board = Board()
    change(board)
    master, slave = os.openpty()
    tty.setraw(slave)
    port = Port(board, master)
    try:
        yield board, os.ttyname(slave)
    finally:
        port.close()
        os.close(master)
        os.close(slave)


@contextmanager
def on_tcp() -> Iterator[tuple[Board, str]]:
    """A board behind a TCP bridge that takes one host."""
    board, done = Board(), threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.05)
    hosts: list[tuple[socket.socket, Port]] = []

    def accept() -> None:
        while not done.is_set():
            with suppress(TimeoutError):
                host, _ = listener.accept()
                host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                hosts.append((host, Port(board, host.fileno())))

    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    try:
        yield board, f"socket://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        done.set()
        thread.join()
        for host, port in hosts:
            port.close()
            host.close()
        listener.close()
