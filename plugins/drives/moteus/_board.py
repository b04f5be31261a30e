"""A moteus board by its official library: who it is, its readings, its setpoint. All coroutines run on one loop.

A setpoint is a *fixed current* in position mode: the board's own 30 kHz current control holds a direct current at an
angle that the commanded position stands for, and its watchdog is at work, which it is not in current and voltage modes.
"""

from __future__ import annotations

import asyncio
import importlib
import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar

from plugins.drives.moteus._bounds import BOUNDS
from plugins.drives.moteus._faults import STARTING, Mode, fault_of
from plugins.drives.moteus._io import within
from plugins.drives.moteus._options import MoteusOptions
from protocols import DriveFault, FaultCause, PluginError

T = TypeVar("T")
_NUMBERS = (
    "motor.poles",
    "motor_position.output.sign",
    "motor_position.rotor_to_output_ratio",
    "servo.max_current_A",
    "servo.pwm_rate_hz",
    "servo.timeout_mode",
    "servo.voltage_mode_control",
    "servo.fixed_voltage_mode",
)

_MARKER, _MARKER_ANSWER = b"tel fmt servo_stats 0", b"OK"
"""A question that changes nothing, as the library asks for binary telemetry, and its answer, which is no number."""


@dataclass(frozen=True)
class Reading:
    """One answer of the board; d and q are its own, at the angle of its setpoint."""

    mode: int
    code: int
    d_a: float
    q_a: float
    bus_v: float
    temperature_c: float


@dataclass(frozen=True)
class Setpoint:
    """A direct current [A] at a position [revolutions of the output]."""

    position: float
    current_a: float


def library() -> Any:
    """The official library, imported when a drive is connected and no sooner.

    Raises
    ------
    PluginError
        Where it is not installed.
    """
    try:
        return importlib.import_module("moteus")
    except ImportError as error:
        problem = f"needs the official library of moteus: pip install 'fluxbench[moteus]' ({error})"
        raise PluginError("drive", "moteus", problem) from error


