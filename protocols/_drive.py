"""The drive: what it says it can do, what it is asked to do, and what it hands back.

The drive executes whole excitations: the control loop and the injection run on its side, at its
own rate. The engine never sits in a control loop.

A drive plugin is a class with the `Drive` protocol whose constructor takes a `DriveSetup`; it is
registered as an entry point of the group ``fluxbench.drives``.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol, runtime_checkable

from pydantic import BaseModel, ConfigDict, Field

from protocols._base import Strict
from protocols._motor import Motor, Positive
from protocols._recording import Capture

NonNegative = Annotated[float, Field(ge=0)]


class CurrentControl(Strict):
    """PI current control on both axes, tuned by the drive from the nameplate.

    Second-order closed loop; the defaults are the paper's (section "Experimental results").
    """

    bandwidth_hz: Positive = 25.0
    damping: Positive = 0.7071067811865476


class _Excitation(Strict):
    """What all excitations share."""

    rotor_angle_rad: float = 0.0
    """Electrical angle of the believed d axis in the stator frame."""
    pwm_frequency_hz: Positive | None = None
    """None: the drive's own."""
    control: CurrentControl = CurrentControl()

    @property
    @abstractmethod
    def captured_s(self) -> float:
        """How much of it is captured [s]."""

    @property
    def settling_s(self) -> float:
        """What passes before anything is captured [s]."""
        return 0.0

    @property
    def start_dq_a(self) -> tuple[float, float]:
        """Where the current control goes first (i_d, i_q) [A]; a trapezoid ends there as well."""
        return (0.0, 0.0)

    @property
    def longest_current_a(self) -> float:
        """Longest current vector that is asked for [A peak], the injection's ripple left out."""
        return math.hypot(*self.start_dq_a)

    def rows(self, sampling_frequency_hz: float) -> int:
        """Rows that it captures, as host and drive count them."""
        return round(self.captured_s * sampling_frequency_hz)


class GatesOff(_Excitation):
    """All gates off: the sensors alone. The drive brings the current to zero first."""

    kind: Literal["gates_off"] = "gates_off"
    duration_s: Positive

    @property
    def captured_s(self) -> float:
        return self.duration_s


class Hold(_Excitation):
    """A constant current vector under current control; only the last `duration_s` is captured.

    Alignment is a hold too: the rotor is free, and follows the vector at `rotor_angle_rad`.
    """

    kind: Literal["hold"] = "hold"
    current_d_a: float
    current_q_a: float
    settle_s: NonNegative
    duration_s: Positive

    @property
    def captured_s(self) -> float:
        return self.duration_s

    @property
    def settling_s(self) -> float:
        return self.settle_s

    @property
    def start_dq_a(self) -> tuple[float, float]:
        return (self.current_d_a, self.current_q_a)


class Trapezoid(_Excitation):
    """Periodic trapezoids of one current, or of both together, under current control.

    One period from zero: rise to +A in 1/8, hold 1/4, fall to -A in 1/4, hold 1/4, back to zero
    in 1/8 (the paper's 0.25, 0.5, 0.5, 0.5 and 0.25 s at 2 s). With `swept_axis` "dq" both axes
    follow it with amplitude A / sqrt(2), and `held_a` is not used.
    """

    kind: Literal["trapezoid"] = "trapezoid"
    swept_axis: Literal["d", "q", "dq"]
    held_a: float = 0.0
    amplitude_a: Positive
    period_s: Positive
    periods: Annotated[int, Field(ge=1)]
    settle_s: NonNegative
    """Time at the start of the trajectory (zero on the swept axis), not captured."""

    @property
    def captured_s(self) -> float:
        return self.periods * self.period_s

    @property
    def settling_s(self) -> float:
        return self.settle_s

    @property
    def start_dq_a(self) -> tuple[float, float]:
        return {"d": (0.0, self.held_a), "q": (self.held_a, 0.0), "dq": (0.0, 0.0)}[self.swept_axis]

    @property
    def longest_current_a(self) -> float:
        return math.hypot(*self.start_dq_a, self.amplitude_a)


