"""The drive `vesc`: a VESC by its public commands, with a thousand rows of every control period at a time.

It supports `gates_off`, `hold`, and `injection` at zero current; docs/vesc.md gives the reasons.
"""

from __future__ import annotations

import cmath
import math
import time
from collections.abc import Generator, Iterator, Mapping
from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, Field

from orchestrator.driving.polled import PolledDrive
from plugins.drives.vesc import _rows
from plugins.drives.vesc._board import FOC_MOTOR_TYPE, INJECTING_SENSOR_MODES, Board, Settings
from plugins.drives.vesc._link import Link
from plugins.drives.vesc._packets import Sampling, Values, rows_of
from protocols import (
    Capabilities,
    Capture,
    DriveFault,
    DriveRefused,
    DriveSetup,
    Excitation,
    ExcitationKind,
    FaultCause,
    GatesOff,
    Hold,
    Injection,
    Limits,
    Strict,
    Telemetry,
)

KINDS: frozenset[ExcitationKind] = frozenset({"gates_off", "hold", "injection"})
OLDEST_FIRMWARE = (6, 6)
MEMORY_ROWS = 1000
"""Rows that the board's memory holds."""
MAX_INJECTION_ROWS = 600
"""Rows of an injection; the rest of the memory is the wait for its direction, up to half a turn."""
RATE_STEP_HZ = 10.0
"""Resolution of the rows' rate."""
MAX_UPLOAD_S = 10.0
"""Time for the transfer of the rows (50 kB) by a slow line."""
MAX_RAMP_S = 0.5
"""Time in which the current has to fall to zero."""
POLL_PERIOD_S = 0.01
MIN_HELD_CURRENT_A = 0.05
"""Current below which the board releases the motor (`cc_min_current`)."""
MAX_CURRENT_ERROR_RATIO = 0.3
"""Deviation of the mean current over its set-point, above which it is an error."""
TRIP_RATIO = 1.5
"""Trip current of the board over the run's current limit."""
MIN_TRIP_RATIO = 0.05
"""Smallest trip current over the board's configured one."""
FAULTS: dict[int, tuple[FaultCause, str]] = {
    1: (FaultCause.BUS_VOLTAGE, "over voltage"),
    2: (FaultCause.BUS_VOLTAGE, "under voltage"),
    3: (FaultCause.INTERNAL, "gate driver"),
    4: (FaultCause.OVERCURRENT, "the current passed l_abs_current_max"),
    5: (FaultCause.OVERTEMPERATURE, "its transistors are too hot"),
    6: (FaultCause.OVERTEMPERATURE, "the motor is too hot"),
}


class VescOptions(Strict):
    """Options of the drive `vesc`."""

    port: Annotated[str, Field(min_length=1, examples=["/dev/ttyACM0"])]
    """Serial device, or ``socket://host:port`` of a TCP bridge."""
    baud_rate: Annotated[int, Field(ge=1)] = 115200
    """Baud rate of a UART; irrelevant on USB."""
    watchdog_s: Annotated[float, Field(ge=0.1, le=10.0)] = 0.5
    """Timeout of the board during the run."""


