"""A drive with a locked rotor and one law that no library has, written from the equations alone.

    dpsi/dt = R(-theta) (v - e) - r i - w J psi,    i = grad H(psi) + i_turn

H is the polynomial energy of Jebai, Combes, Malrait, Martin and Rouchon (doi:10.1109/CDC.2014.7040330). Nothing of the
discovery, the diagnosis or the effects is imported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

Array = np.ndarray[Any, np.dtype[np.float64]]

SQRT3 = math.sqrt(3.0)
SUBSTEPS = 4
CONTROL, OPEN, OFF = 0, 1, 2
STATES = 4
"""psi_d, psi_q, the shorted turn's lag, and the heat."""

(
    NOTHING, LOG_LEG, SQUARE_LEGS, CROSSTALK, CLIP, RAMP, GAIN_SETTLES, TURN, PLAY, CREEP, FADING_BUS,
    POOR_CONTACT, ASINH_LEG, SLOW_LEG, GROWING_DROP, SQUARE_SENSOR, MAGNITUDE_OFFSET, BUS_GAIN, HEATED_LEG,
    LOAD_ANGLE, RESOLVER, WARM_MAGNET, PICK_UP,
) = range(23)  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """Constants of a plant: magnet flux, resistance and inductances at rest, and the readings' noise."""

    magnet_wb: float = 0.30
    resistance_ohm: float = 4.4
    l_d_h: float = 0.042
    l_q_h: float = 0.067
    noise_a: float = 2e-3

    @property
    def numbers(self) -> Array:
        return np.array([self.magnet_wb, self.resistance_ohm, self.l_d_h, self.l_q_h])

    def flux(self, i_d: float, i_q: float) -> tuple[float, float]:
        """Flux at a current, the magnet's included, by Newton's method [Wb]."""
        psi = np.array([self.magnet_wb + self.l_d_h * i_d, self.l_q_h * i_q])
        for _ in range(50):
            d, q = _current(psi[0], psi[1], self.numbers, 0.0)
            off = np.array([d - i_d, q - i_q])
            if np.abs(off).max() < 1e-12:
                break
            psi -= np.linalg.solve(np.array(_slopes(psi[0], psi[1], self.numbers)).reshape(2, 2), off)
        return float(psi[0]), float(psi[1])


@njit(cache=True)
def _current(psi_d: float, psi_q: float, m: Array, lost: float) -> tuple[float, float]:
    """Of a magnet that has lost something, the stator has to make up for the current."""
    d, q = psi_d - m[0], psi_q
    return (
        lost + d / m[2] + 18.0 * d * d + 900.0 * d**3 + 320.0 * d * q * q,
        q / m[3] + 320.0 * d * d * q + 260.0 * q**3,
    )


@njit(cache=True)
def _slopes(psi_d: float, psi_q: float, m: Array) -> tuple[float, float, float, float]:
    """di_d/dpsi_d, di_d/dpsi_q, di_q/dpsi_d, di_q/dpsi_q."""
    d, q = psi_d - m[0], psi_q
    across = 640.0 * d * q
    return (
        1.0 / m[2] + 36.0 * d + 2700.0 * d * d + 320.0 * q * q,
        across,
        across,
        1.0 / m[3] + 320.0 * d * d + 780.0 * q * q,
    )


@njit(cache=True)
def _phases(alpha: float, beta: float) -> tuple[float, float, float]:
    return alpha, 0.5 * (SQRT3 * beta - alpha), -0.5 * (SQRT3 * beta + alpha)


@njit(cache=True)
def _of_phase(phase: int, x_a: float, x_b: float, x_c: float) -> tuple[float, float, float]:
    """The values of one phase, zero in the others; of all where there is none."""
    if phase < 0:
        return x_a, x_b, x_c
    return (
        x_a if phase == 0 else 0.0,
        x_b if phase == 1 else 0.0,
        x_c if phase == 2 else 0.0,
    )


@njit(cache=True)
def _lost_current(law: int, k: Array, y: Array) -> float:
    size, scale = float(k[0]), float(k[1])
    return size * (1.0 - math.exp(-float(y[3]) / scale)) if law == WARM_MAGNET else 0.0


