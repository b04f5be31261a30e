"""Errors of ripple inductances that are common to many points: a gain, and dead time.

Where a phase current passes zero within the ripple, the inverter's voltage error follows the ripple: part of it acts
like a smaller injected voltage along the phase's axis n, and the inductance looks too large along it,

    dL = f(|i_phase| n' L n) (n' L n) n n'.

f is unknown, one for all phases, linear between knots. The gain models errors of timing and discretisation.
The data determine the size of f.
"""

from __future__ import annotations

import numpy as np

from orchestrator.analysis._integration import Inductances
from orchestrator.numerics.types import Array

GAIN_STD = 4e-4
"""Prior standard deviation of the gain common to all inductances."""
_KNOTS = np.array([0.0, 0.005, 0.01, 0.02, 0.03, 0.045, 0.07, 0.11, 0.16])
"""Knots of f over |i_phase| (n' L n) / (largest current x mean L); f is zero from the last knot on.

The argument scales with n' L n since the current ripple is the flux ripple over n' L n.
"""
DEAD_TIME_SHARE = 0.04
"""Prior standard deviation of f: 8 V of dead time under an injection of 40 V."""
_ENTRIES = ((0, 0), (0, 1), (1, 1))


def error_modes(points: Inductances, rotor_angle_rad: Array) -> Array:
    """Change of (L_dd, L_dq, L_qq, and the four slopes) by each error mode, shape (n, 7, modes); the gain is first.

    Parameters
    ----------
    points : Inductances
    rotor_angle_rad : array, shape (n,)
        Angle of the believed d axis from phase a.
    """
    gain = _smooth(points)
    m = gain[:, np.array([[0, 1], [1, 2]])]
    out = np.zeros((len(m), 7, len(_KNOTS)))
    out[:, :, 0] = gain
    places = _KNOTS * float(np.linalg.norm(points.current, axis=1).max())
    mean_h = 0.5 * float(np.einsum("nii->n", m).mean())
    for phase in range(3):
        angle = 2.0 * np.pi / 3.0 * phase - rotor_angle_rad
        n = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        current = np.abs(np.einsum("nx,nx->n", points.current, n))
        along = np.einsum("na,nab,nb->n", n, m, n)
        for k in range(len(_KNOTS) - 1):
            share = np.interp(current * along / mean_h, places, np.eye(len(_KNOTS))[k])
            for row, (i, j) in enumerate(_ENTRIES):
                out[:, row, 1 + k] += share * along * n[:, i] * n[:, j]
    return out


def _smooth(points: Inductances, highest: int = 4) -> Array:
    """Inductances and slopes, shape (n, 7), smoothed by polynomials of the current with at least two data per term."""
    # A gain mode built from noisy data would correlate with that noise and bias the gain.
    m, t = points.matrix, points.slope
    values = np.column_stack(
        [*(m[:, i, j] for i, j in _ENTRIES), t[:, 0, 0, 0], t[:, 0, 0, 1], t[:, 0, 1, 1], t[:, 1, 1, 1]]
    )
    x, y = (points.current / np.maximum(np.abs(points.current).max(axis=0), 1e-300)).T
    degree = next(n for n in range(highest, -1, -1) if n == 0 or (n + 1) * (n + 2) <= len(values))
    design = np.stack([x**a * y**b for a in range(degree + 1) for b in range(degree + 1 - a)], axis=1)
    return np.asarray(design @ np.linalg.lstsq(design, values, rcond=None)[0])
