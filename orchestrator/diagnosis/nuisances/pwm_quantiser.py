"""Rounding of voltage commands by a modulator's timer, which quantises each edge of a pulse.

With a leg's command x in steps of its mean voltage q = 2 t_q f_pwm V_dc, an edge is exact where x equals an integer
plus the edge's phase; both phases are equal where one comparison makes both edges. In between, the leg's mean is off by

    -q/2 (S(x - x_rise) + S(x - x_fall)),    S(x) = x - floor(x) - 1/2

(B. Widrow, I. Kollar, Quantization Noise, doi:10.1017/CBO9780511754661, chapter 1), exactly for each command. A
varying voltage is dithered by its course; in a dwell, a stretch of constant current, the rounding does not average out.
Zero sequences: D. G. Holmes, T. A. Lipo, Pulse Width Modulation for Power Converters, IEEE Press 2003,
doi:10.1109/9780470546284, section 6.3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numba import njit

from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData, block_means, mean_between
from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array
from protocols import DriveRecord, ModelNoise, ModulatorTimer, RealArray, SegmentStage, TimerPhases

MAX_STEP_OF_DWELL = 0.02
"""Step of a constant current between windows, relative to a ramp's."""
MAX_STEP_OF_DWELL_SIGMAS = 4.0
"""The same in standard deviations of its noise, where that is more."""
MIN_WINDOWS_OF_DWELL = 3
"""Minimum number of windows in a stretch of constant current."""

Numbers = TypeVar("Numbers", float, Array)


@dataclass(frozen=True)
class QuantiserEstimate:
    """A timer as estimated from readings.

    Attributes
    ----------
    timer : ModulatorTimer
    gain : float
        Gain in log likelihood by its rounding [nat].
    curvature : array, shape (1 + 2 frequencies, same)
        Hessian of minus the log likelihood by the step's relative change and each frequency's two phases.
    """

    timer: ModulatorTimer
    gain: float
    curvature: Array

    def moved(self, x: Array) -> ModulatorTimer:
        """The timer with step and phases changed by x."""
        timer, parts = self.timer, x[1:].reshape(-1, 2).tolist()
        phases = tuple(
            p.model_copy(update={"rise": (p.rise + rise) % 1.0, "fall": (p.fall + fall) % 1.0})
            for p, (rise, fall) in zip(timer.phases, parts, strict=True)
        )
        return timer.model_copy(update={"step_s": timer.step_s * (1.0 + float(x[0])), "phases": phases})

    def at(self, pwm_hz: Sequence[float]) -> QuantiserEstimate:
        """The estimate with unknown phases added at further PWM frequencies (zero curvature)."""
        known = {p.pwm_frequency_hz for p in self.timer.phases}
        unknown = [TimerPhases(pwm_frequency_hz=f, rise=0.0, fall=0.0) for f in pwm_hz if f not in known]
        timer = self.timer.model_copy(update={"phases": (*self.timer.phases, *unknown)})
        return replace(self, timer=timer, curvature=np.pad(self.curvature, (0, 2 * len(unknown))))

    def to(self, timer: ModulatorTimer) -> Array:
        """The argument of `moved` that gives another timer; zero where that has no phases."""
        known = {p.pwm_frequency_hz: p for p in timer.phases}
        parts = [(known.get(p.pwm_frequency_hz, p), p) for p in self.timer.phases]
        off = [d for a, b in parts for d in (a.rise - b.rise, a.fall - b.fall)]
        return np.array([timer.step_s / self.timer.step_s - 1.0, *((np.array(off) + 0.5) % 1.0 - 0.5)])


def with_quantiser(prepared: PreparedRecording, timer: ModulatorTimer | None) -> PreparedRecording:
    """The recording with voltages rounded by the timer, where its phases are known at the PWM frequency.

    Without a timer, with voltages as commanded.
    """
    bus_v = prepared.manifest.drive.dc_bus_voltage_v
    pieces = tuple(_impressed(p, timer, bus_v) for p in prepared.pieces)
    return replace(prepared, pieces=pieces, quantiser=timer)


def leg_step_of(step_s: float, pwm_frequency_hz: Numbers, bus_v: float) -> Numbers:
    """Change of a leg's mean voltage when both edges move by one timer step [V]."""
    return 2.0 * step_s * pwm_frequency_hz * bus_v


def nominal_leg_step_of(step_s: float, drive: DriveRecord) -> float:
    """`leg_step_of` at the drive's nominal PWM frequency [V]."""
    return leg_step_of(step_s, drive.pwm_frequency_hz or drive.sampling_frequency_hz, drive.dc_bus_voltage_v)


def leg_step_v(voltage_v: float) -> float:
    """A leg's step whose uniform rounding error has this rms per axis [V]: sqrt(2/3) sqrt(1/12) of the step."""
    return math.sqrt(18.0) * voltage_v


