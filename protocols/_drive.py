"""The drive: its capabilities, its excitations, and the captures that it returns.

The drive executes whole excitations: the control loop and the injection run on its side, at its
own rate. The engine never sits in a control loop.

A drive plugin is a class with the `Drive` protocol whose constructor takes a `DriveSetup`; it is
registered as an entry point of the group ``fluxbench.drives``.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

from pydantic import BaseModel, ConfigDict

from protocols._base import Strict
from protocols._excitations import Excitation, ExcitationKind, NonNegative, Waveform
from protocols._motor import Motor, Positive
from protocols._recording import Capture


class Limits(Strict):
    """Limits of the experiment; the drive enforces them as well."""

    current_a: Positive
    """Longest current vector [A peak]."""
    voltage_v: Positive
    """Longest voltage vector [V peak]."""
    energy_j: Positive | None = None
    """Most copper loss over the whole run [J]."""
    duration_s: Positive | None = None
    """Longest run [s]."""


class Capabilities(Strict):
    """Capabilities that a connected drive states; plans are checked against them."""

    name: str
    sampling_frequency_hz: Positive
    pwm_frequency_hz: Positive
    pwm_frequencies_hz: tuple[Positive, ...]
    """All that it supports; holds `pwm_frequency_hz`."""
    dc_bus_voltage_v: Positive
    voltage_delay_samples: NonNegative = 0.0
    max_current_a: Positive
    max_voltage_v: Positive
    longest_capture_s: Positive | None = None
    """None: only the host's disk limits it."""
    longest_excitation_s: Positive | None = None
    """Longest settling plus capture of a drive that plays a table; None: it computes the excitation as it runs."""
    frequency_step_hz: Positive | None = None
    """Injections are at whole multiples of it; None: at any frequency that fits the rows."""
    injection_waveforms: frozenset[Waveform] = frozenset(("square", "sine"))
    """Waveforms that it can inject."""
    injects_at_zero_only: bool = False
    """Whether it can inject at zero current only."""
    longest_injection_s: Positive | None = None
    """Longest injection from its start to the capture's end, discarded time included; None: as other captures."""
    rotation_step_hz: Positive | None = None
    """Their direction rotates at whole multiples of it; None: at any frequency."""
    heeds_bandwidth: bool = True
    """Whether the drive tunes its current control to the excitation's `CurrentControl`; otherwise it uses its own."""
    excitations: frozenset[ExcitationKind]
    watchdog_s: Positive | None
    """The drive goes to its safe state when no heartbeat came for this long; None: it has no dead man."""
    watchdog_covers: frozenset[ExcitationKind] = frozenset()
    """The excitations during which the watchdog is active."""
    clock_is_simulated: bool = False
    """Whether its time is independent of the host's clock, as a simulation's."""
    has_brake: bool = False
    """Whether `Drive.set_brake` moves a real brake."""
    motor_name: str | None = None
    """The motor that the drive is configured for, where it knows."""
    interlocks: tuple[str, ...] = ()
    """Names of the interlock inputs that it reads (door, emergency stop)."""
    simulated: bool = False
    """Whether nothing real is energised: the motor is computed, or a recording is played back."""
    notes: tuple[str, ...] = ()
    """Notes for the user, a line each; `check` prints them."""


class DriveState(StrEnum):
    """State of the power stage."""

    DISARMED = "disarmed"
    ARMED = "armed"
    FAULTED = "faulted"


class Telemetry(Strict):
    """A reading between excitations."""

    state: DriveState
    time_s: float
    """The drive's clock since the start of the experiment."""
    i_d_a: float
    i_q_a: float
    v_dc_v: float
    temperature_c: float | None = None
    pwm_frequency_hz: Positive | None = None
    """PWM frequency in use as the drive states it; None: not stated."""
    faults: tuple[str, ...] = ()
    open_interlocks: tuple[str, ...] = ()
    """Those of `Capabilities.interlocks` that forbid power now."""


