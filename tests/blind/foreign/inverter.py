"""What a leg of the inverter loses: dead time, which its output capacitance shortens, and drops that grow slowly.

The charge table is as on a data sheet of SiC or GaN devices: C_oss falls steeply with the voltage. In a dead time the
current i moves the node by the charge of both devices, Q(u) = Q_oss(u) + Q_oss(V) - Q_oss(V - u). With i helping, the
node rises by u(t) = Q^-1(i t) instead of at once; over a period a leg loses

    e(i) = f (V t_d - integral of (V - u) dt over the dead time),   0 at no current, f V t_d at large ones.

Sources: N. Urasaki, T. Senjyu, T. Kinjo, T. Funabashi, H. Sekine, "Dead-time compensation strategy for permanent magnet
synchronous motor drive taking zero-current clamp and parasitic capacitance effects into account", IEE Proc. Electr.
Power Appl. 152 (2005) 845; S.-G. Jeong, M.-H. Park, IEEE Trans. Ind. Electron. 38 (1991), doi:10.1109/41.88903.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tests.blind.foreign.iron import Array

CHARGE_POINTS = 400
CHARGE_REACH = 4.0
"""The table's largest current, in units of that whose charge in a dead time is a whole swing; beyond it, e goes by
1/i."""


def charge_table(grading: float, residual: float) -> Array:
    """e over f V t_d at currents up to `CHARGE_REACH`, shape (`CHARGE_POINTS`,).

    Parameters
    ----------
    grading : float
        Exponent by which C_oss falls with the voltage, from 2 % of the bus on.
    residual : float
        What is left of C_oss at high voltage, over its value at none.
    """
    u = np.linspace(0.0, 1.0, 4001)
    capacitance = residual + (1.0 - residual) * (1.0 + u / 0.02) ** -grading
    oss = np.concatenate([[0.0], np.cumsum(0.5 * (capacitance[1:] + capacitance[:-1]) * np.diff(u))])
    node = oss + oss[-1] - oss[::-1]
    node /= node[-1]
    t = np.linspace(0.0, 1.0, 4001)
    left = [
        float(np.trapezoid(1.0 - np.interp(i * t, node, u), t)) for i in np.linspace(0, CHARGE_REACH, CHARGE_POINTS)
    ]
    return 1.0 - np.array(left)


@njit(cache=True, nogil=True)
def phase_loss(
    charge: Array, dead_v: float, dead_a: float, knee_v: float, knee_a: float, per_asinh: float, i: float
) -> float:
    """What one leg loses [V] at a phase current: dead time by its charge table, on-state knee by asinh(i / i_k)."""
    loss, size = 0.0, abs(i)
    if dead_v > 0.0:
        at = size / dead_a / CHARGE_REACH * (CHARGE_POINTS - 1)
        k = int(at)
        if k >= CHARGE_POINTS - 1:
            loss = dead_v * (1.0 - (1.0 - charge[-1]) * CHARGE_REACH * dead_a / size)
        else:
            loss = dead_v * (charge[k] + (at - k) * (charge[k + 1] - charge[k]))
    if knee_v > 0.0:
        loss += knee_v * per_asinh * math.asinh(size / knee_a)
    return math.copysign(loss, i)
