"""Phase-current sensors, compiled: two linear ones, or two or three with drift, remanence and converter."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from plugins.drives.simulated._energy import Array
from plugins.drives.simulated._numba import inlined
from plugins.drives.simulated._state import DRIFT, LAST_CURRENT, READING_A, READING_B, REMANENT, SQRT3
from plugins.drives.simulated._switching import SwitchingParameters

Rows = np.ndarray[Any, np.dtype[np.float32]]


class SensorParameters(NamedTuple):
    """Sensors of phases a and b; the third current is i_c = -i_a - i_b."""

    gain_a: float
    gain_b: float
    cubic_per_a2: float
    offset_a: float
    offset_b: float
    noise_a: float
    quantum_a: float


class SensingParameters(NamedTuple):
    """Sensors of the switched inverter; entries of the third apply only where `three` is True."""

    three: bool
    gain: tuple[float, float, float]
    offset_a: tuple[float, float, float]
    cubic_per_a2: float
    even_per_a: float
    noise_a: float
    drift_a: float
    """Standard deviation of an offset's random-walk step per row."""
    remanence_a: float
    remanence_share: float
    """Slope of the play-type hysteresis: remanent reading over current change, up to `remanence_a`."""
    quantum_a: float
    full_scale_a: float
    """Saturation limit of a reading; infinite without a converter."""


class BenchParameters(NamedTuple):
    """Parameters of the switched inverter and its sensors."""

    switching: SwitchingParameters
    sensing: SensingParameters


@inlined
def read(s: SensorParameters, phase: float, gain: float, offset: float, noise: float) -> float:
    value = gain * (phase + s.cubic_per_a2 * phase * phase * phase) + offset + s.noise_a * noise
    if s.quantum_a > 0.0:
        value = s.quantum_a * math.floor(value / s.quantum_a + 0.5)
    return value


@inlined
def _sensor(s: SensingParameters, x: Array, j: int, i: float, noise: float, drift: float) -> float:
    value = s.gain[j] * i * (1.0 + i * (s.even_per_a + s.cubic_per_a2 * i)) + s.offset_a[j] + s.noise_a * noise
    if s.drift_a > 0.0:
        x[DRIFT + j] += s.drift_a * drift
        value += x[DRIFT + j]
    if s.remanence_a > 0.0:
        remanent = x[REMANENT + j] + s.remanence_share * (i - x[LAST_CURRENT + j])
        x[REMANENT + j] = min(s.remanence_a, max(-s.remanence_a, remanent))
        x[LAST_CURRENT + j] = i
        value += x[REMANENT + j]
    value = min(s.full_scale_a, max(-s.full_scale_a, value))
    return s.quantum_a * math.floor(value / s.quantum_a + 0.5) if s.quantum_a > 0.0 else value


@inlined
def sense(s: SensingParameters, x: Array, noise: Rows, k: int, phases: Rows) -> tuple[float, float]:
    """Measured current (alpha, beta) of row k; with three sensors the readings are written to `phases`.

    `noise` has three columns for the sensors' noise and three for their drift.
    """
    a, b = x[READING_A], x[READING_B]
    i_a = _sensor(s, x, 0, a, noise[k, 0], noise[k, 3])
    i_b = _sensor(s, x, 1, b, noise[k, 1], noise[k, 4])
    if not s.three:
        return i_a, (i_a + 2.0 * i_b) / SQRT3
    i_c = _sensor(s, x, 2, -a - b, noise[k, 2], noise[k, 5])
    phases[k, 0], phases[k, 1], phases[k, 2] = np.float32(i_a), np.float32(i_b), np.float32(i_c)
    return (2.0 * i_a - i_b - i_c) / 3.0, (i_b - i_c) / SQRT3