@njit(cache=True)
def _angle(law: int, k: Array, y: Array, m: Array, t: float, believed: float) -> float:
    """The rotor's true angle."""
    size, scale = float(k[0]), float(k[1])
    if law == CREEP:
        return believed + size * (1.0 - math.exp(-t / scale))
    if law == LOAD_ANGLE:
        _, q = _current(y[0], y[1], m, 0.0)
        return believed + size * math.tanh(q / scale)
    if law == RESOLVER:
        return believed + size * math.sin(2.0 * believed + scale)
    return believed


@njit(cache=True)
def _stator(law: int, k: Array, y: Array, m: Array, theta: float) -> tuple[float, float]:
    """Stator current of the fluxes and the shorted turn's lag."""
    d, q = _current(y[0], y[1], m, _lost_current(law, k, y))
    c, s = math.cos(theta), math.sin(theta)
    alpha = c * d - s * q
    if law == TURN:
        alpha += 2.0 / 3.0 * k[0] * (c * y[0] - s * y[1] - y[2])
    return alpha, s * d + c * q


@njit(cache=True)
def _leg(law: int, k: Array, y: Array, x: float, t: float, pulses: float) -> float:
    """Voltage that a leg loses at its current x."""
    size, scale = float(k[0]), float(k[1])
    if law == LOG_LEG:
        return size * math.copysign(math.log1p(abs(x) / scale), x)
    if law == SQUARE_LEGS:
        return size * x * x
    if law == POOR_CONTACT:
        return size * (x / scale) / (1.0 + (x / scale) ** 2)
    if law == ASINH_LEG:
        return size * math.asinh(x / scale)
    if law == SLOW_LEG:
        return size * math.tanh(x / scale) * pulses
    if law == GROWING_DROP:
        return size * math.tanh(x / scale) * t / 60.0
    if law == HEATED_LEG:
        return size * float(y[3]) * x
    return 0.0


@njit(cache=True)
def _rates(
    law: int, k: Array, phase: int, m: Array, y: Array, v_alpha: float, v_beta: float, bus: float, t: float,
    believed: float, pulses: float, out: Array,
) -> None:  # fmt: skip
    theta, r = _angle(law, k, y, m, t, believed), m[1]
    alpha, beta = _stator(law, k, y, m, theta)
    if law == RAMP:
        r += k[0] * max(t / k[1] - 1.0, 0.0)
    gain = 1.0
    if law == FADING_BUS:
        gain = 1.0 - k[0] * (1.0 - math.exp(-t / k[1]))
    elif law == BUS_GAIN:
        gain = 1.0 - k[0] * bus
    a, b, c = _phases(alpha, beta)
    e_a, e_b, e_c = _of_phase(
        phase, _leg(law, k, y, a, t, pulses), _leg(law, k, y, b, t, pulses), _leg(law, k, y, c, t, pulses)
    )
    u_alpha = gain * v_alpha - r * alpha - (2.0 * e_a - e_b - e_c) / 3.0
    u_beta = gain * v_beta - r * beta - (e_b - e_c) / SQRT3
    cos, sin = math.cos(theta), math.sin(theta)
    u_d, u_q = cos * u_alpha + sin * u_beta, cos * u_beta - sin * u_alpha
    turning = 0.0
    if law == CREEP:
        turning = k[0] / k[1] * math.exp(-t / k[1])
    elif law == LOAD_ANGLE:
        # The angle follows i_q, whose rate depends on how fast the angle moves.
        _, q = _current(y[0], y[1], m, 0.0)
        _, _, q_d, q_q = _slopes(y[0], y[1], m)
        per_q = k[0] / k[1] / math.cosh(q / k[1]) ** 2
        turning = per_q * (q_d * u_d + q_q * u_q) / (1.0 - per_q * (q_d * y[1] - q_q * y[0]))
    out[0] = u_d + turning * y[1]
    out[1] = u_q - turning * y[0]
    out[2] = (cos * y[0] - sin * y[1] - y[2]) / k[1] if law == TURN else 0.0
    out[3] = 1.5 * m[1] * (alpha * alpha + beta * beta)
    if law == HEATED_LEG:
        out[3] -= y[3] / k[1]