class VescDrive(PolledDrive[Board]):
    """A VESC as a drive; implements `Drive`, and `ResumableDrive` for its clock.

    Parameters
    ----------
    setup : DriveSetup
        With `VescOptions`.
    """

    name: ClassVar[str] = "vesc"
    Options: ClassVar[type[BaseModel]] = VescOptions
    why_not: ClassVar[Mapping[ExcitationKind, str]] = {
        "trapezoid": "its memory has a thousand rows, and no command sets a current at a known instant",
        "steps": "it has no command that reverses a voltage at a current limit",
        "spin": "it supports a locked rotor only",
    }

    def __init__(self, setup: DriveSetup) -> None:
        super().__init__(setup)
        self._options: VescOptions = setup.options
        self._settings: Settings | None = None
        self._beaten_s, self._missed = math.inf, False

    # Link

    def open(self) -> Capabilities:
        """Read the board's version and configuration. Nothing is energised.

        Raises
        ------
        DriveFault
            No answer, or an unusable one.
        DriveRefused
            Firmware too old, or an unsuitable configuration.
        """
        o = self._options
        link = Link(o.port, o.baud_rate)
        self.board = board = Board(link)
        major, minor, name = board.version()
        if (major, minor) < OLDEST_FIRMWARE:
            needed = ".".join(f"{n:02d}" for n in OLDEST_FIRMWARE).lstrip("0")
            raise DriveRefused(f"{link.where}: firmware {major}.{minor:02d} of {name!r}, {needed} or newer is needed")
        self._settings = settings = board.settings()
        _require_usable(settings, link.where)
        fs = _rate(settings.zero_vectors_hz, board.row_rate_hz(), link.where)
        bus_v = board.values().bus_v
        if not 0.0 < bus_v < math.inf:
            raise DriveFault(FaultCause.BUS_VOLTAGE, f"{link.where}: reads a bus of {bus_v:g} V")
        self.origin_s = time.monotonic()
        pwm = 0.5 * settings.zero_vectors_hz
        return Capabilities(
            name="vesc",
            sampling_frequency_hz=fs,
            pwm_frequency_hz=pwm,
            pwm_frequencies_hz=(pwm,),
            dc_bus_voltage_v=bus_v,
            voltage_delay_samples=0.5 * fs / pwm,
            max_current_a=settings.own_limit_a,
            max_voltage_v=settings.max_duty * bus_v / math.sqrt(3.0),
            longest_capture_s=MEMORY_ROWS / fs,
            injection_waveforms=frozenset(("sine",)),
            injects_at_zero_only=True,
            longest_injection_s=MAX_INJECTION_ROWS / fs,
            heeds_bandwidth=False,
            excitations=KINDS,
            watchdog_s=o.watchdog_s,
            watchdog_covers=KINDS - {"gates_off"},
            notes=(f"{name}, firmware {major}.{minor:02d}; {MEMORY_ROWS} rows at a time (docs/vesc.md)",),
        )

    def heartbeat(self) -> None:
        """Feed the board's timeout; a heartbeat too late for it is noted."""
        board, now_s = self.board, time.monotonic()
        if board is None or self.limits is None:
            return
        self._missed = self._missed or now_s - self._beaten_s > self._options.watchdog_s
        try:
            board.alive()
        except DriveFault:
            return  # the link keeps it
        self._beaten_s = now_s

    # Power stage

    def energise(self, limits: Limits) -> None:
        """Set the board's limits and timeout; the first current set-point switches its bridge on."""
        board, own = self.connected(), self._own_settings()
        try:
            board.hold(0.0, 0.0)
            board.apply(
                min(limits.current_a / own.current_max_a, own.max_scale),
                min(limits.current_a / abs(own.current_min_a), own.min_scale),
                min(max(TRIP_RATIO * limits.current_a, MIN_TRIP_RATIO * own.abs_current_a), own.abs_current_a),
                1e3 * self._options.watchdog_s,
            )
            board.alive()
            self._beaten_s, self._missed = time.monotonic(), False
            deadline = self._beaten_s + self._options.watchdog_s
            while (now := board.values()).timed_out and time.monotonic() < deadline:
                board.alive()
                time.sleep(POLL_PERIOD_S)
            self.require_sound(self._fault(now))
        except DriveFault as fault:
            raise self.trip(fault) from None

    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Start the excitation as its rows are drawn; refuses currents below `MIN_HELD_CURRENT_A`."""
        if 0.0 < excitation.longest_current_a < MIN_HELD_CURRENT_A:
            raise DriveRefused(f"{excitation.longest_current_a:g} A: a VESC releases below {MIN_HELD_CURRENT_A:g} A")
        if isinstance(excitation, Hold):
            return self.tripping(self._hold_rows(excitation))
        if isinstance(excitation, GatesOff):
            return self.tripping(self._gates_off_rows(excitation))
        assert isinstance(excitation, Injection)
        if 0.0 < excitation.rotation_hz * MAX_INJECTION_ROWS / self.own.sampling_frequency_hz < 1.0 - 1e-6:
            raise DriveRefused(f"the rows hold no whole turn of a direction rotating at {excitation.rotation_hz:g} Hz")
        return self.tripping(self._injection_rows(excitation))

    def telemetry(self) -> Telemetry:
        """A reading of the last hundredth of a second."""
        board = self.connected()
        board.values()
        time.sleep(POLL_PERIOD_S)
        now = board.values()
        if self.limits is not None and not self.latched and (fault := self._fault(now)) is not None:
            self.trip(fault)
        turn = cmath.phase(self.target_a) - self.rotor_angle_rad if self.target_a else 0.0
        return self.reading(now.i * cmath.exp(1j * turn), now.bus_v, self.own.pwm_frequency_hz)

    def ramp(self) -> None:
        """Set a target of zero: the board releases the motor within a millisecond."""
        board = self.connected()
        board.hold(0.0, math.degrees(cmath.phase(self.target_a)))
        self.target_a = 0j
        board.values()

        def flows() -> bool:
            time.sleep(POLL_PERIOD_S)
            return abs(board.values().i) > MIN_HELD_CURRENT_A

        self.await_zero_current(flows, MAX_RAMP_S)

    def switch_off(self) -> None:
        """Release the motor, wait for the end of a tone, and restore the board's settings."""
        board, own = self.connected(), self._own_settings()
        self.ramp()
        time.sleep(max(0.0, board.released_s - time.monotonic()))
        board.apply(own.max_scale, own.min_scale, own.abs_current_a, own.timeout_ms)

    # Excitations

    def _hold_rows(self, hold: Hold) -> Generator[Capture]:
        board, fs = self.connected(), self.own.sampling_frequency_hz
        self.aim(hold)
        size, angle = cmath.polar(self.target_a)
        board.hold(size, math.degrees(angle))
        yield from self.waiting(max(hold.settle_s, board.released_s - time.monotonic() if not size else 0.0))
        board.values()
        rows, start_s, now = yield from self._sampled(hold.rows(fs))
        i = _rows.currents(rows)
        v = np.zeros_like(i)
        if size:
            turn = cmath.exp(1j * angle)
            inside = i / turn
            if abs(inside.mean() - size) > MAX_CURRENT_ERROR_RATIO * size:
                message = f"set-point {size:.4g} A, measured {inside.mean():.4g} A: the board limits or has released it"
                raise DriveFault(FaultCause.INTERNAL, message)
            own = self._own_settings()
            moved = _rows.control(inside, size, (own.proportional, own.integral), 1.0 / fs)
            v = (now.v + moved - moved.mean()) * turn
        yield from self.blocks(i, v, start_s, now.bus_v)

    def _gates_off_rows(self, gates_off: GatesOff) -> Generator[Capture]:
        board = self.connected()
        self.ramp()
        yield from self.waiting(board.released_s - time.monotonic())
        rows, start_s, now = yield from self._sampled(gates_off.rows(self.own.sampling_frequency_hz))
        i = _rows.currents(rows)
        yield from self.blocks(i, np.zeros_like(i), start_s, now.bus_v)

    def _injection_rows(self, e: Injection) -> Generator[Capture]:
        """A tone along q of a rotating frame; rows start with the bridge's first period and thus with the wave."""
        board, own, fs = self.connected(), self._own_settings(), self.own.sampling_frequency_hz
        frequency, count = e.frequency_hz * _rows.TONE_FREQUENCY_RATIO, e.rows(fs)
        self.ramp()
        self.rotor_angle_rad = e.rotor_angle_rad
        yield from self.waiting(max(e.settle_s, board.released_s - time.monotonic()))
        board.sample(Sampling.START, MEMORY_ROWS)
        board.tone(frequency, e.amplitude_v, e.rotation_hz, MEMORY_ROWS / fs + 0.05)
        rows, start_s, now = yield from self._receive_rows(MEMORY_ROWS)
        frame, begin = _rows.turning_frame(rows, e.rotation_hz, 1.0 / fs)
        wave_phase, voltage = _rows.tone(MEMORY_ROWS, frequency, e.amplitude_v, 1.0 / fs)
        i, turn = _rows.currents(rows), np.exp(1j * frame)
        moved = _rows.control(i / turn, 0.0, (own.proportional, own.integral), 1.0 / fs)
        late_s = e.discard_s
        at = _rows.window(
            frame + 0.5 * math.pi,
            wave_phase,
            e.rotor_angle_rad + 2.0 * math.pi * e.rotation_hz * late_s,
            e.frequency_hz * late_s,
            max(begin, round(late_s * fs)),
            MEMORY_ROWS - count,
            e.frequency_hz / fs,
        )
        chosen = slice(at, at + count)
        v = (voltage + moved - moved[chosen].mean()) * turn
        yield from self.blocks(i[chosen], v[chosen], start_s + at / fs, now.bus_v)

    def _sampled(self, count: int) -> Generator[Capture, None, tuple[np.ndarray, float, Values]]:
        self.connected().sample(Sampling.NOW, count)
        return (yield from self._receive_rows(count))

    def _receive_rows(self, count: int) -> Generator[Capture, None, tuple[np.ndarray, float, Values]]:
        """Receive rows; returns them, the clock at their start, and a reading during sampling."""
        board, fs = self.connected(), self.own.sampling_frequency_hz
        begun_s = time.monotonic()
        yield from self.waiting(count / fs)
        now = board.values()
        self.require_sound(self._fault(now))
        payloads: list[bytes] = []
        while len(payloads) < count:
            row = board.row(self.keepalive_period_s)
            if row is not None:
                payloads.append(row)
            elif time.monotonic() - begun_s > MAX_UPLOAD_S:
                raise DriveFault(
                    FaultCause.NO_ANSWER, f"{len(payloads)} rows of {count} came within {MAX_UPLOAD_S:g} s"
                )
            if row is None or len(payloads) % 100 == 0:
                yield self.keepalive()
        self.require_sound(self._fault(board.values()))
        return rows_of(payloads), begun_s - self.origin_s, now

    # Faults

    def forget_fault(self) -> None:
        """Nothing to clear: the board clears its fault by itself."""
        self.connected()
        self._missed = False

    def board_fault(self) -> DriveFault | None:
        """Fault by the board's trip, or by its timeout."""
        return self._fault(self.connected().values())

    def _fault(self, now: Values) -> DriveFault | None:
        if now.fault:
            cause, hint = FAULTS.get(now.fault, (FaultCause.INTERNAL, "see `faults` in its terminal"))
            return DriveFault(cause, f"VESC fault {now.fault}: {hint}")
        if now.timed_out or self._missed:
            return DriveFault(FaultCause.HEARTBEAT_LOST, f"no heartbeat for {self._options.watchdog_s:g} s")
        return None

    def _own_settings(self) -> Settings:
        assert self._settings is not None  # read on connecting
        return self._settings


