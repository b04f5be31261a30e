"""Corrections for the decay of a winding's current between two rows, where L / R is not long compared to a row.

Trapezoidal integrals of a sampled current are wrong by x^2 / 12 of the flux, x = h R / L: 0.1 % at ten rows for
each L / R, 8 % at one. The mean current between two rows follows from R and L; where the voltage is known to be
constant between rows, L follows exactly.
"""

from __future__ import annotations

import math


def decay_weight(decay: float) -> float:
    """Weight of the later of two rows in the mean current between them, as the difference from one half.

    With x = h R / L the current between two rows, under a constant voltage, is i_inf + (i_0 - i_inf) exp(-x t / h). Its
    mean is w i_0 + (1 - w) i_1 with w = ((1 - e^-x) / x - e^-x) / (1 - e^-x); a straight line has w = 1/2.

    Parameters
    ----------
    decay : float
        x, not negative.

    Returns
    -------
    float
        1/2 - w: x / 12 for small x, at most 1/2.
    """
    if decay < 0.01:
        return decay / 12.0
    remainder = math.exp(-decay)
    return 0.5 - ((1.0 - remainder) / decay - remainder) / (1.0 - remainder)


def exact_inductance(straight_h: float, resistance_ohm: float, step_s: float) -> float:
    """L from an estimate by trapezoids, which is `straight_h` = L + h R (1/2 - w(h R / L)).

    Parameters
    ----------
    straight_h : float
        Estimate by trapezoids [H].
    resistance_ohm, step_s : float
        R and the time between two rows h.

    Returns
    -------
    float
        [H]; zero where no L gives such a small estimate.
    """
    drop_h = resistance_ohm * step_s
    low, high = 0.0, max(straight_h, 0.0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        estimate_h = middle + drop_h * decay_weight(drop_h / max(middle, 1e-300))
        low, high = (middle, high) if estimate_h < straight_h else (low, middle)
    return 0.5 * (low + high)