@njit(cache=True)
def _read(
    law: int, k: Array, phase: int, a: float, b: float, t: float, cores: Array, slopes: Array
) -> tuple[float, float]:
    """Both sensors' readings without noise."""
    if law == PLAY:
        cores[0] = min(max(cores[0], a - k[1]), a + k[1])
        cores[1] = min(max(cores[1], b - k[1]), b + k[1])
        return a + k[0] / k[1] * (a - cores[0]), b + k[0] / k[1] * (b - cores[1])
    x, other, slope = (a, b, slopes[0]) if phase == 0 else (b, -a - b, slopes[1])
    error = 0.0
    if law == CROSSTALK:
        error = k[0] * math.tanh(other / k[1])
    elif law == CLIP:
        error = -k[0] * math.copysign(max(abs(x) - k[1], 0.0), x)
    elif law == GAIN_SETTLES:
        error = x * k[0] * (1.0 - math.exp(-t / k[1]))
    elif law == SQUARE_SENSOR:
        error = k[0] * x * x
    elif law == MAGNITUDE_OFFSET:
        error = k[0] * math.hypot(a, (a + 2.0 * b) / SQRT3)
    elif law == PICK_UP:
        error = k[0] * math.tanh(slope / k[1])
    return (a + error, b) if phase == 0 else (a, b + error)


@njit(cache=True)
def run(
    law: int, k: Array, phase: int, m: Array, y: Array, cores: Array, mode: int, gains: Array, pull: Array,
    believed: float, pulses: float, start: float, ts: float, wanted: Array, bus: Array, noise: Array, i_out: Array,
    v_out: Array,
) -> None:  # fmt: skip
    """Row by row: the current read at t_k, and the voltage held until t_k+1 by classical Runge-Kutta."""
    cos, sin = math.cos(believed), math.sin(believed)
    h = ts / SUBSTEPS
    rates, z, slopes, before = np.zeros((4, STATES)), np.zeros(STATES), np.zeros(2), np.zeros(2)
    for n in range(wanted.shape[0]):
        t = start + n * ts
        a = b = 0.0
        if mode != OFF:
            alpha, beta = _stator(law, k, y, m, _angle(law, k, y, m, t, believed))
            a, b, _ = _phases(alpha, beta)
        if n > 0:
            slopes[0], slopes[1] = (a - before[0]) / ts, (b - before[1]) / ts
        before[0], before[1] = a, b
        a, b = _read(law, k, phase, a, b, t, cores, slopes)
        a, b = a + noise[n, 0], b + noise[n, 1]
        alpha, beta = a, (a + 2.0 * b) / SQRT3
        i_out[n, 0], i_out[n, 1] = alpha, beta
        v_d = v_q = 0.0
        if mode == CONTROL:
            off_d = wanted[n, 0] - cos * alpha - sin * beta
            off_q = wanted[n, 1] - cos * beta + sin * alpha
            pull[0] += gains[2] * ts * off_d
            pull[1] += gains[3] * ts * off_q
            v_d, v_q = gains[0] * off_d + pull[0], gains[1] * off_q + pull[1]
        elif mode == OPEN:
            v_d, v_q = wanted[n, 0], wanted[n, 1]
        v_alpha, v_beta = cos * v_d - sin * v_q, sin * v_d + cos * v_q
        v_out[n, 0], v_out[n, 1] = v_alpha, v_beta
        if mode == OFF:
            continue
        for s in range(SUBSTEPS):
            now, u = t + s * h, bus[n]
            _rates(law, k, phase, m, y, v_alpha, v_beta, u, now, believed, pulses, rates[0])
            for j in range(STATES):
                z[j] = y[j] + 0.5 * h * rates[0, j]
            _rates(law, k, phase, m, z, v_alpha, v_beta, u, now + 0.5 * h, believed, pulses, rates[1])
            for j in range(STATES):
                z[j] = y[j] + 0.5 * h * rates[1, j]
            _rates(law, k, phase, m, z, v_alpha, v_beta, u, now + 0.5 * h, believed, pulses, rates[2])
            for j in range(STATES):
                z[j] = y[j] + h * rates[2, j]
            _rates(law, k, phase, m, z, v_alpha, v_beta, u, now + h, believed, pulses, rates[3])
            for j in range(STATES):
                y[j] += h / 6.0 * (rates[0, j] + 2.0 * rates[1, j] + 2.0 * rates[2, j] + rates[3, j])
