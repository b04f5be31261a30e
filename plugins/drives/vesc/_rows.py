"""Converts sampled rows to currents and voltages in the stator frame.

A row holds the currents and the frame angle of the current control in the same period. The commanded voltage follows
from them by the control's equation (`control_current` in motor/mcpwm_foc.c):

    v = K_p (i* - i) + K_i Ts sum (i* - i) + tone.

The sum's initial value is not known. For a held current the board's mean voltage replaces it; for an injection, whose
frame rotates, the mean is set to zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocols import DriveFault, FaultCause

Vectors = NDArray[np.complex128]
TONE_TABLE = np.sin(2.0 * np.pi * np.arange(32) / 32)
"""Waveform of a tone (utils_tab_sin_32_1)."""
ANGLE_STEP_RAD = 2.0 * np.pi / 250.0
"""Resolution of a row's angle, which is one octet."""
TONE_FREQUENCY_RATIO = 1.0 + 1e-4
"""A tone's frequency over the requested one. At the exact frequency rows can fall on the boundary of two table values,
between which the board's rounding decides."""
_PHASES = 2.0 / 3.0 * np.exp(2j * np.pi * np.arange(3) / 3)


def currents(rows: np.ndarray) -> Vectors:
    """Current vectors, alpha + j beta."""
    return np.asarray(rows["i"].astype(float) @ _PHASES, dtype=np.complex128)


def control(i: Vectors, target_a: float, gains: tuple[float, float], row_s: float) -> Vectors:
    """Voltage of the current control without its initial integral, in its own frame [V]."""
    error = target_a - i
    return np.asarray(gains[0] * error + gains[1] * row_s * np.cumsum(error))


def tone(count: int, frequency_hz: float, amplitude_v: float, row_s: float) -> tuple[NDArray[np.float64], Vectors]:
    """Phase of the wave (0 to 1) and voltage of the tone in each row, in single precision as on the board."""
    step, position = np.float32(np.float32(32.0) * np.float32(frequency_hz)) * np.float32(row_s), np.float32(0.0)
    phases = np.empty(count)
    for k in range(count):
        position = np.float32(position + step)
        if position >= 32.0:
            position = np.float32(position - np.float32(32.0))
        phases[k] = position
    return phases / 32.0, 1j * amplitude_v * TONE_TABLE[phases.astype(int)]


def turning_frame(rows: np.ndarray, turns_hz: float, row_s: float) -> tuple[NDArray[np.float64], int]:
    """The frame's angle in each row [rad], and the first row from which on it rotates.

    Angles of rows have steps of 1.4 degrees. The rate is known, so that only the initial angle is estimated.
    Raises `DriveFault` where the last half of the rows does not rotate at this rate.
    """
    steady = 2.0 * np.pi * turns_hz * row_s * np.arange(len(rows), dtype=np.float64)
    rotation = np.exp(1j * ((rows["phase"] + 0.5) * ANGLE_STEP_RAD - steady))
    first = float(np.angle(rotation[len(rows) // 2 :].mean()))
    deviation = np.abs(np.angle(rotation * np.exp(-1j * first)))
    outliers = np.flatnonzero(deviation > 1.5 * ANGLE_STEP_RAD)
    begin = int(outliers[-1]) + 1 if len(outliers) else 0
    if begin > len(rows) // 2:
        raise DriveFault(FaultCause.WRONG_DATA, f"the frame does not rotate at {turns_hz:g} Hz")
    return np.asarray(first + steady, dtype=np.float64), begin


def window(
    angle: NDArray[np.float64],
    wave_phase: NDArray[np.float64],
    direction_rad: float,
    phase: float,
    first: int,
    last: int,
    step: float,
) -> int:
    """The row from `first` to `last` at which wave and direction are nearest to the requested ones.

    A wave shifted by half a period, along the opposite direction, is equivalent.

    Parameters
    ----------
    angle, wave_phase : array, shape (n,)
        Direction of the injection [rad], and phase of its wave, 0 to 1.
    direction_rad, phase : float
        Requested direction and phase.
    step : float
        Increment of the phase per row.
    """
    k = np.arange(first, last + 1)
    angle_error, phase_shift = angle[k] - direction_rad, wave_phase[k] - phase
    best, smallest = first, np.inf
    for half in (0.0, 0.5):
        deviation = np.abs(np.angle(np.exp(1j * (angle_error + 2.0 * np.pi * half))))
        phase_error = np.abs((phase_shift + half + 0.5) % 1.0 - 0.5)
        deviation = np.where(phase_error <= 0.51 * step, deviation, np.inf)
        if deviation.min() < smallest:
            best, smallest = int(k[np.argmin(deviation)]), float(deviation.min())
    return best
