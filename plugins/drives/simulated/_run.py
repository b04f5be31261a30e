"""The step loop, compiled: sensors, then the drive's control, then the plant, sample by sample.

A row is that of a recording: the current at t_k as the sensors read it, before the
voltage of the row acts; the voltage, held until t_k+1. The control uses only the readings
and the nameplate. The loop runs one `Piece` at a time; `_program` composes them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from plugins.drives.simulated._energy import Array, Energy
from plugins.drives.simulated._numba import inlined, kernel
from plugins.drives.simulated._plant import advance
from plugins.drives.simulated._sensing import BenchParameters, Rows, SensorParameters, read, sense
from plugins.drives.simulated._state import (
    ANCHOR,
    BUS,
    COMMAND_D,
    COMMAND_Q,
    COS,
    FILTERED_D,
    FILTERED_Q,
    INTEGRAL_D,
    INTEGRAL_Q,
    MOVING,
    MOVING_DRIVEN,
    OMEGA,
    OVERLOAD,
    PSI_D,
    PSI_Q,
    READING_A,
    READING_B,
    SIGN_D,
    SIGN_Q,
    SIN,
    SQRT3,
    THETA,
    PlantParameters,
)
from plugins.drives.simulated._switching import advance_switched

CONTROL, OPEN, OFF, GIVEN, STEPS = range(5)
"""Current control; open-loop voltage; bridge off; voltages given in `v_out`; steps reversed at current limits."""


class ControlParameters(NamedTuple):
    """PI control with feed-forward in the believed frame, tuned from the nameplate."""

    angle_rad: float
    """Believed angle of the d axis at standstill."""
    encoder_ratio: float
    """Angle sensor reading over true electrical angle."""
    lead_samples: float
    """Declared time from a row to the middle of its voltage's interval."""
    cos: float
    sin: float
    proportional_d: float
    proportional_q: float
    integral_d: float
    """Per sample."""
    integral_q: float
    resistance_ohm: float
    inductance_d: float
    """L_d over the sample time [V per A/sample]."""
    inductance_q: float
    flux: float
    """Magnet flux over the sample time [V]."""
    max_v: float
    trip_a: float
    per_rated2: float
    """1 / rated current squared (0: no overload protection)."""
    sample_s: float
    overload_s: float
    telemetry_step: float
    """Weight of a new reading in telemetry's low-pass filter."""


class Piece(NamedTuple):
    """A stretch of samples with one linear set-point: amperes in CONTROL, volts in OPEN, believed dq frame."""

    mode: int
    samples: int
    d: float = 0.0
    q: float = 0.0
    slope_d: float = 0.0
    """Per sample."""
    slope_q: float = 0.0
    amplitude_v: float = 0.0
    cycles: float = 0.0
    """Periods of the injected wave per sample."""
    revolutions: float = 0.0
    """Revolutions of the injection's direction per sample."""
    square: bool = True
    first: int = 0
    """Samples since the injection started."""
    turn_d: float = 0.0
    """Current at which the step voltage is reversed [A]."""
    turn_q: float = 0.0
    speed_step: float = 0.0
    """Speed increment per sample of a rotor driven by another machine [rad/s]."""


@inlined
def _control(
    c: ControlParameters, w: Piece, k: int, x: Array, i_d: float, i_q: float, turned: float
) -> tuple[float, float]:
    """v_dq of the PI control with back-calculation, back-EMF fed forward in a frame that turns by `turned` a sample."""
    target_d, target_q = w.d + w.slope_d * k, w.q + w.slope_q * k
    error_d, error_q = target_d - i_d, target_q - i_q
    forward_d = c.resistance_ohm * target_d + c.inductance_d * w.slope_d
    forward_q = c.resistance_ohm * target_q + c.inductance_q * w.slope_q
    forward_d -= turned * c.inductance_q * i_q
    forward_q += turned * (c.inductance_d * i_d + c.flux)
    v_d = forward_d + c.proportional_d * error_d + x[INTEGRAL_D]
    v_q = forward_q + c.proportional_q * error_q + x[INTEGRAL_Q]
    length = math.sqrt(v_d * v_d + v_q * v_q)
    scale = min(1.0, c.max_v / length) if length > 0.0 else 1.0
    x[INTEGRAL_D] += c.integral_d * (error_d + (scale - 1.0) * v_d / c.proportional_d)
    x[INTEGRAL_Q] += c.integral_q * (error_q + (scale - 1.0) * v_q / c.proportional_q)
    x[COMMAND_D], x[COMMAND_Q] = target_d + w.slope_d, target_q + w.slope_q
    return scale * v_d, scale * v_q


@inlined
def _inject(c: ControlParameters, w: Piece, k: int, cos: float, sin: float) -> tuple[float, float]:
    """v_dq open loop: base voltage plus the injected wave along (cos, sin)."""
    v_d, v_q = w.d + w.slope_d * k, w.q + w.slope_q * k
    if w.amplitude_v != 0.0:
        phase = (w.first + k) * w.cycles
        phase -= math.floor(phase + 1e-9)
        if w.square:
            wave = w.amplitude_v if phase < 0.5 - 1e-9 else -w.amplitude_v
        else:
            wave = w.amplitude_v * math.sin(2 * math.pi * phase)
        v_d += wave * cos
        v_q += wave * sin
    length = math.sqrt(v_d * v_d + v_q * v_q)
    scale = min(1.0, c.max_v / length) if length > 0.0 else 1.0
    return scale * v_d, scale * v_q


