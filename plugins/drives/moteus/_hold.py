"""One hold from zero current to its last row: rows on an even grid, or none. Commands nothing but setpoints."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass

import numpy as np

from plugins.drives.moteus._board import Board, Reading, Setpoint
from plugins.drives.moteus._bounds import BOUNDS
from plugins.drives.moteus._configuration import Frame
from plugins.drives.moteus._faults import fault_of, limiting
from protocols import Capture, DriveFault, FaultCause, Hold, Limits


@dataclass(frozen=True)
class Target:
    """Where a hold goes: electrical angle [rad] and length [A] of its current vector, in the stator frame."""

    theta_rad: float
    current_a: float

    @classmethod
    def of(cls, hold: Hold) -> Target:
        """The vector of a hold."""
        turned = math.atan2(hold.current_q_a, hold.current_d_a)
        return cls(hold.rotor_angle_rad + turned, math.hypot(hold.current_d_a, hold.current_q_a))


@dataclass(frozen=True)
class Row:
    """One row of a capture, in the stator frame."""

    i: complex
    v: complex
    v_dc: float
    temperature_c: float
    """Of the power stage; NaN where the board has none."""


@dataclass(frozen=True)
class Rows:
    """A whole capture; the loop's time of its first row [s]."""

    start_s: float
    rows: tuple[Row, ...]

    def capture(self, sampling_frequency_hz: float, origin_s: float) -> Capture:
        """The same as a drive hands it out; its clock began at `origin_s`."""
        warmth = np.array([row.temperature_c for row in self.rows])
        i, v = (np.array(values, dtype=complex) for values in zip(*((r.i, r.v) for r in self.rows), strict=True))
        return Capture(
            start_s=self.start_s - origin_s,
            sampling_frequency_hz=sampling_frequency_hz,
            i_ab=np.column_stack((i.real, i.imag)),
            v_ab=np.column_stack((v.real, v.imag)),
            v_dc=np.array([row.v_dc for row in self.rows]),
            temperature_c=warmth if np.isfinite(warmth).all() else None,
        )


@dataclass(frozen=True)
class Guard:
    """What a reading must not say."""

    limits: Limits
    watchdog_s: float

    def check(self, now: Reading) -> None:
        """Raises `DriveFault` where the board has a fault, or its current is past the limit."""
        fault = fault_of(now.mode, now.code, self.watchdog_s)
        if fault is not None:
            raise fault
        current_a = math.hypot(now.d_a, now.q_a)
        if not current_a <= BOUNDS.trip_ratio * self.limits.current_a:
            message = f"{current_a:.3g} A measured, with a limit of {self.limits.current_a:g} A"
            raise DriveFault(FaultCause.OVERCURRENT, message)

    def check_voltage(self, v: complex) -> None:
        """Raises `DriveFault` where the current needs more voltage than is allowed."""
        if not abs(v) <= self.limits.voltage_v:
            message = f"the current needs {abs(v):.3g} V, above the limit of {self.limits.voltage_v:g} V"
            raise DriveFault(FaultCause.INTERNAL, message)


class Holding:
    """Everything that one hold needs; a coroutine each for going there and for capturing."""

    def __init__(self, board: Board, frame: Frame, guard: Guard, sampling_frequency_hz: float) -> None:
        self._board, self._frame, self._guard = board, frame, guard
        self._period_s = 1.0 / sampling_frequency_hz

    async def run(self, target: Target, settle_s: float, count: int) -> Rows:
        """Go to the target, settle, and capture.

        Raises
        ------
        DriveFault
            Where the board trips, does not reach the target, or cannot be read evenly.
        """
        await self._go(target)
        loop = asyncio.get_running_loop()
        settled_s = loop.time() + settle_s
        while (left_s := settled_s - loop.time()) > 0.0:
            await self._look(target)
            await asyncio.sleep(min(left_s, BOUNDS.poll_period_s))
        for _ in range(BOUNDS.max_capture_attempts):
            taken = await self._capture(target, count)
            if taken is not None:
                return taken
        raise DriveFault(
            FaultCause.WRONG_DATA,
            f"no {count} readings in a row came within {1e3 * self._period_s:.3g} ms each, "
            f"in {BOUNDS.max_capture_attempts} attempts; ask for a lower sampling_frequency_hz",
        )

    async def _go(self, target: Target) -> None:
        """Change the angle at zero current, ask the board whether it is there, and only then raise the current."""
        position = self._frame.position(target.theta_rad)
        before = self._board.setpoint
        if before is not None and before.position != position:
            await self._board.hold(Setpoint(before.position, 0.0))
            await asyncio.sleep(BOUNDS.zero_current_s)
            await self._board.hold(Setpoint(position, 0.0))
            await asyncio.sleep(BOUNDS.zero_current_s)
        await self._require_angle(target.theta_rad)
        await self._board.hold(Setpoint(position, target.current_a))

    async def _require_angle(self, theta_rad: float) -> None:
        self._guard.check(await self._board.reading())
        board_rad = await self._board.theta()
        if not abs(math.remainder(board_rad - theta_rad, 2.0 * math.pi)) <= BOUNDS.max_angle_error_rad:
            message = f"the board works at an electrical angle of {board_rad:.4f} rad instead of {theta_rad:.4f} rad"
            raise DriveFault(FaultCause.WRONG_DATA, f"{message}; servopos limits, or a firmware that counts otherwise")

    async def _look(self, target: Target) -> tuple[Reading, complex]:
        now = await self._board.reading()
        self._guard.check(now)
        v = self._frame.stator(*await self._board.voltage(), target.theta_rad)
        self._guard.check_voltage(v)
        return now, v

    async def _capture(self, target: Target, count: int) -> Rows | None:
        """Rows on the grid; None as soon as one of them was not read within its own period."""
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        rows: list[Row] = []
        for k in range(count):
            await asyncio.sleep(begun_s + k * self._period_s - loop.time())
            now, v = await self._look(target)
            if loop.time() > begun_s + (k + 1) * self._period_s:
                return None
            if (what := limiting(now.code)) is not None:
                raise DriveFault(FaultCause.INTERNAL, f"the board keeps the current below its target because of {what}")
            i = self._frame.stator(now.d_a, now.q_a, target.theta_rad)
            rows.append(Row(i, v, now.bus_v, now.temperature_c))
        return Rows(begun_s, tuple(rows))
