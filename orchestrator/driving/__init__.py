"""What all drives do alike: arming within limits, refusing, giving up, the ways out. Energises nothing by itself.

`DriveShell` leaves to a drive what only it can do: `open`, `start`, `ramp`, `telemetry`. A class that keeps the
contract of `protocols.Drive` without it is a drive as well.
"""

# ruff: noqa: B027 - a hook that does nothing is an answer, not a gap

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Mapping
from contextlib import suppress
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

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
"""A number that went over a wire as a single may be off by its rounding (6e-8); it counts as the same."""


class DriveShell(ABC):
    """A drive but for what is its own; implements `Drive` together with it.

    A drive gives `open`, `start`, `ramp` and `telemetry`, and where there is something to do `energise`, `switch_off`,
    `check_link`, `forget_fault`, `release`, `heartbeat` and `set_brake`. A drive that trips raises what `trip` returns.

    Attributes
    ----------
    setup : DriveSetup
        All that it got from outside.
    limits : Limits or None
        What it was armed with; None while it is disarmed.
    """

    name: ClassVar[str]
    Options: ClassVar[type[BaseModel]] = NoOptions
    sealed_options: ClassVar[frozenset[str]] = frozenset()
    why_not: ClassVar[Mapping[ExcitationKind, str]] = {}
    """What keeps it from excitations that it does not claim."""

    def __init__(self, setup: DriveSetup) -> None:
        self.setup = setup
        self.limits: Limits | None = None
        self.latched: list[DriveFault] = []
        self._own: Capabilities | None = None
        self._turn = 0
        self._under_way: Iterator[Capture] | None = None

    # What a drive gives

    @abstractmethod
    def open(self) -> Capabilities:
        """Open the link and identify the drive; nothing is energised."""

    @abstractmethod
    def start(self, excitation: Excitation) -> Iterator[Capture]:
        """Begin an excitation that fits limits and capabilities, and hand out its blocks (see `Drive.execute`).

        The iterator is not drawn from any more once the excitation was given up; a generator is closed then.
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
    """Its former name, which sub-classes may go on overriding."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "attend" in vars(cls):
            cls.check_link = vars(cls)["attend"]  # type: ignore[method-assign]  # the former name stands in

    def forget_fault(self) -> None:
        """Clear the fault that the drive itself keeps."""

    def release(self) -> None:
        """Let go of the link."""

    def heartbeat(self) -> None:
        """Nothing: a drive without a dead man."""

    def set_brake(self, engaged: bool) -> None:
        """Refused: there is none."""
        raise DriveRefused("this drive has no brake to move")

    # What a drive can ask for

    @property
    def own(self) -> Capabilities:
        """Its declared capabilities; raises `DriveRefused` where it is not connected."""
        if self._own is None:
            raise DriveRefused("not connected")
        return self._own

    @property
    def faults(self) -> tuple[str, ...]:
        """Latched faults in words."""
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
        """Keep a fault, once for each cause; what runs is given up."""
        self._turn += 1
        if all(fault.cause is not other.cause for other in self.latched):
            self.latched.append(fault)

    # The contract

    def connect(self) -> Capabilities:
        """Open the link and identify the drive; nothing is energised."""
        self._own = self.open()
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
        self.limits = limits  # before anything is energised: from here on there is something to switch off
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
        self._give_up()
        self._under_way = blocks = self.start(excitation)
        return self._drawn(blocks, self._turn)

    def ramp_down(self) -> None:
        """Current to zero, then held there; nothing to do where the power stage is off."""
        self._give_up()
        if self.state is DriveState.ARMED:
            self.ramp()

    def disarm(self) -> None:
        """PWM off."""
        self._give_up()
        self._power_off()

    def clear_fault(self) -> None:
        """Forget a latched fault; the drive stays disarmed."""
        faulted = self.state is DriveState.FAULTED
        self.forget_fault()
        self.latched.clear()
        if faulted:
            self.limits = None

    def close(self) -> None:
        """Let go of the link."""
        self._give_up()
        self._own = self.limits = None
        self.release()

    # What they share

    def _drawn(self, blocks: Iterator[Capture], turn: int) -> Generator[Capture]:
        try:
            while True:
                if self._turn != turn:
                    raise DriveRefused("the excitation was given up")
                block = next(blocks, None)
                if block is None:
                    return
                yield block
        finally:
            _close(blocks)

    def _give_up(self) -> None:
        """End the excitation that is under way: it moves nothing any more, whoever still holds its iterator."""
        self._turn += 1
        blocks, self._under_way = self._under_way, None
        _close(blocks)

    def _power_off(self) -> None:
        if self.limits is not None:
            self.switch_off()
            self.limits = None


def refuse_limits(limits: Limits, own: Capabilities) -> None:
    """Raise `DriveRefused` where a limit is above the drive's own."""
    for quantity, unit, wanted, most in (
        ("current", "A", limits.current_a, own.max_current_a),
        ("voltage", "V", limits.voltage_v, own.max_voltage_v),
    ):
        if not wanted <= most * SINGLE_PRECISION_RATIO:
            raise DriveRefused(f"{quantity} limit {wanted:g} {unit} is above the drive's own {most:g} {unit}")


def refuse_excitation(excitation: Excitation, limits: Limits, own: Capabilities, resistance_ohm: float) -> None:
    """Raise `DriveRefused` for what the limits, or the drive by its own words, do not allow.

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
        # on open loop: current control saturates by itself
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
    """A block without rows, from a drive that has nothing to hand out yet."""
    none = np.zeros((0, 2))
    fields = {"i_ab": none, "v_ab": none, "v_dc": np.zeros(0)}
    return Capture(start_s=time_s, sampling_frequency_hz=sampling_frequency_hz, **fields)


sign_of_life = keepalive
"""The former name, for drives that import it."""


def _close(blocks: Iterator[Capture] | None) -> None:
    if isinstance(blocks, Generator):
        blocks.close()