@inlined
def _step(c: ControlParameters, w: Piece, k: int, x: Array, i_d: float, i_q: float) -> tuple[float, float]:
    """v_dq of voltage steps: the voltage of an axis is reversed when its current has passed the limit."""
    if k == 0:
        x[SIGN_D] = x[SIGN_Q] = 1.0
    if x[SIGN_D] * i_d >= w.turn_d:
        x[SIGN_D] = -x[SIGN_D]
    if x[SIGN_Q] * i_q >= w.turn_q:
        x[SIGN_Q] = -x[SIGN_Q]
    scale = min(1.0, c.max_v / math.sqrt(w.d * w.d + w.q * w.q))
    return scale * x[SIGN_D] * w.d, scale * x[SIGN_Q] * w.q


@kernel
def run(
    p: PlantParameters,
    e: Energy,
    spline: Array,
    s: SensorParameters,
    c: ControlParameters,
    w: Piece,
    done: int,
    count: int,
    x: Array,
    sums: Array,
    noise: Rows,
    i_out: Rows,
    v_out: Rows,
    bus_out: Rows,
    phases_out: Rows,
    bench: BenchParameters | None,
) -> int:
    """Run samples `done` .. `done + count` of a piece; returns the number of samples run, fewer where the drive trips.

    `bench` holds the switched inverter and its sensors; None selects the averaged inverter (compiled separately).
    `sums` accumulates v_d and v_q in the believed frame; the frozen base voltage is their mean.
    """
    off, driven = w.mode == OFF, x[MOVING] == MOVING_DRIVEN
    own_cos, own_sin, ahead_cos, ahead_sin, turned = c.cos, c.sin, c.cos, c.sin, 0.0
    turn = (w.first + done) * w.revolutions
    turn = 2 * math.pi * (turn - math.floor(turn))
    cos, sin = math.cos(turn), math.sin(turn)
    cos_step, sin_step = math.cos(2 * math.pi * w.revolutions), math.sin(2 * math.pi * w.revolutions)
    for k in range(count):
        if driven:
            x[OMEGA] += w.speed_step
            turned = c.encoder_ratio * x[OMEGA] * c.sample_s
            angle = c.angle_rad + c.encoder_ratio * (x[THETA] - x[ANCHOR])
            own_cos, own_sin = math.cos(angle), math.sin(angle)
            ahead_cos, ahead_sin = math.cos(angle + c.lead_samples * turned), math.sin(angle + c.lead_samples * turned)
        if bench is None:
            i_a = read(s, x[READING_A], s.gain_a, s.offset_a, noise[k, 0])
            i_b = read(s, x[READING_B], s.gain_b, s.offset_b, noise[k, 1])
            i_alpha, i_beta = i_a, (i_a + 2 * i_b) / SQRT3
        else:
            i_alpha, i_beta = sense(bench.sensing, x, noise, k, phases_out)
        square = i_alpha * i_alpha + i_beta * i_beta
        if not off and w.mode != GIVEN:
            x[OVERLOAD] = max(0.0, x[OVERLOAD] + (square * c.per_rated2 - 1.0) * c.sample_s)
            if square > c.trip_a * c.trip_a or x[OVERLOAD] > c.overload_s:
                return k
        i_d, i_q = own_cos * i_alpha + own_sin * i_beta, -own_sin * i_alpha + own_cos * i_beta
        v_d = v_q = 0.0
        if w.mode == CONTROL:
            v_d, v_q = _control(c, w, done + k, x, i_d, i_q, turned)
        elif w.mode == STEPS:
            v_d, v_q = _step(c, w, done + k, x, i_d, i_q)
        elif w.mode == OPEN:
            v_d, v_q = _inject(c, w, done + k, cos, sin)
            cos, sin = cos * cos_step - sin * sin_step, sin * cos_step + cos * sin_step
        if w.mode != GIVEN:
            v_out[k, 0] = np.float32(ahead_cos * v_d - ahead_sin * v_q)
            v_out[k, 1] = np.float32(ahead_sin * v_d + ahead_cos * v_q)
        i_out[k, 0], i_out[k, 1] = np.float32(i_alpha), np.float32(i_beta)
        bus_out[k] = np.float32(x[BUS])
        sums[0] += v_d
        sums[1] += v_q
        # With the bridge off the drive measures the terminal voltage, which is the back-EMF.
        emf_alpha = np.float32(-x[OMEGA] * (x[SIN] * x[PSI_D] + x[COS] * x[PSI_Q]))
        emf_beta = np.float32(x[OMEGA] * (x[COS] * x[PSI_D] - x[SIN] * x[PSI_Q]))
        x[FILTERED_D] += c.telemetry_step * (i_d - x[FILTERED_D])
        x[FILTERED_Q] += c.telemetry_step * (i_q - x[FILTERED_Q])
        # The voltage acts as rounded in the row, so that a recording holds exactly what was applied.
        if bench is None:
            advance(p, e, spline, x, float(v_out[k, 0]), float(v_out[k, 1]), off)
        else:
            advance_switched(p, e, spline, bench.switching, x, float(v_out[k, 0]), float(v_out[k, 1]), off)
        if off and driven:
            v_out[k, 0], v_out[k, 1] = emf_alpha, emf_beta
    return count
