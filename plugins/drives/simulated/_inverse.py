"""psi(i): the inverse of i = grad H(psi), by Newton's method; not used in the step loop."""

from __future__ import annotations

import numpy as np

from plugins.drives.simulated._energy import Array, Energy, Magnetics, current, hessian
from plugins.drives.simulated._numba import kernel


@kernel
def _invert(e: Energy, spline: Array, i: Array, psi: Array) -> int:
    """Damped Newton from psi_M for each row; returns the first row without convergence, or -1."""
    for n in range(i.shape[0]):
        d, q = e.psi_m, 0.0
        i_d, i_q = current(e, spline, d, q)
        r_d, r_q = i[n, 0] - i_d, i[n, 1] - i_q
        scale = abs(i[n, 0]) + abs(i[n, 1]) + 1e-3
        for _ in range(200):
            if abs(r_d) + abs(r_q) <= 1e-13 * scale:
                break
            h_dd, h_dq, h_qq = hessian(e, spline, min(max(d, e.low_d), e.high_d), min(max(q, -e.high_q), e.high_q))
            if d < e.low_d or d > e.high_d:
                h_dd = e.outside_d
            if q < -e.high_q or q > e.high_q:
                h_qq = e.outside_q
            det = h_dd * h_qq - h_dq * h_dq
            if det <= 0.0 or h_dd <= 0.0:
                h_dq, det = 0.0, abs(h_dd) * abs(h_qq)
                h_dd, h_qq = abs(h_dd), abs(h_qq)
            step_d, step_q = (h_qq * r_d - h_dq * r_q) / det, (h_dd * r_q - h_dq * r_d) / det
            before = r_d * r_d + r_q * r_q
            length = 1.0
            for _ in range(30):
                i_d, i_q = current(e, spline, d + length * step_d, q + length * step_q)
                r_d, r_q = i[n, 0] - i_d, i[n, 1] - i_q
                if r_d * r_d + r_q * r_q < before:
                    break
                length *= 0.5
            else:
                break
            d += length * step_d
            q += length * step_q
        if abs(r_d) + abs(r_q) > 1e-8 * scale:
            return n
        psi[n, 0], psi[n, 1] = d, q
    return -1


def flux_at(magnetics: Magnetics, i_dq: Array) -> Array:
    """psi_dq [Wb], shape (n, 2), at the currents i_dq [A], shape (n, 2).

    Raises
    ------
    ValueError
        Where the energy has no flux for a current.
    """
    currents = np.ascontiguousarray(i_dq, dtype=np.float64)
    psi = np.empty_like(currents)
    missing = _invert(*magnetics, currents, psi)
    if missing >= 0:
        raise ValueError(f"no flux linkage found for i_dq = {currents[missing]} A")
    return psi
