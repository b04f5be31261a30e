"""Base class of drives: arming within limits, refusing excitations, aborting them, shutting down.

A drive that subclasses `DriveShell` adds the hardware access: `open`, `start`, `ramp`, `telemetry`. A class that keeps
the contract of `protocols.Drive` without it is a drive as well.
"""

# ruff: noqa: B027 - empty hooks are valid defaults

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Mapping
from contextlib import suppress
from typing import ClassVar

import numpy as np
from pydantic import BaseModel, ValidationError

from orchestrator.driving.readings import impossible_reading
from protocols import (
    Capabilities,
    Capture,
    DriveError,
    DriveFault,
    DriveRefused,
    DriveSetup,
    DriveState,
    Excitation,
    ExcitationKind,
    Injection,
    Limits,
    NoOptions,
    Telemetry,
    VoltageSteps,
)

SINGLE_PRECISION_RATIO = 1.0 + 1e-6
"""Tolerance for numbers rounded to single precision (6e-8) by a link."""


class DriveShell(ABC):
    """Base class of a drive; a subclass adds the hardware access.

    Required: `open`, `start`, `ramp`, `telemetry`. Optional: `energise`, `switch_off`, `check_link`, `forget_fault`,
    `release`, `heartbeat`, `set_brake`. A drive that trips raises what `trip` returns.

    Attributes
    ----------
    setup : DriveSetup
        Motor, options, seed and private directory.
    limits : Limits or None
        Limits it was armed with; None while disarmed.
    """

    name: ClassVar[str]
    Options: ClassVar[type[BaseModel]] = NoOptions
    sealed_options: ClassVar[frozenset[str]] = frozenset()
    why_not: ClassVar[Mapping[ExcitationKind, str]] = {}
    """Reasons, by excitation kind, why the drive does not offer it."""

    def __init__(self, setup: DriveSetup) -> None:
        self.setup = setup
        self.limits: Limits | None = None
        self.latched: list[DriveFault] = []
        self._own: Capabilities | None = None
        self._excitation_number = 0
        self._excitation_blocks: Iterator[Capture] | None = None

    # To override

    @abstractmethod
    def open(self) -> Capabilities:
        """Open the link and identify the drive; nothing is energised."""

    @abstractmethod
    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Begin an excitation that fits limits and capabilities, and hand out its blocks (see `Drive.execute`).

        After an abort the iterator is not advanced any more; a generator is closed.
        """

    @abstractmethod
    def ramp(self) -> None:
        """Bring the current of the armed drive to zero."""

    @abstractmethod
    def telemetry(self) -> Telemetry:
        """A reading, now."""

    def energise(self, limits: Limits) -> None:
        """Hand over the limits and enable the power stage."""

    def switch_off(self) -> None:
        """PWM off."""
        self.ramp()

    def check_link(self) -> None:
        """Raise `DriveFault` where the link is lost or the drive has tripped; arming and executing begin with it."""

    attend = check_link
    """The former name, which subclasses may still override."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "attend" in vars(cls):
            cls.check_link = vars(cls)["attend"]  # type: ignore[method-assign]  # the former name stands in

    def forget_fault(self) -> None:
        """Clear the fault latched in the drive itself."""

    def release(self) -> None:
        """Close the link."""

    def heartbeat(self) -> None:
        """Does nothing by default: a drive without a watchdog."""

    def set_brake(self, engaged: bool) -> None:
        """Refused by default: the drive has no brake."""
        raise DriveRefused("this drive has no brake to move")

    # Helpers for subclasses

    @property
    def own(self) -> Capabilities:
        """Its declared capabilities; raises `DriveRefused` where it is not connected."""
        if self._own is None:
            raise DriveRefused("not connected")
        return self._own

    @property
    def faults(self) -> tuple[str, ...]:
        """Texts of the latched faults."""
        return tuple(fault.cause.value for fault in self.latched)

    @property
    def state(self) -> DriveState:
        if self.faults:
            return DriveState.FAULTED
        return DriveState.DISARMED if self.limits is None else DriveState.ARMED

    def trip(self, fault: DriveFault) -> DriveFault:
        """Latch a fault and switch off, as far as the drive can still be reached; returned to be raised."""
        self.latch(fault)
        with suppress(DriveError):  # the fault being raised matters more
            self._power_off()
        return fault

    def latch(self, fault: DriveFault) -> None:
        """Latch a fault, once for each cause, and abort the running excitation."""
        self._excitation_number += 1
        if all(fault.cause is not other.cause for other in self.latched):
            self.latched.append(fault)

    # The contract

    def connect(self) -> Capabilities:
        """Open the link and identify the drive; raises `DriveFault` where it states what cannot be."""
        try:
            self._own = self.open()
        except ValidationError as error:
            raise impossible_reading(self.name, error) from None
        return self._own

    def arm(self, limits: Limits) -> None:
        """Enable the power stage within these limits.

        Raises `DriveRefused` where a limit is above the drive's own or a fault is latched.
        """
        own = self.own
        self.check_link()
        if self.faults:
            raise DriveRefused(f"a fault is latched ({', '.join(self.faults)}); clear it first")
        refuse_limits(limits, own)
        self.limits = limits  # set first, so that a failure in `energise` is switched off
        try:
            self.energise(limits)
        except DriveRefused:
            self.limits = None
            raise

    def execute(self, excitation: Excitation) -> Generator[Capture]:
        """Check the excitation, then run it as the iterator is drawn from."""
        own = self.own
        self.check_link()
        if self.limits is None or self.faults:
            reason = ", ".join((self.state.value, *self.faults))
            raise DriveRefused(f"not armed ({reason})")
        if excitation.kind not in own.excitations and excitation.kind in self.why_not:
            raise DriveRefused(f"this drive has no {excitation.kind}: {self.why_not[excitation.kind]}")
        refuse_excitation(excitation, self.limits, own, self.setup.motor.stator_resistance_ohm or 0.0)
        self._abort_excitation()
        self._excitation_blocks = blocks = self.start(excitation)
        return self._drawn(blocks, self._excitation_number)

    def ramp_down(self) -> None:
        """Current to zero, then held there; nothing to do where the power stage is off."""
        self._abort_excitation()
        if self.state is DriveState.ARMED:
            self.ramp()

    def disarm(self) -> None:
        """PWM off."""
        self._abort_excitation()
        self._power_off()

    def clear_fault(self) -> None:
        """Forget a latched fault; the drive stays disarmed."""
        faulted = self.state is DriveState.FAULTED
        self.forget_fault()
        self.latched.clear()
        if faulted:
            self.limits = None

    def close(self) -> None:
        """Close the link."""
        self._abort_excitation()
        self._own = self.limits = None
        self.release()

    # Private

    def _drawn(self, blocks: Iterator[Capture], generation: int) -> Generator[Capture]:
        try:
            while True:
                if self._excitation_number != generation:
                    raise DriveRefused("the excitation was given up")
                block = next(blocks, None)
                if block is None:
                    return
                yield block
        finally:
            _close(blocks)

    def _abort_excitation(self) -> None:
        """Abort the running excitation; its iterator then raises `DriveRefused`."""
        self._excitation_number += 1
        blocks, self._excitation_blocks = self._excitation_blocks, None
        _close(blocks)

    def _power_off(self) -> None:
        if self.limits is not None:
            self.switch_off()
            self.limits = None


