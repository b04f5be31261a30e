"""Programs: the sequence of set-point pieces that realises an excitation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from plugins.drives.simulated._derive import Nameplate
from plugins.drives.simulated._run import CONTROL, OFF, OPEN, STEPS, ControlParameters, Piece
from protocols import CurrentControl, Excitation, GatesOff, Hold, Injection, Spin, Trapezoid, VoltageSteps

DRAIN_S = 0.02
"""Time in which a residual current decays to zero through the diodes."""
SPIN_UP_S = 0.4
"""Time in which the driving machine accelerates the rotor, and brings it back to rest."""


@dataclass(frozen=True)
class Stretch:
    """A piece and how its rows are used."""

    piece: Piece
    captured: bool = False
    averaged: bool = False
    """Its mean voltage becomes the base voltage of the following stretches."""
    on_base: bool = False
    """Its voltages are relative to the base voltage."""
    driven: bool = False
    """Another machine drives the shaft from its start on."""
    parked: bool = False
    """At its end the rotor is at rest at its original angle."""


@dataclass(frozen=True)
class Program:
    """Stretches in order of time."""

    stretches: tuple[Stretch, ...]

    @property
    def samples(self) -> int:
        return sum(s.piece.samples for s in self.stretches)

    @property
    def captured(self) -> int:
        return sum(s.piece.samples for s in self.stretches if s.captured)


@dataclass(frozen=True)
class Planner:
    """Composes programs for a sampling frequency, a nameplate and a voltage limit."""

    sampling_frequency_hz: float
    nameplate: Nameplate
    max_v: float

    def samples(self, seconds: float) -> int:
        """Duration in samples, rounded."""
        return round(seconds * self.sampling_frequency_hz)

    def program(self, excitation: Excitation, start: tuple[float, float]) -> Program:
        """Program of an excitation, from the present set-point `start` (believed dq frame)."""
        match excitation:
            case GatesOff():
                down = self.to_zero(excitation.control, start).stretches
                drain = Stretch(Piece(OFF, self.samples(DRAIN_S)))
                rows = Stretch(Piece(OFF, self.samples(excitation.captured_s)), captured=True)
                return Program((*down, drain, rows))
            case Hold():
                target = excitation.start_dq_a
                settle = self._settle(excitation.control, start, target, self.samples(excitation.settle_s))
                return Program((*settle, Stretch(self._still(target, excitation.duration_s), captured=True)))
            case Trapezoid():
                return Program(tuple(self._trapezoid(excitation, start)))
            case Injection():
                return Program(tuple(self._injection(excitation, start)))
            case VoltageSteps():
                return Program(tuple(self._steps(excitation, start)))
            case Spin():
                return Program(tuple(self._spin(excitation, start)))

    def to_zero(self, control: CurrentControl, start: tuple[float, float]) -> Program:
        """Ramp the current to zero under control, then hold it for four periods of the control's bandwidth."""
        ramp = self._ramp(start, (0.0, 0.0), self._ramp_samples(control, start, (0.0, 0.0)))
        return Program((Stretch(ramp), Stretch(self._still((0.0, 0.0), 4.0 / control.bandwidth_hz))))

    def wait(self, start: tuple[float, float], seconds: float) -> Program:
        """Hold the set-point."""
        return Program((Stretch(self._still(start, seconds)),))

    def decelerate(self, mode: int, speed_rad_s: float) -> Stretch:
        """Decelerate the rotor from this speed to its original angle, without current."""
        count = max(1, self.samples(SPIN_UP_S))
        return Stretch(Piece(mode, count, speed_step=-speed_rad_s / count), parked=True)

    def _still(self, at: tuple[float, float], seconds: float) -> Piece:
        return Piece(CONTROL, self.samples(seconds), *at)

    def _ramp(self, start: tuple[float, float], end: tuple[float, float], samples: int) -> Piece:
        n = max(1, samples)
        return Piece(CONTROL, samples, *start, (end[0] - start[0]) / n, (end[1] - start[1]) / n)

    def _ramp_samples(self, control: CurrentControl, start: tuple[float, float], end: tuple[float, float]) -> int:
        """Two time constants of the closed loop, or longer where the voltage limit requires it."""
        change = math.hypot(end[0] - start[0], end[1] - start[1])
        reach = max(self.nameplate.l_d_h, self.nameplate.l_q_h) * change / (0.3 * self.max_v)
        return self.samples(max(1.0 / (math.pi * control.bandwidth_hz), reach)) if change > 0 else 0

    def _settle(
        self, control: CurrentControl, start: tuple[float, float], target: tuple[float, float], samples: int
    ) -> Iterator[Stretch]:
        ramp = min(self._ramp_samples(control, start, target), samples // 2)
        yield Stretch(self._ramp(start, target, ramp))
        yield Stretch(Piece(CONTROL, samples - ramp, *target))

    def _trapezoid(self, excitation: Trapezoid, start: tuple[float, float]) -> Iterator[Stretch]:
        axis, fs = excitation.swept_axis, self.sampling_frequency_hz
        amplitude, origin = excitation.amplitude_a, excitation.start_dq_a
        direction = {"d": (1.0, 0.0), "q": (0.0, 1.0), "dq": (math.sqrt(0.5), math.sqrt(0.5))}[axis]
        yield from self._settle(excitation.control, start, origin, self.samples(excitation.settle_s))
        corners = ((0.0, 0.0), (0.125, 1.0), (0.375, 1.0), (0.625, -1.0), (0.875, -1.0), (1.0, 0.0))
        for period in range(excitation.periods):
            for (from_t, from_i), (to_t, to_i) in itertools.pairwise(corners):
                begin = (period + from_t) * excitation.period_s * fs
                end = (period + to_t) * excitation.period_s * fs
                first, last = round(begin), round(end)
                slope = (to_i - from_i) * amplitude / (end - begin)
                level = from_i * amplitude + slope * (first - begin)
                piece = Piece(
                    CONTROL,
                    last - first,
                    origin[0] + direction[0] * level,
                    origin[1] + direction[1] * level,
                    direction[0] * slope,
                    direction[1] * slope,
                )
                yield Stretch(piece, captured=True)

    def _injection(self, excitation: Injection, start: tuple[float, float]) -> Iterator[Stretch]:
        fs, target = self.sampling_frequency_hz, excitation.start_dq_a
        settle = max(2, self.samples(excitation.settle_s))
        yield from self._settle(excitation.control, start, target, settle - settle // 2)
        yield Stretch(Piece(CONTROL, settle // 2, *target), averaged=True)
        yield Stretch(Piece(OPEN, self.samples(0.25 / excitation.control.bandwidth_hz)), on_base=True)
        discarded = self.samples(excitation.discard_s)
        wave = Piece(
            OPEN,
            discarded,
            amplitude_v=excitation.amplitude_v,
            cycles=excitation.frequency_hz / fs,
            revolutions=excitation.rotation_hz / fs,
            square=excitation.waveform == "square",
        )
        yield Stretch(wave, on_base=True)
        rows = wave._replace(samples=self.samples(excitation.captured_s), first=discarded)
        yield Stretch(rows, captured=True, on_base=True)

    def _steps(self, excitation: VoltageSteps, start: tuple[float, float]) -> Iterator[Stretch]:
        yield from self._settle(excitation.control, start, (0.0, 0.0), self.samples(excitation.settle_s))
        steps = Piece(
            STEPS,
            self.samples(excitation.captured_s),
            excitation.voltage_d_v,
            excitation.voltage_q_v,
            turn_d=excitation.turn_d_a or math.inf,
            turn_q=excitation.turn_q_a or math.inf,
        )
        yield Stretch(steps, captured=True)
        yield from self.to_zero(excitation.control, (0.0, 0.0)).stretches

    def _spin(self, excitation: Spin, start: tuple[float, float]) -> Iterator[Stretch]:
        speed, up, zero = excitation.speed_rad_s, max(1, self.samples(SPIN_UP_S)), (0.0, 0.0)
        mode = OFF if excitation.bridge == "off" else CONTROL
        # The driving machine holds the shaft from the first sample to the last.
        yield from (replace(stretch, driven=True) for stretch in self.to_zero(excitation.control, start).stretches)
        if mode == OFF:
            yield Stretch(Piece(OFF, self.samples(DRAIN_S)))
        yield Stretch(Piece(mode, up, speed_step=speed / up))
        settle, target = self.samples(excitation.settle_s), excitation.start_dq_a
        if mode == OFF:
            yield Stretch(Piece(OFF, settle))
        else:
            yield from self._settle(excitation.control, zero, target, settle)
        yield Stretch(Piece(mode, self.samples(excitation.captured_s), *target), captured=True)
        if mode == CONTROL:
            yield from self.to_zero(excitation.control, target).stretches
        yield self.decelerate(mode, speed)


def tune(
    nameplate: Nameplate,
    control: CurrentControl,
    angle_rad: float,
    sampling_frequency_hz: float,
    *,
    max_v: float,
    trip_a: float,
    overload_s: float | None,
    encoder_ratio: float = 1.0,
    delay_samples: float = 0.0,
) -> ControlParameters:
    """PI gains from the nameplate.

    Pole placement, s^2 + 2 zeta w s + w^2, where the motor is slower than that; else the motor's
    own pole is cancelled (internal model control), which keeps the proportional gain positive.
    """
    w, r, h = 2 * math.pi * control.bandwidth_hz, nameplate.resistance_ohm, 1.0 / sampling_frequency_hz

    def gains(inductance: float) -> tuple[float, float]:
        placed = 2 * control.damping * w * inductance - r
        if placed >= 0.5 * w * inductance:
            return placed, w * w * inductance * h
        return w * inductance, w * r * h

    (p_d, i_d), (p_q, i_q) = gains(nameplate.l_d_h), gains(nameplate.l_q_h)
    return ControlParameters(
        angle_rad=angle_rad,
        encoder_ratio=encoder_ratio,
        lead_samples=0.5 + delay_samples,
        cos=math.cos(angle_rad),
        sin=math.sin(angle_rad),
        proportional_d=p_d,
        proportional_q=p_q,
        integral_d=i_d,
        integral_q=i_q,
        resistance_ohm=r,
        inductance_d=nameplate.l_d_h / h,
        inductance_q=nameplate.l_q_h / h,
        flux=nameplate.pm_flux_wb / h,
        max_v=max_v,
        trip_a=trip_a,
        per_rated2=0.0 if overload_s is None else 1.0 / nameplate.rated_a**2,
        sample_s=h,
        overload_s=math.inf if overload_s is None else overload_s,
        telemetry_step=min(1.0, h / 2e-3),
    )
