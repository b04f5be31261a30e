"""Converts an excitation to the calibration parameters of the ECU's routine."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from plugins.drives.xcp._ecu import Mode
from protocols import CurrentControl, Excitation, GatesOff, Injection, InputError, Motor, Trapezoid

DRAIN_S = 0.02
"""Time in which a residual current decays to zero through the diodes."""
RAMP_VOLTAGE_RATIO = 0.3
"""Voltage of a ramp over the voltage limit."""
AXES = {"d": (1.0, 0.0), "q": (0.0, 1.0), "dq": (math.sqrt(0.5), math.sqrt(0.5))}
COUNTS_PER_TURN = 2**32


@dataclass(frozen=True)
class Planner:
    """Composes programs, as fields of `Layout.program`.

    Raises `InputError` where the nameplate lacks what current control is tuned by.
    """

    motor: Motor
    sampling_frequency_hz: float
    limit_current_a: float
    limit_voltage_v: float

    def program(self, excitation: Excitation) -> dict[str, Any]:
        """Program of an excitation, from the present current."""
        e, fs = excitation, self.sampling_frequency_hz
        rows, settle_ticks = e.rows(fs), round(e.settling_s * fs)
        if isinstance(e, GatesOff):
            return self._constant(e, e.control, Mode.GATES_OFF) | {
                "settle_ticks": round(DRAIN_S * fs),
                "capture_ticks": rows,
            }
        program = self._constant(e, e.control, Mode.CONTROL) | {"start": e.start_dq_a, "capture_ticks": rows}
        before = settle_ticks
        if isinstance(e, Injection):
            before = round(e.settle_s * fs)
            program |= {"mode": Mode.INJECTION, "freeze_ticks": before, "amplitude_v": e.amplitude_v}
            program |= {
                "wave_step": _step(e.frequency_hz / fs),
                "turn_step": round(COUNTS_PER_TURN * e.rotation_hz / fs),
            }
            program |= {"sine": int(e.waveform == "sine")}
        elif isinstance(e, Trapezoid):
            program |= {"swept": tuple(e.amplitude_a * x for x in AXES[e.swept_axis])}
            program |= {"wave_step": _step(1.0 / (e.period_s * fs))}
        return program | {"settle_ticks": settle_ticks, "ramp_ticks": min(self._ramp_ticks(e.control), before // 2)}

    def to_zero(self, rotor_angle_rad: float, control: CurrentControl | None = None) -> dict[str, Any]:
        """Program that ramps the current to zero under control and holds it there."""
        control = control or CurrentControl()
        ticks = self._ramp_ticks(control)
        program = self._constant(Resting(rotor_angle_rad), control, Mode.CONTROL)
        return program | {"ramp_ticks": ticks, "settle_ticks": ticks}

    def ramp_s(self, control: CurrentControl | None = None) -> float:
        """Duration of a ramp to zero current [s]."""
        control = control or CurrentControl()
        return self._ramp_ticks(control) / self.sampling_frequency_hz + 4.0 / control.bandwidth_hz

    def _constant(self, e: Excitation | Resting, control: CurrentControl, mode: Mode) -> dict[str, Any]:
        r, w = self.resistance_ohm, 2.0 * math.pi * control.bandwidth_hz
        tuned = [_tuned(w, control.damping, r, l_h) for l_h in self.inductance_h]
        return {
            "limit_current_a": self.limit_current_a,
            "limit_voltage_v": self.limit_voltage_v,
            "mode": mode,
            "freeze_ticks": 2,
            "direction": (math.cos(e.rotor_angle_rad), math.sin(e.rotor_angle_rad)),
            "feed_forward": r,
            "proportional": tuple(proportional for proportional, _ in tuned),
            "integral": tuple(integral / self.sampling_frequency_hz for _, integral in tuned),
        }

    def _ramp_ticks(self, control: CurrentControl) -> int:
        """Two time constants of the closed loop, or longer where the voltage limit requires it."""
        reach_s = max(self.inductance_h) * 2.0 * self.limit_current_a / (RAMP_VOLTAGE_RATIO * self.limit_voltage_v)
        return round(max(1.0 / (math.pi * control.bandwidth_hz), reach_s) * self.sampling_frequency_hz)

    @property
    def resistance_ohm(self) -> float:
        return self._nameplate_value("stator_resistance_ohm")

    @property
    def inductance_h(self) -> tuple[float, float]:
        return self._nameplate_value("d_inductance_h"), self._nameplate_value("q_inductance_h")

    def _nameplate_value(self, name: str) -> float:
        value: float | None = getattr(self.motor, name)
        if value is None:
            raise InputError("motor", name, "is needed: current control is tuned by it")
        return value


@dataclass(frozen=True)
class Resting:
    """The part of an excitation that a ramp to zero needs."""

    rotor_angle_rad: float


def _tuned(w: float, damping: float, r: float, l_h: float) -> tuple[float, float]:
    """PI gains [V/A], [V/As]: poles at s^2 + 2 zeta w s + w^2 where the motor is slower, else pole cancellation."""
    placed = 2.0 * damping * w * l_h - r
    return (placed, w * w * l_h) if placed >= 0.5 * w * l_h else (w * l_h, w * r)


def _step(periods: float) -> int:
    """Phase increment in 2^-32 periods, rounded up so that no period begins a row late."""
    return math.ceil(COUNTS_PER_TURN * periods - 1e-6)