def _require_usable(settings: Settings, where: str) -> None:
    if settings.motor_type != FOC_MOTOR_TYPE:
        raise DriveRefused(f"{where}: its motor type is not FOC")
    if settings.sensor_mode in INJECTING_SENSOR_MODES:
        raise DriveRefused(f"{where}: its sensor mode injects a signal (HFI); choose another one for the run")
    if settings.inverted:
        raise DriveRefused(f"{where}: its motor direction is inverted, which inverts angles; disable that for the run")
    if not settings.own_limit_a > 0.0 or not settings.current_min_a < 0.0:
        raise DriveRefused(f"{where}: its current limits are {settings.current_min_a:g} and {settings.own_limit_a:g} A")


def _rate(zero_vectors_hz: float, row_rate_hz: float, where: str) -> float:
    """Control rate [Hz]: one period per zero vector or per two, by the rate of the rows."""
    for rate_hz in (0.5 * zero_vectors_hz, zero_vectors_hz):
        if 0.0 <= rate_hz - row_rate_hz <= 2.0 * RATE_STEP_HZ:
            return rate_hz
    message = f"rows of {row_rate_hz:g} Hz at foc_f_zv {zero_vectors_hz:g} Hz"
    raise DriveRefused(f"{where}: {message}; expected one row per zero vector or per two")
