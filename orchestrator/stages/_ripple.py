"""Relations between the injection's amplitude, flux swing and current ripple, independent of drive and settings.

A square wave of amplitude U and frequency f swings the flux by +-U/(4 f) about its mean, a sine by +-U/(2 pi f).
"""

from __future__ import annotations

import math
from typing import Literal

from protocols import Motor

Waveform = Literal["square", "sine"]


def flux_swing_wb(amplitude_v: float, frequency_hz: float, waveform: Waveform = "square") -> float:
    """Amplitude of the flux [Wb]."""
    return amplitude_v / ((4.0 if waveform == "square" else 2 * math.pi) * frequency_hz)


def injection_voltage_v(
    current_a: float, inductance_h: float, frequency_hz: float, waveform: Waveform = "square", *, share: float = 0.2
) -> float:
    """Amplitude [V] of an injection with a flux swing of a share of L i.

    Parameters
    ----------
    current_a : float
        Rated current [A peak].
    inductance_h : float
        Inductance of the d axis.
    share : float
        Share of L i, by default a fifth: well above the current sensors' noise, and still a small signal.
    """
    return share * current_a * inductance_h / flux_swing_wb(1.0, frequency_hz, waveform)


def ripple_a(swing_wb: float, motor: Motor) -> float:
    """Peak of the current ripple on the axis of the nameplate's smaller inductance [A]; 0 where none is known."""
    known = [value for value in (motor.d_inductance_h, motor.q_inductance_h) if value is not None]
    return swing_wb / min(known) if known else 0.0
