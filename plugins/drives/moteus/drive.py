"""The drive `moteus`: holds direct currents under the board's own current control, and captures them slowly.

It claims `hold` alone. docs/moteus.md says what keeps it from the rest.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import ClassVar, NamedTuple

from pydantic import BaseModel

from orchestrator.driving import in_blocks
from orchestrator.driving.polled import PolledDrive
from plugins.drives.moteus._board import Board, Setpoint, library
from plugins.drives.moteus._bounds import BOUNDS
from plugins.drives.moteus._configuration import Configuration, Frame, require_known
from plugins.drives.moteus._faults import Mode, fault_of
from plugins.drives.moteus._hold import Guard, Holding, Target
from plugins.drives.moteus._io import Io
from plugins.drives.moteus._options import MoteusOptions
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveRefused,
    DriveSetup,
    DriveState,
    Excitation,
    ExcitationKind,
    Hold,
    Limits,
    Telemetry,
)


class Connection(NamedTuple):
    """A board and the loop that its coroutines run on."""

    board: Board
    io: Io

    def check(self) -> None:
        """Raise `DriveFault` where the link is lost."""
        self.io.check()

    def close(self) -> None:
        """Let go of the link."""
        self.io.close(self.board.release)


class MoteusDrive(PolledDrive[Connection]):
    """A moteus as a drive; implements `Drive`, and `ResumableDrive` for its clock.

    Parameters
    ----------
    setup : DriveSetup
        With `MoteusOptions`.
    """

    name: ClassVar[str] = "moteus"
    Options: ClassVar[type[BaseModel]] = MoteusOptions
    why_not: ClassVar[Mapping[ExcitationKind, str]] = {
        "gates_off": "its current amplifiers are switched off together with its gates",
        "trapezoid": "it is read a few dozen times a second, with voltages that are not of the same instant",
        "injection": "it is read a few dozen times a second, and its watchdog does not cover voltage modes",
    }

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: MoteusOptions = setup.options
        self._frame = Frame(2, 1, 1.0)
        self._own_limit_a = math.inf
        self._held = Target(0.0, 0.0)

    # Link

    def open(self) -> Capabilities:
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
        io = Io(self._options.where)

        async def opened() -> Board:
            return Board(moteus, self._options)

        try:
            board = io.call(opened, self._options.connect_timeout_s)
        except BaseException:
            io.close(lambda: None)
            raise
        self.board = Connection(board, io)
        versions = io.call(board.versions, self._options.connect_timeout_s)
        require_known(versions, self._options.where)
        self._take_up(board, io)
        numbers = io.call(board.numbers, self._options.connect_timeout_s)
        configuration = Configuration.of(numbers, self.setup.motor, self._options.where)
        self._frame, self._own_limit_a = configuration.frame, configuration.max_current_a
        bus_v = io.call(board.reading, BOUNDS.call_timeout_s).bus_v
        self.origin_s = time.monotonic()
        return configuration.capabilities(self._options, versions.get("firmware_version", 0), bus_v)

    def _take_up(self, board: Board, io: Io) -> None:
        """Find the board stopped; a time-out is over, for its host is gone, and a fault stays unless seen to."""
        now = io.call(board.reading, BOUNDS.call_timeout_s)
        fault = fault_of(now.mode, now.code, self._options.watchdog_s)
        if fault is None and now.mode != Mode.STOPPED:
            raise DriveRefused(f"{self._options.where} is in mode {now.mode}: somebody else drives it; stop it first")
        if fault is not None and (now.mode == Mode.TIMEOUT or self._options.clear_fault):
            io.call(board.stop, BOUNDS.call_timeout_s)
        elif fault is not None:
            self.latch(fault)

    def heartbeat(self) -> None:
        """Repeat the board's setpoint; nothing is sent while it has none."""
        if self.board is not None:
            self.board.io.soon(self.board.board.feed)

    # Power stage

    def energise(self, limits: Limits) -> None:
        """Give the board its current limit, switch its power stage on at zero current, and learn its angle."""
        board, io = self.connected()

        async def energised() -> float:
            await board.stop()
            await board.limit_current(min(limits.current_a, self._own_limit_a))
            await board.hold(Setpoint(0.0, 0.0))
            await board.enabled()
            return await board.theta()

        try:
            zero_rad = io.call(energised, BOUNDS.call_timeout_s)
        except DriveFault as fault:
            raise self.trip(fault) from None
        self._frame = replace(self._frame, zero_rad=zero_rad)
        self._held = Target(zero_rad, 0.0)

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Hold; the rows come when all of them are there, signs of life until then."""
        assert isinstance(excitation, Hold)
        assert self.limits is not None
        current_a = excitation.longest_current_a
        needed_v = current_a * (self.setup.motor.stator_resistance_ohm or 0.0)
        if needed_v > self.limits.voltage_v:
            message = f"{current_a:g} A need {needed_v:.3g} V by the nameplate's resistance"
            raise DriveRefused(f"{message}, above the limit of {self.limits.voltage_v:g} V")
        return self._captures(excitation, self.limits)

    def _captures(self, hold: Hold, limits: Limits) -> Iterator[Capture]:
        board, io = self.connected()
        fs, target = self.own.sampling_frequency_hz, Target.of(hold)
        holding = Holding(board, self._frame, Guard(limits, self._options.watchdog_s), fs)
        if target.current_a == 0.0:
            target = replace(target, theta_rad=hold.rotor_angle_rad)
        self._held, self.rotor_angle_rad = target, hold.rotor_angle_rad
        under_way = io.start(lambda: holding.run(target, hold.settle_s, hold.rows(fs)))
        try:
            while not io.wait(under_way, BOUNDS.keepalive_period_s):
                yield self.keepalive()
            taken = io.result(under_way)
        except DriveFault as fault:
            raise self.trip(fault) from None
        finally:
            under_way.cancel()
        yield from in_blocks(taken.capture(fs, self.origin_s))

    def telemetry(self) -> Telemetry:
        """A reading, now; with the power stage off the bridge is open and the board's amplifiers say nothing."""
        board, io = self.connected()
        now = io.call(board.reading, BOUNDS.call_timeout_s)
        fault = fault_of(now.mode, now.code, self._options.watchdog_s)
        if fault is not None and not self.latched:
            self.trip(fault)
        flowing = now.mode == Mode.POSITION and self.state is DriveState.ARMED
        i = self._frame.stator(now.d_a, now.q_a, self._held.theta_rad - self.rotor_angle_rad) if flowing else 0j
        return Telemetry(
            state=self.state if flowing or self.latched else DriveState.DISARMED,
            time_s=self.now_s(),
            i_d_a=i.real,
            i_q_a=i.imag,
            v_dc_v=now.bus_v,
            temperature_c=now.temperature_c if math.isfinite(now.temperature_c) else None,
            faults=self.faults,
        )

    def ramp(self) -> None:
        """Zero current at the angle held, under the board's current control."""
        board, io = self.connected()
        if board.setpoint is None or self.limits is None:
            return
        io.call(lambda: board.hold(Setpoint(self._frame.position(self._held.theta_rad), 0.0)), BOUNDS.call_timeout_s)
        zero_a = BOUNDS.zero_current_ratio * self.limits.current_a

        def flows() -> bool:
            now = io.call(board.reading, BOUNDS.call_timeout_s)
            return now.mode == Mode.POSITION and math.hypot(now.d_a, now.q_a) > zero_a

        self.await_zero_current(flows, BOUNDS.max_ramp_s)
        time.sleep(BOUNDS.current_decay_s)

    def switch_off(self) -> None:
        """Power stage off, and the board's own current limit put back."""
        board, io = self.connected()
        if not self.latched:
            self._notice(board, io)
        io.call(board.stop, BOUNDS.call_timeout_s)
        io.call(lambda: board.limit_current(self._own_limit_a), BOUNDS.call_timeout_s)

    def _notice(self, board: Board, io: Io) -> None:
        """Latch what the board is about to forget when it is stopped."""
        now = io.call(board.reading, BOUNDS.call_timeout_s)
        fault = fault_of(now.mode, now.code, self._options.watchdog_s)
        if fault is not None:
            self.latch(fault)

    def forget_fault(self) -> None:
        """The board stays stopped, which clears its fault."""
        board, io = self.connected()
        io.call(board.stop, BOUNDS.call_timeout_s)

    def set_brake(self, engaged: bool) -> None:
        """Refused: mode 15 of a moteus shorts the phases, which holds no rotor."""
        raise DriveRefused("a moteus has no brake that holds a rotor; lock it by hand")