class Injection(_Excitation):
    """A rotating periodic voltage on an open-loop base voltage.

    The drive settles at the target under current control, freezes the mean of its voltage over
    the second half of `settle_s`, and adds ``amplitude_v * (cos, sin)(2 pi rotation_hz t) *
    f(frequency_hz t)`` in the believed dq frame, f being a unit wave that starts a period at
    t = 0. Capturing starts `discard_s` after the injection does.
    """

    kind: Literal["injection"] = "injection"
    target_d_a: float
    target_q_a: float
    settle_s: Positive
    discard_s: NonNegative = 0.0
    duration_s: Positive
    amplitude_v: Positive
    frequency_hz: Positive
    rotation_hz: NonNegative
    waveform: Literal["square", "sine"] = "square"

    @property
    def captured_s(self) -> float:
        return self.duration_s

    @property
    def settling_s(self) -> float:
        return self.settle_s + self.discard_s

    @property
    def start_dq_a(self) -> tuple[float, float]:
        return (self.target_d_a, self.target_q_a)


Excitation = Annotated[GatesOff | Hold | Trapezoid | Injection, Field(discriminator="kind")]
ExcitationKind = Literal["gates_off", "hold", "trapezoid", "injection"]


class Limits(Strict):
    """What the experiment may do to motor and drive; the drive holds them as well."""

    current_a: Positive
    """Longest current vector [A peak]."""
    voltage_v: Positive
    """Longest voltage vector [V peak]."""
    energy_j: Positive | None = None
    """Most copper loss over the whole run [J]."""
    duration_s: Positive | None = None
    """Longest run [s]."""


class Capabilities(Strict):
    """What a drive says of itself when connected; plans are checked against it."""

    name: str
    sampling_frequency_hz: Positive
    pwm_frequency_hz: Positive
    pwm_frequencies_hz: tuple[Positive, ...]
    """All that can be asked for; holds `pwm_frequency_hz`."""
    dc_bus_voltage_v: Positive
    voltage_delay_samples: NonNegative = 0.0
    max_current_a: Positive
    max_voltage_v: Positive
    longest_capture_s: Positive | None = None
    """None: only the host's disk limits it."""
    longest_excitation_s: Positive | None = None
    """Settling and capture together, where a table is played; None: the drive makes it up as it goes."""
    frequency_step_hz: Positive | None = None
    """Injections are at whole multiples of it; None: at any frequency that fits the rows."""
    rotation_step_hz: Positive | None = None
    """Their direction rotates at whole multiples of it; None: at any frequency."""
    heeds_bandwidth: bool = True
    """Whether current control is tuned to the `CurrentControl` that is asked for; else it is the drive's own."""
    excitations: frozenset[ExcitationKind]
    watchdog_s: Positive | None
    """The drive goes to its safe state when no heartbeat came for this long; None: it has no dead man."""
    watchdog_covers: frozenset[ExcitationKind] = frozenset()
    """The excitations during which the watchdog is at work."""
    clock_is_simulated: bool = False
    """True where its time is its own, as a simulation's: then nobody holds it against the host's clock."""
    has_brake: bool = False
    """Whether `Drive.set_brake` moves a real brake."""
    motor_name: str | None = None
    """The motor that the drive is configured for, where it knows."""
    interlocks: tuple[str, ...] = ()
    """Names of the interlock inputs that it reads (door, emergency stop)."""
    simulated: bool = False
    """Whether nothing real is energised: the motor is computed, or a recording is played back."""
    notes: tuple[str, ...] = ()
    """What a user should know of it beforehand, a line each; `check` prints them."""


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
    """The one at work, by the drive's own word; None: it does not tell."""
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
    """Where the drive may keep what analysis must not see (a simulated plant's truth and state)."""


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

        Raises `DriveRefused` where a limit is above the drive's own or a fault is latched.
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

        An interlock that opens meanwhile is the drive's to trip on; the engine asks for it between excitations only.

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
