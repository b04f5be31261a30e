"""The drive `moteus`: holds direct currents under the board's own current control, and captures them slowly.

It claims `hold` alone. docs/moteus.md says what keeps it from the rest.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from plugins.drives.moteus._board import Board, Setpoint, library
from plugins.drives.moteus._configuration import Configuration, require_known
from plugins.drives.moteus._faults import Mode, fault_of
from plugins.drives.moteus._frame import Frame
from plugins.drives.moteus._hold import Guard, Holding, Rows, Target
from plugins.drives.moteus._io import Io
from plugins.drives.moteus._options import MoteusOptions
from protocols import (
    Capabilities,
    Capture,
    DriveError,
    DriveFault,
    DriveRefused,
    DriveSetup,
    DriveState,
    Excitation,
    FaultCause,
    Hold,
    Limits,
    Telemetry,
)

CALL_S = 3.0
RAMP_S = 1.0
"""A current that is not zero after so long is not ramping down."""
BLOCK_S = 0.25
ZERO = 0.05
"""Nearly zero, as a part of the current limit."""
DIE_OUT_S = 0.05
"""What is left of the current then is gone after this: the board's current control has some 100 Hz."""
_WHY_NOT = {
    "gates_off": "its current amplifiers are switched off together with its gates",
    "trapezoid": "it is read a few dozen times a second, with voltages that are not of the same instant",
    "injection": "its injection is not captured at its own rate, and its watchdog does not cover voltage modes",
}


