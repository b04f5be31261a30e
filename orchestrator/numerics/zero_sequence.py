"""Gain differences of three current sensors from the sum of the phase currents, without a motor model.

The star has no neutral, i_a + i_b + i_c = 0, so that readings g_j i_j + o_j add up to

    (g_a - g_c) i_a + (g_b - g_c) i_b + o_a + o_b + o_c.

Least squares give both differences for any currents. A gain common to all three is not identifiable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.frames import to_phases
from orchestrator.numerics.types import Array
from protocols import Signals

_MIN_DIFFERENCE_SIGMAS = 5.0
"""Standard deviations beyond which gains differ; practically impossible by chance."""
_MIN_DIFFERENCE = 2e-4
"""Difference of gains below which the noise of i_a and i_b causes a bias of the same size."""


@dataclass(frozen=True)
class Gains:
    """Relative gain deviations of sensors a, b, c from their mean, shape (3,), and their standard deviations."""

    off_mean: Array
    std: Array

    def differ(self, weights: tuple[float, float, float]) -> float | None:
        """A contrast of the three deviations (weights that add up to zero); None where it is insignificant."""
        value = float(np.dot(weights, self.off_mean))
        min_difference = max(_MIN_DIFFERENCE_SIGMAS * float(np.dot(np.abs(weights), self.std)), _MIN_DIFFERENCE)
        return value if abs(value) > min_difference else None


def gains_of(signals: Sequence[Signals]) -> Gains | None:
    """Gains from segments with three readings and the bridge on; None where there are none, or no current."""
    normal, right, power, rows = np.zeros((3, 3)), np.zeros(3), 0.0, 0
    for segment in signals:
        if segment.i_abc is None or not segment.clarke_of_three or not segment.bridge_on:
            continue
        x = np.column_stack([to_phases(segment.i_ab)[:, :2], np.ones(len(segment.v_dc))])
        y = np.asarray(segment.i_abc, dtype=np.float64).sum(axis=1)
        normal, right, power, rows = normal + x.T @ x, right + x.T @ y, power + float(y @ y), rows + len(y)
    if rows <= 3 or np.linalg.cond(normal) > 1e12:
        return None
    solution = np.linalg.solve(normal, right)
    variance = max(power - float(right @ solution), 0.0) / (rows - 3) * np.linalg.inv(normal)
    # Converts differences from sensor c to deviations from the mean.
    turn = np.array([[2.0, -1.0], [-1.0, 2.0], [-1.0, -1.0]]) / 3.0
    return Gains(turn @ solution[:2], np.sqrt(np.diag(turn @ variance[:2, :2] @ turn.T)))
