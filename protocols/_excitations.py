"""The excitations: programs that a drive runs as a whole, with the control loop and the injection on its side."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, Literal

from pydantic import Field, model_validator

from protocols._base import Strict
from protocols._motor import Positive

NonNegative = Annotated[float, Field(ge=0)]
Waveform = Literal["square", "sine"]


class CurrentControl(Strict):
    """PI current control on both axes, tuned by the drive from the nameplate.

    Second-order closed loop; the defaults are the paper's (section "Experimental results").
    """

    bandwidth_hz: Positive = 25.0
    damping: Positive = 0.7071067811865476


class _Excitation(Strict):
    """Base of all excitations."""

    rotor_angle_rad: float = 0.0
    """Electrical angle of the believed d axis in the stator frame."""
    pwm_frequency_hz: Positive | None = None
    """None: the drive's own."""
    control: CurrentControl = CurrentControl()

    @property
    @abstractmethod
    def captured_s(self) -> float:
        """Captured duration [s]."""

    @property
    def settling_s(self) -> float:
        """Duration before the capture begins [s]."""
        return 0.0

    @property
    def start_dq_a(self) -> tuple[float, float]:
        """First set-point of the current control (i_d, i_q) [A]; a trapezoid ends there as well."""
        return (0.0, 0.0)

    @property
    def longest_current_a(self) -> float:
        """Longest current vector of the set-points [A peak], without the injection's ripple."""
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
    waveform: Waveform = "square"

    @property
    def captured_s(self) -> float:
        return self.duration_s

    @property
    def settling_s(self) -> float:
        return self.settle_s + self.discard_s

    @property
    def start_dq_a(self) -> tuple[float, float]:
        return (self.target_d_a, self.target_q_a)


class VoltageSteps(_Excitation):
    """+-U on one axis or on both, turned round where the current has passed a limit: nothing rests, nothing controls.

    After `settle_s` at zero current, under control, each axis' voltage is +U until the current along it is read at or
    above its limit, then -U until it is at or below the negative one, and so on; each axis turns by itself. An axis
    whose voltage is zero is left to itself. Afterwards the current is brought to zero under control.
    """

    kind: Literal["steps"] = "steps"
    voltage_d_v: NonNegative = 0.0
    voltage_q_v: NonNegative = 0.0
    turn_d_a: NonNegative = 0.0
    turn_q_a: NonNegative = 0.0
    settle_s: NonNegative
    duration_s: Positive

    @model_validator(mode="after")
    def _turns_somewhere(self) -> VoltageSteps:
        for axis, volts, amps in (("d", self.voltage_d_v, self.turn_d_a), ("q", self.voltage_q_v, self.turn_q_a)):
            if (volts > 0.0) != (amps > 0.0):
                raise ValueError(f"voltage_{axis}_v and turn_{axis}_a go together")
        if self.voltage_v == 0.0:
            raise ValueError("one axis needs a voltage")
        return self

    @property
    def captured_s(self) -> float:
        return self.duration_s

    @property
    def settling_s(self) -> float:
        return self.settle_s

    @property
    def voltage_v(self) -> float:
        """Length of the voltage vector."""
        return math.hypot(self.voltage_d_v, self.voltage_q_v)

    @property
    def longest_current_a(self) -> float:
        return math.hypot(self.turn_d_a, self.turn_q_a)


class Spin(_Excitation):
    """The rotor turns at a steady speed, by another machine or the drive itself; its angle is captured as `theta_rad`.

    With the bridge off no current flows, and the voltage that is captured is the terminals' own, measured at the rows'
    instants. Else the current is held in the frame that turns with the rotor. The angle goes on from
    `rotor_angle_rad`, where the rotor stands when it begins; at its end the rotor stands there again.
    """

    kind: Literal["spin"] = "spin"
    speed_rad_s: float
    """Electrical; negative: backwards."""
    bridge: Literal["off", "on"] = "on"
    current_d_a: float = 0.0
    current_q_a: float = 0.0
    settle_s: NonNegative
    duration_s: Positive

    @model_validator(mode="after")
    def _turns(self) -> Spin:
        if self.speed_rad_s == 0.0:
            raise ValueError("speed_rad_s: 0 is no speed")
        if self.bridge == "off" and (self.current_d_a, self.current_q_a) != (0.0, 0.0):
            raise ValueError("no current flows with the bridge off")
        return self

    @property
    def captured_s(self) -> float:
        return self.duration_s

    @property
    def settling_s(self) -> float:
        return self.settle_s

    @property
    def start_dq_a(self) -> tuple[float, float]:
        return (self.current_d_a, self.current_q_a)


Excitation = Annotated[GatesOff | Hold | Trapezoid | Injection | VoltageSteps | Spin, Field(discriminator="kind")]
ExcitationKind = Literal["gates_off", "hold", "trapezoid", "injection", "steps", "spin"]