class MoteusDrive:
    """A moteus as a drive; implements `Drive`, and `ResumableDrive` for its clock.

    Parameters
    ----------
    setup : DriveSetup
        With `MoteusOptions`.
    """

    name: ClassVar[str] = "moteus"
    Options: ClassVar[type[BaseModel]] = MoteusOptions
    sealed_options: ClassVar[frozenset[str]] = frozenset()

    def __init__(self, setup: DriveSetup) -> None:
        self._motor = setup.motor
        self._options: MoteusOptions = setup.options
        self._io: Io | None = None
        self._board: Board | None = None
        self._frame = Frame(2, 1, 1.0)
        self._capabilities: Capabilities | None = None
        self._limits: Limits | None = None
        self._own_limit_a = math.inf
        self._latched: DriveFault | None = None
        self._held = Target(0.0, 0.0)
        self._rotor_angle_rad = 0.0
        self._origin_s = 0.0
        self._turn = 0
        self._under_way: Future[Rows] | None = None

    # Link

    def connect(self) -> Capabilities:
        """Open the link, ask the board who it is and how it is configured. Nothing is energised.

        Raises
        ------
        PluginError
            The official library is not installed.
        DriveFault
            Nobody answers, or what is answered cannot be used.
        DriveRefused
            Somebody else drives the board, or its configuration or the nameplate does not fit.
        """
        moteus = library()
        self._io = io = Io(self._options.where)

        async def opened() -> Board:
            return Board(moteus, self._options)

        self._board = board = io.call(opened, self._options.connect_timeout_s)
        versions = io.call(board.versions, self._options.connect_timeout_s)
        require_known(versions, self._options.where)
        self._take_up(board, io)
        numbers = io.call(board.numbers, self._options.connect_timeout_s)
        configuration = Configuration.of(numbers, self._motor, self._options.where)
        self._frame, self._own_limit_a = configuration.frame, configuration.max_current_a
        bus_v = io.call(board.reading, CALL_S).bus_v
        self._capabilities = configuration.capabilities(self._options, versions.get("firmware_version", 0), bus_v)
        self._origin_s = time.monotonic()
        return self._capabilities

    def _take_up(self, board: Board, io: Io) -> None:
        """Find the board stopped; a time-out is over, for its host is gone, and a fault stays unless seen to."""
        now = io.call(board.reading, CALL_S)
        fault = fault_of(now.mode, now.code, self._options.watchdog_s)
        if fault is None and now.mode != Mode.STOPPED:
            raise DriveRefused(f"{self._options.where} is in mode {now.mode}: somebody else drives it; stop it first")
        if fault is not None and (now.mode == Mode.TIMEOUT or self._options.clear_fault):
            io.call(board.stop, CALL_S)
        else:
            self._latched = fault

    def close(self) -> None:
        """Let go of the link."""
        self._give_up()
        io, self._io, board, self._board = self._io, None, self._board, None
        if io is not None:
            io.close(board.release if board is not None else lambda: None)

    def heartbeat(self) -> None:
        """Let the board hear its setpoint again; nothing is said while it has none."""
        io, board = self._io, self._board
        if io is not None and board is not None:
            io.soon(board.feed)

    # Power stage

    def arm(self, limits: Limits) -> None:
        """Give the board its current limit, switch its power stage on at zero current, and learn its angle."""
        board, io = self._connected()
        own = self._own()
        if self._latched is not None:
            raise DriveRefused(f"a fault is latched: {self._latched.detail}; clear it first")
        for name, wanted, most in (
            ("current", limits.current_a, own.max_current_a),
            ("voltage", limits.voltage_v, own.max_voltage_v),
        ):
            if not wanted <= most * (1.0 + 1e-6):
                raise DriveRefused(f"{name} limit {wanted:g} is above the drive's own {most:g}")

        async def energised() -> float:
            await board.stop()
            await board.limit_current(min(limits.current_a, self._own_limit_a))
            await board.hold(Setpoint(0.0, 0.0))
            await board.enabled()
            return await board.theta()

        try:
            zero_rad = io.call(energised, CALL_S)
        except DriveFault as fault:
            self._trip(fault)
            raise
        self._frame = replace(self._frame, zero_rad=zero_rad)
        self._limits, self._held = limits, Target(zero_rad, 0.0)

    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        """Hold; the rows come when all of them are there, signs of life until then."""
        self._connected()
        self._check(excitation)
        assert isinstance(excitation, Hold)
        self._give_up()
        return self._captures(excitation, self._turn)

    def _check(self, excitation: Excitation) -> None:
        """Raises `DriveRefused` for whatever is not to be done; nothing has moved yet."""
        if self._latched is not None:
            raise DriveFault(self._latched.cause, self._latched.detail)
        if not isinstance(excitation, Hold):
            why = _WHY_NOT[excitation.kind]
            raise DriveRefused(f"a moteus has no {excitation.kind} that could be trusted: {why}")
        limits, own = self._limits, self._own()
        if limits is None:
            raise DriveRefused("not armed")
        asked = excitation.pwm_frequency_hz
        if asked is not None and not math.isclose(asked, own.pwm_frequency_hz, rel_tol=1e-6):
            raise DriveRefused(f"PWM frequency {asked:g} Hz; this board is configured for {own.pwm_frequency_hz:g} Hz")
        current_a = math.hypot(excitation.current_d_a, excitation.current_q_a)
        if not current_a <= limits.current_a:  # so that NaN is refused too
            raise DriveRefused(f"{current_a:g} A is above the limit of {limits.current_a:g} A")
        if not math.isfinite(excitation.rotor_angle_rad):
            raise DriveRefused("the rotor angle is no number")
        needed_v = current_a * (self._motor.stator_resistance_ohm or 0.0)
        if needed_v > limits.voltage_v:
            told = f"{current_a:g} A need {needed_v:.3g} V by the nameplate's resistance"
            raise DriveRefused(f"{told}, above the limit of {limits.voltage_v:g} V")
        if excitation.rows(own.sampling_frequency_hz) < 1:
            raise DriveRefused(f"{excitation.duration_s:g} s are less than a row at {own.sampling_frequency_hz:g} Hz")

    def _captures(self, hold: Hold, turn: int) -> Iterator[Capture]:
        board, io = self._connected()
        own, limits, target = self._own(), self._limits, Target.of(hold)
        if self._turn != turn or limits is None:
            raise DriveRefused("the excitation was given up")
        fs = own.sampling_frequency_hz
        holding = Holding(board, self._frame, Guard(limits, self._options.watchdog_s), fs)
        if target.current_a == 0.0:
            target = replace(target, theta_rad=hold.rotor_angle_rad)
        self._held, self._rotor_angle_rad = target, hold.rotor_angle_rad
        under_way = self._under_way = io.start(lambda: holding.run(target, hold.settle_s, hold.rows(fs)))
        try:
            while not io.wait(under_way, BLOCK_S):
                yield _block(Rows(time.monotonic(), ()), fs, self._origin_s)
                if self._turn != turn:
                    raise DriveRefused("the excitation was given up")
            try:
                taken = io.result(under_way)
            except DriveFault as fault:
                self._trip(fault)
                raise
        finally:
            under_way.cancel()
        size = max(1, int(BLOCK_S * fs))
        for first in range(0, len(taken.rows), size):
            part = Rows(taken.start_s + first / fs, taken.rows[first : first + size])
            yield _block(part, fs, self._origin_s)
            if self._turn != turn:
                raise DriveRefused("the excitation was given up")

    def telemetry(self) -> Telemetry:
        """A reading, now; with the power stage off the bridge is open and the board's amplifiers say nothing."""
        board, io = self._connected()
        now = io.call(board.reading, CALL_S)
        fault = fault_of(now.mode, now.code, self._options.watchdog_s)
        if fault is not None and self._latched is None:
            self._trip(fault)
        armed = now.mode == Mode.POSITION and self._latched is None
        i = 0j
        if armed:
            i = self._frame.stator(now.d_a, now.q_a, self._held.theta_rad - self._rotor_angle_rad)
        still = DriveState.DISARMED if self._latched is None else DriveState.FAULTED
        return Telemetry(
            state=DriveState.ARMED if armed else still,
            time_s=time.monotonic() - self._origin_s,
            i_d_a=i.real,
            i_q_a=i.imag,
            v_dc_v=now.bus_v,
            temperature_c=now.temperature_c if math.isfinite(now.temperature_c) else None,
            faults=() if self._latched is None else (f"{self._latched.cause.value}: {self._latched.detail}",),
        )

    def ramp_down(self) -> None:
        """Zero current at the angle held, under the board's current control; nothing where the power stage is off."""
        self._give_up()
        if self._io is None or self._board is None:
            return
        board, io = self._connected()
        if board.setpoint is None or self._limits is None:
            return
        io.call(lambda: board.hold(Setpoint(self._frame.position(self._held.theta_rad), 0.0)), CALL_S)
        deadline = time.monotonic() + RAMP_S
        while True:
            now = io.call(board.reading, CALL_S)
            if now.mode != Mode.POSITION:
                return
            if math.hypot(now.d_a, now.q_a) <= ZERO * self._limits.current_a:
                break
            if time.monotonic() > deadline:
                raise DriveFault(FaultCause.NO_ANSWER, f"a current still flows after {RAMP_S:g} s of ramping down")
        time.sleep(DIE_OUT_S)

    def disarm(self) -> None:
        """Power stage off, and the board's own current limit put back."""
        self._give_up()
        if self._io is None or self._board is None:
            return
        board, io = self._connected()
        was_armed, self._limits = self._limits is not None, None
        self._notice(board, io)
        io.call(board.stop, CALL_S)
        if was_armed:
            io.call(lambda: board.limit_current(self._own_limit_a), CALL_S)

    def _notice(self, board: Board, io: Io) -> None:
        """Latch what the board is about to forget when it is stopped."""
        now = io.call(board.reading, CALL_S)
        self._latched = self._latched or fault_of(now.mode, now.code, self._options.watchdog_s)

    def clear_fault(self) -> None:
        """Forget the fault; the board stays stopped."""
        board, io = self._connected()
        io.call(board.stop, CALL_S)
        self._latched = None

    def set_brake(self, engaged: bool) -> None:
        """Refused: mode 15 of a moteus shorts the phases, which holds no rotor."""
        raise DriveRefused("a moteus has no brake that holds a rotor; lock it by hand")

    # Clock

    def checkpoint(self, point_id: str) -> None:
        """Nothing to keep: the motor remembers by itself."""

    def restore(self, point_id: str, start_s: float) -> None:
        """Let the experiment's clock go on from `start_s`."""
        self._origin_s = time.monotonic() - start_s

    # What the methods share

    def _connected(self) -> tuple[Board, Io]:
        if self._io is None or self._board is None:
            raise DriveRefused("not connected")
        self._io.check()
        return self._board, self._io

    def _give_up(self) -> None:
        """End the excitation that is under way: it commands nothing any more, whoever still holds its iterator."""
        self._turn += 1
        if self._under_way is not None:
            self._under_way.cancel()

    def _own(self) -> Capabilities:
        if self._capabilities is None:
            raise DriveRefused("not connected")
        return self._capabilities

    def _trip(self, fault: DriveFault) -> None:
        """Latch a fault and switch the power stage off, as far as the board can still be reached."""
        self._latched = self._latched or fault
        board, io = self._board, self._io
        if board is not None and io is not None and io.lost is None:
            with suppress(DriveError):  # the fault that is being told is the better news
                io.call(board.stop, CALL_S)


def _block(taken: Rows, sampling_frequency_hz: float, origin_s: float) -> Capture:
    i = np.array([row.i for row in taken.rows], dtype=complex)
    v = np.array([row.v for row in taken.rows], dtype=complex)
    return Capture(
        start_s=taken.start_s - origin_s,
        sampling_frequency_hz=sampling_frequency_hz,
        i_ab=np.column_stack((i.real, i.imag)),
        v_ab=np.column_stack((v.real, v.imag)),
        v_dc=np.array([row.v_dc for row in taken.rows], dtype=float),
    )