class Board:
    """The conversation with one board; to be made and used on the loop of an `Io`."""

    def __init__(self, moteus: Any, options: MoteusOptions) -> None:
        self._options = options
        self._map = moteus.Register
        if options.port is not None:
            self._transport = moteus.Fdcanusb(options.port)
        else:
            self._transport = moteus.PythonCan(interface=options.interface, channel=options.channel, fd=True)
        self._controller = moteus.Controller(id=options.id, transport=self._transport)
        self._stream = moteus.Stream(self._controller)
        self._query = _query(moteus)
        self._line, self._talk = asyncio.Lock(), asyncio.Lock()
        self.setpoint: Setpoint | None = None
        """What the heartbeat repeats; None where the power stage is off."""

    def release(self) -> None:
        """Let go of the port."""
        self._transport.close()

    # Who it is

    async def versions(self) -> dict[str, int]:
        """Firmware version and register map."""
        wanted = {self._map.FIRMWARE_VERSION: 2, self._map.REGISTER_MAP_VERSION: 2}
        values = await self._answered(self._controller.make_custom_query(wanted))
        return {key.name.lower(): _whole(key.name.lower(), values[key]) for key in wanted if key in values}

    async def numbers(self) -> dict[str, float]:
        """What has to be known of its configuration; the telemetry's layouts are learned on the way."""
        await self._on_stream(self._stream.flush_read)  # what the host before this one did not wait for
        values = {name: await self._configured(name) for name in _NUMBERS}
        await self.voltage()
        await self.theta()
        return values

    async def _configured(self, name: str) -> float:
        async def ask() -> str:
            line = await self._stream.command(f"conf get {name}".encode(), allow_any_response=True)
            # An answer does not name its question: one that comes twice would be read as the next one's.
            after = await self._stream.command(_MARKER, allow_any_response=True)
            if after != _MARKER_ANSWER:
                raise RuntimeError(f"{line!r} and {after!r} answer conf get {name}")
            return str(line.decode("latin1")).strip()

        try:
            answer = await self._on_stream(ask)
        except RuntimeError as error:
            problem = f"answers on the diagnostic stream are not those of their questions: {error}"
            raise DriveFault(FaultCause.WRONG_DATA, problem) from error
        try:
            value = float(answer)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise DriveFault(FaultCause.WRONG_DATA, f"the board has no number for {name}: {answer}")
        return value

    async def limit_current(self, current_a: float) -> None:
        """Set the board's own limit in its memory (not for good), and read it back."""
        name = "servo.max_current_A"
        await self._on_stream(lambda: self._stream.command(f"conf set {name} {current_a:.6f}".encode()))
        held = await self._configured(name)
        if not math.isclose(held, current_a, rel_tol=1e-4):
            raise DriveFault(FaultCause.WRONG_DATA, f"{name} is {held:g} after {current_a:g} was written")

    # Readings

    async def reading(self) -> Reading:
        """Mode, fault, currents and bus voltage of one moment."""
        values = await self._answered(self._controller.make_query(self._query))
        r = self._map
        try:
            return Reading(
                *(_whole(k.name.lower(), values[k]) for k in (r.MODE, r.FAULT)),
                *(float(values[k]) for k in (r.D_CURRENT, r.Q_CURRENT, r.VOLTAGE, r.TEMPERATURE)),
            )
        except KeyError as error:
            raise DriveFault(FaultCause.WRONG_DATA, f"the board's answer lacks register {error}") from error

    async def voltage(self) -> tuple[float, float]:
        """The d and q voltage that the board's current control commands [V]."""
        control = await self._on_stream(lambda: self._stream.read_data("servo_control"))
        return float(control.d_V), float(control.q_V)

    async def theta(self) -> float:
        """The electrical angle that the board works with [rad]."""
        stats = await self._on_stream(lambda: self._stream.read_data("servo_stats"))
        return float(stats.electrical_theta)

    # Power stage

    async def hold(self, setpoint: Setpoint) -> None:
        """Take up a setpoint; the heartbeat repeats it from now on."""
        async with self._line:
            self.setpoint = setpoint
            await self._exchange(self._command(setpoint))

    async def enabled(self) -> None:
        """Wait until the power stage is on. Raises `DriveFault` where it does not come on."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + BOUNDS.enable_timeout_s
        while (now := await self.reading()).mode in STARTING:
            if loop.time() > deadline:
                raise DriveFault(FaultCause.NO_ANSWER, f"the power stage is not on after {BOUNDS.enable_timeout_s:g} s")
            await asyncio.sleep(0.005)
        fault = fault_of(now.mode, now.code, self._options.watchdog_s)
        if fault is not None:
            raise fault
        if now.mode != Mode.POSITION:
            raise DriveFault(FaultCause.WRONG_DATA, f"the board went to mode {now.mode} instead of {Mode.POSITION:d}")

    async def feed(self) -> None:
        """Repeat the setpoint: only this feeds the board's watchdog."""
        async with self._line:
            if self.setpoint is not None:
                await self._exchange(self._command(self.setpoint))

    async def stop(self) -> None:
        """Power stage off; this clears a fault on the board as well."""
        async with self._line:
            self.setpoint = None
            await self._exchange(self._controller.make_stop())
        for _ in range(20):
            if (await self.reading()).mode == Mode.STOPPED:
                return
            await asyncio.sleep(0.01)
        raise DriveFault(FaultCause.NO_ANSWER, "the board does not stop")

    def _command(self, setpoint: Setpoint) -> Any:
        return self._controller.make_position(
            position=setpoint.position,
            velocity_limit=BOUNDS.unlimited,
            accel_limit=BOUNDS.unlimited,
            watchdog_timeout=self._options.watchdog_s,
            fixed_current_override=setpoint.current_a,
            ignore_position_bounds=1,
        )

    # What they share

    async def _answered(self, command: Any) -> dict[Any, Any]:
        """The registers of an answer; a lost query is repeated once, for it changes nothing."""
        for _ in range(2):
            async with self._line:
                answer = await self._exchange(command)
            if answer is not None:
                values: dict[Any, Any] = answer.values
                return values
        raise self._silent()

    async def _exchange(self, command: Any) -> Any:
        """One exchange; by USB the library would wait for ever."""
        try:
            return await within(self._controller.execute(command), BOUNDS.answer_timeout_s)
        except TimeoutError as error:
            raise self._silent() from error

    async def _on_stream(self, talk: Callable[[], Coroutine[Any, Any, T]]) -> T:
        """Have a conversation on the diagnostic stream to its end: one that is cut short would spoil the next."""

        async def repeated() -> T:
            try:
                return await talk()
            except RuntimeError:
                # A frame that was sent again is answered again: the surplus line is dropped, and the question repeated.
                await self._stream.flush_read()
                return await talk()

        async def whole() -> T:
            async with self._talk:
                try:
                    return await within(repeated(), BOUNDS.stream_timeout_s)
                except TimeoutError as error:
                    raise self._silent() from error

        return await asyncio.shield(asyncio.ensure_future(whole()))

    def _silent(self) -> DriveFault:
        return DriveFault(FaultCause.LINK_LOST, f"{self._options.where} does not answer")


def _whole(register: str, value: float) -> int:
    """A register that counts; the library reads the lowest value of an integer as NaN."""
    if not math.isfinite(value):
        raise DriveFault(FaultCause.WRONG_DATA, f"the board has no number for register {register}: {value}")
    return int(value)


def _query(moteus: Any) -> Any:
    """What a reading asks for."""
    query = moteus.QueryResolution()
    query.position = query.velocity = query.torque = moteus.IGNORE
    query.mode = query.fault = moteus.INT8
    query.q_current = query.d_current = query.voltage = query.temperature = moteus.F32
    return query