def refuse_limits(limits: Limits, own: Capabilities) -> None:
    """Raise `DriveRefused` where a limit is above the drive's own."""
    for quantity, unit, value, maximum in (
        ("current", "A", limits.current_a, own.max_current_a),
        ("voltage", "V", limits.voltage_v, own.max_voltage_v),
    ):
        if not value <= maximum * SINGLE_PRECISION_RATIO:
            raise DriveRefused(f"{quantity} limit {value:g} {unit} is above the drive's own {maximum:g} {unit}")


def refuse_excitation(excitation: Excitation, limits: Limits, own: Capabilities, resistance_ohm: float) -> None:
    """Raise `DriveRefused` for an excitation beyond the limits or the drive's capabilities.

    Parameters
    ----------
    resistance_ohm : float
        R_s of the nameplate, for the voltage below an injection's; 0 where it is not known.
    """
    if excitation.kind not in own.excitations:
        raise DriveRefused(f"this drive has no {excitation.kind}")
    for field, value in excitation:
        if isinstance(value, float) and not math.isfinite(value):
            raise DriveRefused(f"{field} is not a finite number")
    pwm = excitation.pwm_frequency_hz
    if pwm is not None and not any(
        math.isclose(pwm, f, rel_tol=SINGLE_PRECISION_RATIO - 1.0) for f in own.pwm_frequencies_hz
    ):
        choices = ", ".join(f"{f:g}" for f in own.pwm_frequencies_hz)
        raise DriveRefused(f"PWM frequency {pwm:g} Hz; this drive has {choices} Hz")
    captured_s = excitation.captured_s
    if excitation.rows(own.sampling_frequency_hz) < 1:
        raise DriveRefused(f"nothing to capture: {captured_s:g} s is less than a sample")
    if own.longest_capture_s is not None and captured_s > own.longest_capture_s * SINGLE_PRECISION_RATIO:
        raise DriveRefused(f"capture of {captured_s:g} s is longer than the drive's {own.longest_capture_s:g} s")
    whole_s = excitation.settling_s + captured_s
    if own.longest_excitation_s is not None and whole_s > own.longest_excitation_s * SINGLE_PRECISION_RATIO:
        raise DriveRefused(f"{whole_s:g} s with settling are longer than the drive's {own.longest_excitation_s:g} s")
    current_a = excitation.longest_current_a
    if current_a > limits.current_a * SINGLE_PRECISION_RATIO:
        raise DriveRefused(f"current {current_a:.4g} A is above the limit of {limits.current_a:g} A")
    if isinstance(excitation, VoltageSteps) and excitation.voltage_v > limits.voltage_v * SINGLE_PRECISION_RATIO:
        raise DriveRefused(f"steps of {excitation.voltage_v:.4g} V are above the limit of {limits.voltage_v:g} V")
    if isinstance(excitation, Injection):
        _refuse_injection(excitation, own)
        # Only injected voltage needs this check: current control saturates at the limit.
        voltage_v = excitation.amplitude_v + resistance_ohm * current_a
        if voltage_v > limits.voltage_v * SINGLE_PRECISION_RATIO:
            raise DriveRefused(
                f"injection of {excitation.amplitude_v:g} V at {current_a:.4g} A needs {voltage_v:.4g} V, "
                f"above the limit of {limits.voltage_v:g} V"
            )


