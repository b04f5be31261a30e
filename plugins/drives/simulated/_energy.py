"""The magnetic energy H(psi) and its derivatives, compiled: i = grad H, 1/L = Hess H.

Either the paper's polynomial or a tensor cubic B-spline; both are functions of one scalar, so
reciprocity holds by construction, and both are even in psi_q by construction. Outside the box in
which it is known, H is continued quadratically, so that an overcurrent meets a stiff but finite motor.
`_polynomial` and `_map` supply the coefficients.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from plugins.drives.simulated._numba import inlined

Array = np.ndarray[Any, np.dtype[np.float64]]


class Energy(NamedTuple):
    """Coefficients of H, in Wb and A; those of a spline are in `Magnetics`."""

    is_map: bool
    psi_m: float
    """Flux linkage of the magnets at zero current [Wb]."""
    inverse_l_d: float = 1.0
    inverse_l_q: float = 1.0
    a30: float = 0.0
    a12: float = 0.0
    a40: float = 0.0
    a22: float = 0.0
    a04: float = 0.0
    a60: float = 0.0
    a06: float = 0.0
    rows: int = 1
    """Cells of the spline along psi_d."""
    columns: int = 1
    cells_per_wb_d: float = 1.0
    cells_per_wb_q: float = 1.0
    low_d: float = -1e9
    high_d: float = 1e9
    high_q: float = 1e9
    """Box in psi: low_d..high_d by -high_q..high_q."""
    outside_d: float = 1.0
    outside_q: float = 1.0
    """Second derivatives outside the box [1/H]."""


class Magnetics(NamedTuple):
    """An energy with its spline. The array is separate, since compiled code counts references at every call."""

    energy: Energy
    spline: Array
    """Coefficients of the spline, shape (rows + 3, columns + 3), symmetric in the second axis."""


@inlined
def _polynomial_derivatives(e: Energy, psi_d: float, psi_q: float) -> tuple[float, float, float, float, float]:
    x, y = psi_d - e.psi_m, psi_q
    x2, y2 = x * x, y * y
    x4, y4 = x2 * x2, y2 * y2
    h_d = x * (e.inverse_l_d + 3 * e.a30 * x + 4 * e.a40 * x2 + 2 * e.a22 * y2 + 6 * e.a60 * x4) + e.a12 * y2
    h_q = y * (e.inverse_l_q + 2 * e.a12 * x + 2 * e.a22 * x2 + 4 * e.a04 * y2 + 6 * e.a06 * y4)
    h_dd = e.inverse_l_d + 6 * e.a30 * x + 12 * e.a40 * x2 + 2 * e.a22 * y2 + 30 * e.a60 * x4
    h_dq = (2 * e.a12 + 4 * e.a22 * x) * y
    h_qq = e.inverse_l_q + 2 * e.a12 * x + 2 * e.a22 * x2 + 12 * e.a04 * y2 + 30 * e.a06 * y4
    return h_d, h_q, h_dd, h_dq, h_qq


@inlined
def _spline_derivatives(
    e: Energy, spline: Array, psi_d: float, psi_q: float
) -> tuple[float, float, float, float, float]:
    side = -1.0 if psi_q < 0 else 1.0  # exact evenness: evaluate one half only
    s = (psi_d - e.low_d) * e.cells_per_wb_d
    t = (side * psi_q + e.high_q) * e.cells_per_wb_q
    row = min(max(int(s), 0), e.rows - 1)
    column = min(max(int(t), 0), e.columns - 1)
    s, t = s - row, t - column
    r, w = 1.0 - s, 1.0 - t
    b = (r * r * r / 6, (3 * s * s * s - 6 * s * s + 4) / 6, (3 * r * r * r - 6 * r * r + 4) / 6, s * s * s / 6)
    b1 = (-r * r / 2, (3 * s * s - 4 * s) / 2, -(3 * r * r - 4 * r) / 2, s * s / 2)
    b2 = (r, 3 * s - 2, 3 * r - 2, s)
    c = (w * w * w / 6, (3 * t * t * t - 6 * t * t + 4) / 6, (3 * w * w * w - 6 * w * w + 4) / 6, t * t * t / 6)
    c1 = (-w * w / 2, (3 * t * t - 4 * t) / 2, -(3 * w * w - 4 * w) / 2, t * t / 2)
    c2 = (w, 3 * t - 2, 3 * w - 2, t)
    h_d = h_q = h_dd = h_dq = h_qq = 0.0
    for j in range(4):
        f = f1 = f2 = 0.0
        for k in range(4):
            value = spline[row + j, column + k]
            f += c[k] * value
            f1 += c1[k] * value
            f2 += c2[k] * value
        h_d += b1[j] * f
        h_q += b[j] * f1
        h_dd += b2[j] * f
        h_dq += b1[j] * f1
        h_qq += b[j] * f2
    m, n = e.cells_per_wb_d, e.cells_per_wb_q
    return m * h_d, side * n * h_q, m * m * h_dd, side * m * n * h_dq, n * n * h_qq


@inlined
def current(e: Energy, spline: Array, psi_d: float, psi_q: float) -> tuple[float, float]:
    """i = grad H(psi), continuous everywhere: (i_d, i_q) [A]."""
    clamped_d = min(max(psi_d, e.low_d), e.high_d)
    clamped_q = min(max(psi_q, -e.high_q), e.high_q)
    if e.is_map:
        i_d, i_q, _, h_dq, _ = _spline_derivatives(e, spline, clamped_d, clamped_q)
    else:
        i_d, i_q, _, h_dq, _ = _polynomial_derivatives(e, clamped_d, clamped_q)
    # H(c) + grad H(c) e + e'Ke/2 with c the clamped point and e = psi - c: c moves with psi along
    # the box, which is where the mixed derivative comes in.
    out_d, out_q = psi_d - clamped_d, psi_q - clamped_q
    return i_d + e.outside_d * out_d + h_dq * out_q, i_q + e.outside_q * out_q + h_dq * out_d


@inlined
def hessian(e: Energy, spline: Array, psi_d: float, psi_q: float) -> tuple[float, float, float]:
    """Hess H(psi) within the box: (h_dd, h_dq, h_qq) [1/H]."""
    if e.is_map:
        _, _, h_dd, h_dq, h_qq = _spline_derivatives(e, spline, psi_d, psi_q)
    else:
        _, _, h_dd, h_dq, h_qq = _polynomial_derivatives(e, psi_d, psi_q)
    return h_dd, h_dq, h_qq
