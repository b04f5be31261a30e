"""Checks programs by the device's limits, modes and memory, and allocates their captures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from orchestrator.driving import SINGLE_PRECISION_RATIO
from plugins.commands.emulator._bounds import BOUNDS
from plugins.commands.emulator._memory import CHANNELS, Capture, RippleMemory
from plugins.drives.simulated.rig import Rig
from plugins.wire import (
    LAST_CAPTURE,
    MAX_CAPTURE_BYTES,
    AckStatus,
    Capability,
    CaptureFormat,
    Channel,
    DriveFacts,
    RegisterFile,
    RippleGrid,
    RowFormat,
    Scales,
    limits_of,
    program_of,
    single,
)
from protocols import DriveRefused, Excitation, Injection, Trapezoid


@dataclass(frozen=True)
class DeviceSettings:
    """The device's memory, speed and files."""

    memory_rows: int = 8192
    """Rows of four int16 channels in the capture memory."""
    ring: bool = True
    """Whether a longer capture overwrites its oldest rows; otherwise it is refused."""
    block_bytes: int = 1020
    longest_program_s: float = 3600.0
    speed: float | None = 1.0
    """Simulated over wall time. None: as fast as possible, with whole captures kept (a ring would be
    overwritten before the link has read it)."""
    directory: Path | None = None
    """Folder for the plant's state."""
    interlocks: Path | None = None
    """File that lists the open interlock inputs."""


def facts_of_rig(rig: Rig, settings: DeviceSettings, text: str) -> DriveFacts:
    """Facts of the device beside its capabilities."""
    own = rig.capabilities
    bits = Capability.RIPPLE_ON_DRIVE | Capability.RAW_CAPTURE | Capability.F32_CAPTURE | Capability.RIPPLE_CURVATURE
    if settings.ring:
        bits |= Capability.CAPTURE_RING
    if own.has_brake:
        bits |= Capability.BRAKE
    if rig.simulator.temperature_c is not None:
        bits |= Capability.TEMPERATURE
    if own.interlocks:
        bits |= Capability.INTERLOCKS
    return DriveFacts(
        bits=bits,
        channels=CHANNELS,
        scales=Scales.spanning(
            1.5 * own.max_current_a, 1.1 * own.max_voltage_v, 1.4 * own.dc_bus_voltage_v, 0.5 * own.max_current_a
        ),
        memory_bytes=settings.memory_rows * BOUNDS.row_bytes,
        block_bytes=settings.block_bytes,
        ripple_rate_max_hz=BOUNDS.ripple_rate_hz,
        ripple_memory_rows=BOUNDS.ripple_rows,
        longest_program_s=settings.longest_program_s,
        description=text,
    )


class Programs:
    """Converts registers to excitations and captures; a status gives the reason of a refusal."""

    def __init__(self, rig: Rig, file: RegisterFile, facts: DriveFacts, settings: DeviceSettings) -> None:
        self._rig, self._file, self._facts, self._settings = rig, file, facts, settings
        self._number = 0

    def excitation(self) -> Excitation | AckStatus:
        """The excitation in the registers."""
        try:
            excitation = program_of(self._file.values())
        except ValueError:
            return AckStatus.OUT_OF_RANGE
        # The device's exact PWM frequency instead of its rounding to a single.
        single_hz = excitation.pwm_frequency_hz
        exact_hz = next((f for f in self._rig.capabilities.pwm_frequencies_hz if single(f) == single_hz), single_hz)
        excitation = excitation.model_copy(update={"pwm_frequency_hz": exact_hz})
        status = self._judge(excitation)
        return excitation if status is AckStatus.OK else status

    def capture(self, rows: int, excitation: Excitation | None) -> Capture | AckStatus:
        """Memory for a number of rows, announced in the registers."""
        capture = self._capture(rows, excitation)
        if isinstance(capture, Capture):
            self._number = capture.number
            self._file["capture_number"], self._file["capture_rows"] = float(capture.number), float(capture.rows)
            self._file["capture_row_bytes"] = float(capture.row_bytes)
            self._file["ripple_rows"] = float(capture.ripple.rows if capture.ripple else 0)
        return capture

    def _judge(self, excitation: Excitation) -> AckStatus:
        """Status of an excitation by the run's limits and the device's own."""
        own, fs = self._rig.capabilities, self._rig.capabilities.sampling_frequency_hz
        if isinstance(excitation, Trapezoid) and excitation.periods > BOUNDS.max_trapezoid_periods:
            return AckStatus.TOO_LONG
        if excitation.settling_s + excitation.captured_s > self._settings.longest_program_s * SINGLE_PRECISION_RATIO:
            return AckStatus.TOO_LONG
        if excitation.rows(fs) < 1 or excitation.control.bandwidth_hz > fs / 10:
            return AckStatus.OUT_OF_RANGE
        if excitation.pwm_frequency_hz not in (None, *own.pwm_frequencies_hz):
            return AckStatus.NOT_SUPPORTED
        try:
            self._rig.check(excitation, limits_of(self._file.values()))
        except DriveRefused:
            return AckStatus.PAST_LIMIT
        return AckStatus.OK

    def _capture(self, rows: int, excitation: Excitation | None) -> Capture | AckStatus:
        """Memory for a number of rows, and for the ripple of an injection."""
        number = self._number % LAST_CAPTURE + 1
        channels, f32 = Channel(int(self._file["capture_mask"])), bool(self._file["capture_format"])
        if channels & ~CHANNELS:
            return AckStatus.NOT_SUPPORTED
        form = RowFormat(channels, CaptureFormat(int(f32)), self._facts.scales) if channels else None
        needed = rows * form.row_bytes if form is not None else 0
        if needed > MAX_CAPTURE_BYTES or (not self._settings.ring and needed > self._facts.memory_bytes):
            return AckStatus.NO_MEMORY
        ripple = self._ripple(number, rows, excitation)
        if isinstance(ripple, AckStatus):
            return ripple
        is_ring = self._settings.ring and self._settings.speed is not None
        return Capture(number, rows, form, self._facts.memory_bytes if is_ring else None, ripple)

    def _ripple(self, number: int, rows: int, excitation: Excitation | None) -> RippleMemory | AckStatus | None:
        periods, own = int(self._file["ripple_periods"]), self._rig.capabilities
        if periods == 0 or not isinstance(excitation, Injection):
            return None
        if excitation.frequency_hz / periods > BOUNDS.ripple_rate_hz * SINGLE_PRECISION_RATIO:
            return AckStatus.OUT_OF_RANGE
        fs = own.sampling_frequency_hz
        discarded = round(excitation.discard_s * fs)
        grid = RippleGrid(
            fs,
            excitation.frequency_hz,
            excitation.waveform,
            periods,
            discarded,
            own.voltage_delay_samples,
            bool(self._file["ripple_curvature"]),
        )
        if grid.rows(rows) > BOUNDS.ripple_rows:
            return AckStatus.NO_MEMORY
        return RippleMemory(number, grid, rows, excitation.rotor_angle_rad, self._facts.scales)
