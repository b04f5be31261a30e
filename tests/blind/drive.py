"""The drive around the blind plant: two phase sensors and their faults, current control, injection, sample by sample.

One row is a recording's row: the current as the sensors read it at t_k, and the voltage that is held from then on.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from tests.blind.plant import (
    HEAT,
    INT_D,
    INT_Q,
    LAG_A,
    LAG_B,
    LOOSE,
    NOISE_A,
    NOISE_B,
    OLD_A,
    OLD_B,
    PAST,
    SHOWN_A,
    SHOWN_B,
    SLOPE_A,
    SLOPE_B,
    SQRT3,
    Array,
    Plant,
    advance,
)
from tests.blind.switched import SAG, Bridge, go_through

Rows = np.ndarray[Any, np.dtype[np.float32]]

CONTROL, OPEN, OFF = 0, 1, 2
"""Current control; open-loop voltage; bridge off."""


@njit(cache=True, nogil=True)
def _reading(
    p: Plant, i: float, gain: float, offset: float, noise: float, time: float, k: int, shown: float, phase: float
) -> float:
    """One phase sensor, from amperes to its code."""
    value = i
    if p.clip_a > 0.0:
        value = i / (1.0 + (i / p.clip_a) ** 6) ** (1.0 / 6.0)
    value = gain * (value + p.cubic * value * value * value) + offset
    if p.hum_a != 0.0:
        value += p.hum_a * math.sin(2 * math.pi * 49.97 * time + phase)
    if k % 2 == 1:
        value = value * (1.0 + p.odd_gain) + p.odd_offset
    value += p.noise * noise
    if abs(value - shown) < p.stick_a:
        return shown
    if p.quantum > 0.0:
        value = p.quantum * math.floor(value / p.quantum + 0.5)
    return value


@njit(cache=True, nogil=True)
def _triangle(duty: float, phase: float, height: float) -> float:
    """Ripple of one phase where sampling and carrier do not keep step."""
    return height * duty * (1.0 - duty) * (4.0 * abs(phase - math.floor(phase) - 0.5) - 1.0)


@njit(cache=True, nogil=True)
def run(
    p: Plant, table: Array, low: float, per_step: float, y: Array, memory: Array, work: Array, start_s: float,
    believed: float, mode: int, gains: Array, max_v: float, wanted: Array, noise: Array, i_out: Rows, v_out: Rows,
    bridge: Bridge, bus_out: Rows, phases_out: Rows,
) -> None:  # fmt: skip
    """Run one stretch: `wanted` is i_dq in CONTROL and v_dq in OPEN, both in the believed frame, a row a sample.

    `noise` has six standard normal columns: sensors a and b, sampling jitter, glitches, the loose contact, sensor c.
    """
    c, s = math.cos(believed), math.sin(believed)
    ts = p.sample_s
    keep = math.sqrt(1.0 - p.noise_memory * p.noise_memory)
    whole = int(p.delay_samples + 1e-9)
    part = p.delay_samples - whole
    for k in range(wanted.shape[0]):
        time = start_s + k * ts
        # What the sensors say at t_k.
        i_a, i_b = memory[LAG_A], memory[LAG_B]
        if mode == OFF:
            i_a = i_b = 0.0
        if p.jitter_s > 0.0 and mode != OFF:
            late = p.jitter_s * noise[k, 2]
            i_a += late * memory[SLOPE_A]
            i_b += late * memory[SLOPE_B]
        if bridge.late_s != 0.0 and mode != OFF:
            i_a += bridge.late_s * memory[SLOPE_A]
            i_b += bridge.late_s * memory[SLOPE_B]
        if p.pwm_ripple > 0.0 and mode != OFF:
            v_a, v_b = memory[PAST], 0.5 * (SQRT3 * memory[PAST + 1] - memory[PAST])
            i_a += _triangle(0.5 + v_a / p.bus_v, 0.01317 * k, p.pwm_ripple)
            i_b += _triangle(0.5 + v_b / p.bus_v, 0.01317 * k, p.pwm_ripple)
        memory[NOISE_A] = p.noise_memory * memory[NOISE_A] + keep * noise[k, 0]
        memory[NOISE_B] = p.noise_memory * memory[NOISE_B] + keep * noise[k, 1]
        gain_a = p.gain_a + p.gain_drift_per_s * time
        offset_a = p.offset_a + p.drift_a_per_s * time + p.crosstalk * i_b
        read_a = _reading(p, i_a, gain_a, offset_a, memory[NOISE_A], time, k, memory[SHOWN_A], 0.4)
        read_b = _reading(p, i_b, p.gain_b, p.offset_b, memory[NOISE_B], time, k, memory[SHOWN_B], 2.1)
        if noise[k, 3] > p.glitch:
            memory[SHOWN_A], memory[SHOWN_B] = read_a, read_b
        i_alpha, i_beta = memory[SHOWN_A], (memory[SHOWN_A] + 2 * memory[SHOWN_B]) / SQRT3
        if bridge.gain_c > 0.0:
            read_c = _reading(p, -i_a - i_b, bridge.gain_c, bridge.offset_c, noise[k, 5], time, k, 0.0, 4.3)
            i_alpha, i_beta = (2 * read_a - read_b - read_c) / 3, (read_b - read_c) / SQRT3
            phases_out[k, 0], phases_out[k, 1], phases_out[k, 2] = read_a, read_b, read_c
        i_out[k, 0], i_out[k, 1] = i_alpha, i_beta
        bus_out[k] = bridge.bus_gain * (p.bus_v - memory[SAG]) if bridge.bus_gain > 0.0 else p.bus_v
        # What the drive makes of it.
        v_d = v_q = 0.0
        if mode == CONTROL:
            i_d, i_q = c * i_alpha + s * i_beta, -s * i_alpha + c * i_beta
            error_d, error_q = wanted[k, 0] - i_d, wanted[k, 1] - i_q
            memory[INT_D] += gains[2] * ts * error_d
            memory[INT_Q] += gains[3] * ts * error_q
            v_d, v_q = gains[0] * error_d + memory[INT_D], gains[1] * error_q + memory[INT_Q]
            length = math.sqrt(v_d * v_d + v_q * v_q)
            if length > max_v:
                v_d, v_q = v_d * max_v / length, v_q * max_v / length
        elif mode == OPEN:
            v_d, v_q = wanted[k, 0], wanted[k, 1]
        v_out[k, 0], v_out[k, 1] = c * v_d - s * v_q, s * v_d + c * v_q
        # What the machine makes of that, in the row's own rounding.
        for m in range(3, 0, -1):
            memory[PAST + 2 * m], memory[PAST + 2 * m + 1] = memory[PAST + 2 * m - 2], memory[PAST + 2 * m - 1]
        memory[PAST], memory[PAST + 1] = _impressed(p, float(v_out[k, 0]), float(v_out[k, 1]))
        if mode == OFF:
            _cool(p, y)
            continue
        if p.loose_ohm > 0.0 and noise[k, 4] > p.loose_rate:
            memory[LOOSE] = p.loose_ohm - memory[LOOSE]
        if bridge.half_s > 0.0:
            for m in range(round(ts / bridge.half_s)):
                held = PAST + 2 * whole
                memory[SLOPE_A], memory[SLOPE_B] = go_through(
                    p, bridge, table, low, per_step, y, work, memory[held], memory[held + 1],
                    time + m * bridge.half_s, believed, memory[LOOSE], memory,
                )  # fmt: skip
            continue
        before_a, before_b = memory[OLD_A], memory[OLD_B]
        now = PAST + 2 * whole
        if part > 0.0:
            advance(
                p, table, low, per_step, y, work, memory[now + 2], memory[now + 3], time, part * ts, believed,
                memory[LOOSE], memory,
            )  # fmt: skip
        advance(
            p, table, low, per_step, y, work, memory[now], memory[now + 1], time + part * ts, (1 - part) * ts,
            believed, memory[LOOSE], memory,
        )  # fmt: skip
        memory[SLOPE_A], memory[SLOPE_B] = (memory[OLD_A] - before_a) / ts, (memory[OLD_B] - before_b) / ts


@njit(cache=True, nogil=True)
def _impressed(p: Plant, v_alpha: float, v_beta: float) -> tuple[float, float]:
    """What a PWM counter of finite resolution makes of the commanded vector."""
    if p.step_v <= 0.0:
        return v_alpha, v_beta
    v_a = p.step_v * math.floor(v_alpha / p.step_v + 0.5)
    v_b = p.step_v * math.floor(0.5 * (SQRT3 * v_beta - v_alpha) / p.step_v + 0.5)
    v_c = p.step_v * math.floor(0.5 * (-SQRT3 * v_beta - v_alpha) / p.step_v + 0.5)
    return (2 * v_a - v_b - v_c) / 3, (v_b - v_c) / SQRT3


@njit(cache=True, nogil=True)
def _cool(p: Plant, y: Array) -> None:
    y[HEAT] *= math.exp(-p.sample_s / p.heat_fast_s)
    y[HEAT + 1] *= math.exp(-p.sample_s / p.heat_slow_s)