class NoOptions(Strict):
    """Options of a plugin that has none."""


class DriveSetup(BaseModel):
    """All that a drive gets from outside."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    motor: Motor
    """The nameplate: what a commissioning engineer would type into the drive."""
    options: Any
    """An instance of the plugin's own `Options`."""
    seed: int
    private_directory: Path | None = None
    """Directory for data hidden from analysis (a simulated plant's truth and state)."""


@runtime_checkable
class Drive(Protocol):
    """A drive at the other end of a link, or a simulated one.

    All methods but `heartbeat` are called from one thread. Link errors surface as `DriveFault`
    with cause ``link_lost``, never as the library's own. `ramp_down` and `disarm` may be called
    in any state and any number of times.
    """

    name: ClassVar[str]
    Options: ClassVar[type[BaseModel]]
    sealed_options: ClassVar[frozenset[str]]
    """Names of options that no analysis may see; a run keeps only their hash."""

    def __init__(self, setup: DriveSetup) -> None: ...

    def connect(self) -> Capabilities:
        """Open the link and identify the drive. Nothing is energised."""
        ...

    def arm(self, limits: Limits) -> None:
        """Hand over the limits and enable the power stage.

        Raises `DriveRefused` where a limit is above the drive's own, a fault is latched, or an interlock that the
        drive reads by itself is open (named).
        """
        ...

    def heartbeat(self) -> None:
        """Say that the host is alive. Called from a thread of its own; returns at once, never raises."""
        ...

    def execute(self, excitation: Excitation) -> Iterator[Capture]:
        """Run one excitation to its end and yield what was captured, block by block, gap-free.

        A block lasts half a second at most, so that a stop is never far away; a drive that is
        quiet for longer (settling) yields blocks without rows as a sign of life. After the last
        block the drive goes on holding the operating point (gates off after `GatesOff`). Leaving
        the iterator early leaves the drive energised: `ramp_down` follows.

        An interlock that opens meanwhile is the drive's to trip on, and to name; the engine asks for it between
        excitations only.

        Raises `DriveRefused` before moving anything, `DriveFault` when the drive trips.
        """
        ...

    def telemetry(self) -> Telemetry:
        """A reading, now."""
        ...

    def ramp_down(self) -> None:
        """Bring the current to zero under control, then hold zero current."""
        ...

    def disarm(self) -> None:
        """PWM off."""
        ...

    def clear_fault(self) -> None:
        """Forget a latched fault; the drive stays disarmed."""
        ...

    def set_brake(self, engaged: bool) -> None:
        """Engage or release the brake, where `Capabilities.has_brake`; else `DriveRefused`."""
        ...

    def close(self) -> None:
        """Let go of the link. Called once, disarmed."""
        ...


@runtime_checkable
class ResumableDrive(Protocol):
    """A drive with a memory of its own (a simulated plant: heat, iron, clock).

    `checkpoint` is called after each completed point with its id, `restore` before arming when a
    run is resumed after that point. Files go to the private directory; the last two are kept.
    """

    def checkpoint(self, point_id: str) -> None:
        """Save the state as it is after this point."""
        ...

    def restore(self, point_id: str, start_s: float) -> None:
        """Take the state up again, the experiment's clock standing at `start_s`."""
        ...


@runtime_checkable
class RelayedDrive(Protocol):
    """A drive whose heartbeats another process can write: its link is a descriptor that takes whole frames from two.

    A process of its own beats where this one is kept waiting; see `Drive.heartbeat` for what has to work without it.
    """

    def heartbeat_outlet(self) -> int | None:
        """The descriptor to write to; None where this link cannot be shared."""
        ...

    def heartbeat_at(self, time_s: float) -> bytes:
        """All that is to be written for the next beat, which is due at this instant of the host's monotonic clock.

        Called in order of time, from the heartbeat's thread; never raises.
        """
        ...
