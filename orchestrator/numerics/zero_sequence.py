"""What three phase currents say of their sensors by not adding up to zero; no motor is in it.

The star has no neutral, i_a + i_b + i_c = 0, so that readings g_j i_j + o_j add up to

    (g_a - g_c) i_a + (g_b - g_c) i_b + o_a + o_b + o_c.

Both differences follow by least squares from whatever currents flowed. A gain common to all three shows in nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.frames import to_phases
from orchestrator.numerics.types import Array
from protocols import Signals

_SURE = 5.0
"""Standard deviations beyond which gains differ; so rare by chance that nobody meets it."""
_NOTEWORTHY = 2e-4
"""Difference of gains below which the readings' own noise in i_a and i_b biases it by as much."""


@dataclass(frozen=True)
class Gains:
    """Of sensors a, b, c, as parts off their mean, shape (3,), and their standard deviations."""

    off_mean: Array
    std: Array

    def differ(self, weights: tuple[float, float, float]) -> float | None:
        """A sum of the three by weights that add up to zero; None where it may be zero as well."""
        value = float(np.dot(weights, self.off_mean))
        least = max(_SURE * float(np.dot(np.abs(weights), self.std)), _NOTEWORTHY)
        return value if abs(value) > least else None


def gains_of(signals: Sequence[Signals]) -> Gains | None:
    """By segments whose vector is made of three readings, the bridge on; None where there are none, or no current."""
    normal, right, power, rows = np.zeros((3, 3)), np.zeros(3), 0.0, 0
    for one in signals:
        if one.i_abc is None or not one.clarke_of_three or not one.bridge_on:
            continue
        x = np.column_stack([to_phases(one.i_ab)[:, :2], np.ones(len(one.v_dc))])
        y = np.asarray(one.i_abc, dtype=np.float64).sum(axis=1)
        normal, right, power, rows = normal + x.T @ x, right + x.T @ y, power + float(y @ y), rows + len(y)
    if rows <= 3 or np.linalg.cond(normal) > 1e12:
        return None
    found = np.linalg.solve(normal, right)
    variance = max(power - float(right @ found), 0.0) / (rows - 3) * np.linalg.inv(normal)
    # From differences to c into parts off the mean of all.
    turn = np.array([[2.0, -1.0], [-1.0, 2.0], [-1.0, -1.0]]) / 3.0
    return Gains(turn @ found[:2], np.sqrt(np.diag(turn @ variance[:2, :2] @ turn.T)))