def dwells(piece: SegmentData) -> tuple[slice, ...]:
    """Slices of a segment's samples with constant current: all of a hold, the plateaus of a sweep."""
    if piece.stage is SegmentStage.RESISTANCE:
        return (slice(0, len(piece.signals.v_dc)),)
    if piece.stage is not SegmentStage.CLASSICAL:
        return ()
    step = max(round(piece.windows.step), 1)
    means = block_means(np.asarray(piece.signals.i_ab), step)
    moved = np.hypot(*np.diff(means, axis=0).T)
    noise_a = math.sqrt(2.0 * float(np.trace(piece.scatter.covariance)) / (step * piece.averaged))
    stands = moved < max(MAX_STEP_OF_DWELL * float(moved.max(initial=0.0)), MAX_STEP_OF_DWELL_SIGMAS * noise_a)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stands, [False]]).astype(np.int8)))
    runs = zip(edges[::2], edges[1::2] + 1, strict=True)
    return tuple(slice(int(a) * step, int(b) * step) for a, b in runs if b - a >= MIN_WINDOWS_OF_DWELL)


def scatter_units(piece: SegmentData) -> Array:
    """Standard deviations of a segment's common errors for unit offset and voltage scatter, shape (2, 2 + 2 dwells).

    The errors are offsets of two phases and two voltages of each dwell. A timer's step in volts, and with it the
    voltages' scatter, is proportional to the PWM frequency.
    """
    s, held = piece.signals, len(dwells(piece))
    drive_hz = (s.drive.pwm_frequency_hz if s.drive is not None else None) or s.pwm_frequency_hz
    return np.repeat(np.diag([1.0, s.pwm_frequency_hz / drive_hz]), [2, 2 * held], axis=1)


def scatter_sizes(units: Array, noise: ModelNoise) -> Array:
    """Standard deviations of a segment's common errors [A] and [V], from its `scatter_units`."""
    return np.asarray(np.array([noise.offset_scatter_a, noise.voltage_scatter_v]) @ units)


def _impressed(piece: SegmentData, timer: ModulatorTimer | None, bus_v: float) -> SegmentData:
    impressed = piece.command_ab
    if timer is not None:
        added = added_by(timer, piece, bus_v)
        if added is None:
            return piece
        impressed = impressed + added
    v_ab = mean_between(impressed, piece.averaged, piece.delay_samples)
    return replace(piece, signals=replace(piece.signals, v_ab=v_ab))


def added_by(timer: ModulatorTimer, piece: SegmentData, bus_v: float) -> Array | None:
    """Rounding of each command of a segment (readings, 2) [V]; None where the timer's phases are unknown there."""
    pwm_hz = piece.signals.pwm_frequency_hz
    phases = next((p for p in timer.phases if math.isclose(p.pwm_frequency_hz, pwm_hz)), None)
    if phases is None or not piece.signals.bridge_on:
        return None
    step_v = leg_step_of(timer.step_s, pwm_hz, bus_v)
    return rounded_by(piece.command_ab, step_v, phases.rise, phases.fall, centred=timer.centred)


def rounded_by(v_ab: RealArray, step_v: float, rise: float, fall: float, *, centred: bool) -> Array:
    """Rounding of each command (n, 2) [V].

    Parameters
    ----------
    v_ab : array, shape (n, 2)
    step_v : float
        `leg_step_of` its timer.
    rise, fall : float
        Phases of the edges, in steps.
    centred : bool
        See `ModulatorTimer`.
    """
    out = _rounded_by(np.ascontiguousarray(v_ab, dtype=np.float64), step_v, rise, fall, centred)
    return np.asarray(out, dtype=np.float64)


@njit(cache=True, nogil=True)
def legs_of(v_ab: Array, centred: bool) -> Array:
    """Commands of the three legs (n, 3)."""
    out = np.empty((v_ab.shape[0], 3))
    for k in range(v_ab.shape[0]):
        a, b, c = phases_of(v_ab[k, 0], v_ab[k, 1])
        zero = 0.5 * (max(a, b, c) + min(a, b, c)) if centred else 0.0
        out[k, 0], out[k, 1], out[k, 2] = a - zero, b - zero, c - zero
    return out


@njit(cache=True, nogil=True)
def legs_rounded_by(v_ab: Array, step_v: float, rise: float, fall: float, centred: bool) -> Array:
    """Rounding of the mean of each leg (n, 3) [V]; parameters as in `rounded_by`."""
    out = legs_of(v_ab, centred)
    for k in range(v_ab.shape[0]):
        for leg in range(3):
            out[k, leg] = step_v * _off(out[k, leg] / step_v, rise, fall)
    return out


@njit(cache=True, nogil=True)
def _rounded_by(v_ab: Array, step_v: float, rise: float, fall: float, centred: bool) -> Array:
    out = np.empty_like(v_ab)
    legs = legs_rounded_by(v_ab, step_v, rise, fall, centred)
    for k in range(v_ab.shape[0]):
        out[k, 0], out[k, 1] = vector_of(legs[k, 0], legs[k, 1], legs[k, 2])
    return out


@njit(cache=True, nogil=True, inline="always")
def _off(x: float, rise: float, fall: float) -> float:
    """A leg's mean minus its command, in steps."""
    up, down = x - rise, x - fall
    return -0.5 * (up - math.floor(up) + down - math.floor(down) - 1.0)
