"""Sampled rows as currents and voltages in the stator frame. Pure computation.

A row's currents are those that the current control of the same period has worked with, and its angle is that of the
frame it worked in; so the voltage that it commanded follows from them, by its own equation (`control_current` in
motor/mcpwm_foc.c):

    v = K_p (i* - i) + K_i Ts sum (i* - i) + tone.

The sum's start is not known: a held current has the mean of the voltage from the board; an injection, whose frame
turns, is given none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from protocols import DriveFault, FaultCause

Vectors = NDArray[np.complex128]
TONE_TABLE = np.sin(2.0 * np.pi * np.arange(32) / 32)
"""A tone's wave (utils_tab_sin_32_1)."""
ANGLE_STEP_RAD = 2.0 * np.pi / 250.0
"""Resolution of a row's angle, an octet."""
TONE_FREQUENCY_RATIO = 1.0 + 1e-4
"""A tone's frequency over the requested one: where a period is a whole number of the table's steps at each row,
the board's rounding would decide between two values of the table."""
_PHASES = 2.0 / 3.0 * np.exp(2j * np.pi * np.arange(3) / 3)


def currents(rows: np.ndarray) -> Vectors:
    """Current vectors, alpha + j beta."""
    return np.asarray(rows["i"].astype(float) @ _PHASES, dtype=np.complex128)


def control(i: Vectors, target_a: float, gains: tuple[float, float], row_s: float) -> Vectors:
    """What the current control adds to where its integrals began; all in its own frame."""
    error = target_a - i
    return np.asarray(gains[0] * error + gains[1] * row_s * np.cumsum(error))


def tone(count: int, frequency_hz: float, amplitude_v: float, row_s: float) -> tuple[NDArray[np.float64], Vectors]:
    """Places in the wave's period, 0 to 1, and the tone's voltage in each row; in single precision, as the board."""
    step, place = np.float32(np.float32(32.0) * np.float32(frequency_hz)) * np.float32(row_s), np.float32(0.0)
    places = np.empty(count)
    for k in range(count):
        place = np.float32(place + step)
        if place >= 32.0:
            place = np.float32(place - np.float32(32.0))
        places[k] = place
    return places / 32.0, 1j * amplitude_v * TONE_TABLE[places.astype(int)]


def turning_frame(rows: np.ndarray, turns_hz: float, row_s: float) -> tuple[NDArray[np.float64], int]:
    """The frame's angle in each row [rad], and the row from which on it turns.

    Angles of rows are steps of 1.4 degrees; the rate is known, so that one angle is all that there is to find.
    Raises `DriveFault` where the last half of the rows does not turn so.
    """
    steady = 2.0 * np.pi * turns_hz * row_s * np.arange(len(rows), dtype=np.float64)
    off = np.exp(1j * ((rows["phase"] + 0.5) * ANGLE_STEP_RAD - steady))
    first = float(np.angle(off[len(rows) // 2 :].mean()))
    apart = np.abs(np.angle(off * np.exp(-1j * first)))
    other = np.flatnonzero(apart > 1.5 * ANGLE_STEP_RAD)
    begin = int(other[-1]) + 1 if len(other) else 0
    if begin > len(rows) // 2:
        raise DriveFault(FaultCause.WRONG_DATA, f"the frame does not turn at {turns_hz:g} Hz")
    return np.asarray(first + steady, dtype=np.float64), begin


def window(
    angle: NDArray[np.float64],
    place: NDArray[np.float64],
    direction_rad: float,
    phase: float,
    first: int,
    last: int,
    step: float,
) -> int:
    """The row, first to last, from which on wave and direction are nearest to the requested ones.

    A wave half a period on, along the opposite direction, is the same.

    Parameters
    ----------
    angle, place : array, shape (n,)
        Direction of the injection [rad], and place in its wave's period, 0 to 1.
    direction_rad, phase : float
        The requested ones.
    step : float
        Of the place, from row to row.
    """
    k = np.arange(first, last + 1)
    off, late = angle[k] - direction_rad, place[k] - phase
    best, least = first, np.inf
    for half in (0.0, 0.5):
        apart = np.abs(np.angle(np.exp(1j * (off + 2.0 * np.pi * half))))
        beside = np.abs((late + half + 0.5) % 1.0 - 0.5)
        apart = np.where(beside <= 0.51 * step, apart, np.inf)
        if apart.min() < least:
            best, least = int(k[np.argmin(apart)]), float(apart.min())
    return best