def _refuse_injection(e: Injection, own: Capabilities) -> None:
    if e.waveform not in own.injection_waveforms:
        raise DriveRefused(f"this drive injects no {e.waveform} wave")
    if own.injects_at_zero_only and e.longest_current_a > 0.0:
        raise DriveRefused("this drive injects at zero current only")
    whole_s, longest_s = e.discard_s + e.captured_s, own.longest_injection_s
    if longest_s is not None and whole_s > longest_s * SINGLE_PRECISION_RATIO:
        raise DriveRefused(f"an injection of {whole_s:g} s is longer than the drive's {longest_s:g} s")


def in_blocks(capture: Capture, longest_s: float = 0.25, rows: int | None = None) -> Iterator[Capture]:
    """The first `rows` of a capture (default: all) as blocks of at most `longest_s`, whose arrays are views."""
    fs, end = capture.sampling_frequency_hz, len(capture) if rows is None else rows
    step = max(1, int(longest_s * fs))
    for first in range(0, end, step):
        part = slice(first, min(first + step, end))
        arrays = {name: x[part] for name, x in capture if isinstance(x, np.ndarray)}
        yield Capture(start_s=capture.start_s + first / fs, sampling_frequency_hz=fs, **arrays)


def keepalive(time_s: float, sampling_frequency_hz: float) -> Capture:
    """A block without rows, while a drive has no samples yet."""
    none = np.zeros((0, 2))
    fields = {"i_ab": none, "v_ab": none, "v_dc": np.zeros(0)}
    return Capture(start_s=time_s, sampling_frequency_hz=sampling_frequency_hz, **fields)


sign_of_life = keepalive
"""The former name, for drives that import it."""


def _close(blocks: Iterator[Capture] | None) -> None:
    if isinstance(blocks, Generator):
        blocks.close()
