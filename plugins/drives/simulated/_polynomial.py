"""The paper's polynomial energy: given coefficients, or typical saturation scaled to a nameplate.

Per unit of the motor's flux, x = (psi_d - psi_M) / (L_d I) and y = psi_q / (L_q I) with I the
rated current,

    H / I^2 = L_d (x^2/2 + s_d u_d(x)) + L_q (y^2/2 + s_q u_q(y)) + sqrt(L_d L_q) s_c (x y^2 + 0.7 x^2 y^2),

so that one shape serves every size; the three strengths are solved for the specified falls of
inductance. The form is that of Jebai, Combes, Malrait, Martin and Rouchon (energy-based modelling
of saturated PMSMs, CDC 2014), with a sixth power on each axis.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from plugins.drives.simulated._energy import Array, Energy, Magnetics, hessian
from plugins.drives.simulated._inverse import flux_at
from plugins.drives.simulated.options import NameplateMagnetics
from protocols import InputError

OPTION_KEY = "drive.plant.magnetics"
COEFFICIENTS = ("a30", "a12", "a40", "a22", "a04", "a60", "a06")


def polynomial_energy(psi_m: float, l_d: float, l_q: float, poly: Array, reach_a: float) -> Magnetics:
    """Energy with these `COEFFICIENTS`, valid up to `reach_a` on each axis.

    Raises
    ------
    InputError
        Where H is not convex there, so that a current would have two fluxes.
    """
    energy = _energy(psi_m, l_d, l_q, poly)
    d_axis, q_axis = np.array([[-reach_a, 0.0], [reach_a, 0.0]]), np.array([[0.0, reach_a]])
    try:
        low, high = (float(psi[0]) - psi_m for psi in flux_at(energy, d_axis))
        high_q = float(flux_at(energy, q_axis)[0, 1])
    except ValueError as error:
        raise InputError(OPTION_KEY, "", f"the energy is not convex: {error}") from None
    box = (psi_m + low, psi_m + high, high_q)
    corners = [hessian(*energy, d, high_q) for d in box[:2]] + [hessian(*energy, d, 0.0) for d in box[:2]]
    outside = (max(c[0] for c in corners), max(c[2] for c in corners))
    for d in np.linspace(box[0], box[1], 25):
        for q in np.linspace(0.0, high_q, 25):
            h_dd, h_dq, h_qq = hessian(*energy, float(d), float(q))
            if h_dd <= 0 or h_qq <= 0 or h_dd * h_qq <= h_dq**2:
                raise InputError(OPTION_KEY, "", f"the energy is not convex at psi = ({d:.4g}, {q:.4g}) Wb")
    bounded = energy.energy._replace(
        low_d=box[0], high_d=box[1], high_q=high_q, outside_d=outside[0], outside_q=outside[1]
    )
    return Magnetics(bounded, energy.spline)


def nameplate_energy(options: NameplateMagnetics, psi_m: float, l_d: float, l_q: float, rated_a: float) -> Magnetics:
    """Energy whose inductances fall as the options specify, for a motor of any size."""
    from scipy.optimize import least_squares

    unit = (l_d * rated_a, l_q * rated_a)
    target = np.array([options.d_fall, options.q_fall, options.cross])
    is_nonzero = target > 0.0

    def coefficients(strengths_above_zero: Array) -> Array:
        strengths = np.zeros(3)
        strengths[is_nonzero] = strengths_above_zero
        return _scaled(strengths, unit, l_d, l_q, rated_a)

    def residual(strengths_above_zero: Array) -> Any:
        energy = _energy(psi_m, l_d, l_q, coefficients(strengths_above_zero))
        r = rated_a / np.sqrt(2.0)
        psi = flux_at(energy, np.array([[1.25 * rated_a, 0.0], [0.0, 1.25 * rated_a], [r, r]]))
        h = [hessian(*energy, float(d), float(q)) for d, q in psi]
        fall_d = 1.0 - h[0][2] / (h[0][0] * h[0][2] - h[0][1] ** 2) / l_d
        fall_q = 1.0 - h[1][0] / (h[1][0] * h[1][2] - h[1][1] ** 2) / l_q
        cross = h[2][1] / (h[2][0] * h[2][2] - h[2][1] ** 2) / np.sqrt(l_d * l_q)
        return (np.array([fall_d, fall_q, cross]) - target)[is_nonzero]

    values = np.zeros(0)
    if is_nonzero.any():
        start = np.array([0.5, 0.8, 0.15])[is_nonzero]
        solution = least_squares(residual, start, bounds=(0.0, 20.0), xtol=1e-12, ftol=1e-12)
        if float(np.abs(solution.fun).max()) > 1e-3:
            raise InputError(OPTION_KEY, "", "no energy of this form has these d_fall, q_fall and cross together")
        values = solution.x
    return polynomial_energy(psi_m, l_d, l_q, coefficients(values), 3.0 * rated_a)


def _scaled(strengths: Array, unit: tuple[float, float], l_d: float, l_q: float, rated_a: float) -> Array:
    """Coefficients of the per-unit form in A and Wb, in the order of `COEFFICIENTS`."""
    s_d, s_q, s_c = strengths
    x, y = unit
    d, q, c = l_d * rated_a**2, l_q * rated_a**2, np.sqrt(l_d * l_q) * rated_a**2
    return np.array(
        [
            s_d * d * 0.05 / x**3,
            s_c * c / (x * y**2),
            s_d * d * 0.04 / x**4,
            0.7 * s_c * c / (x * y) ** 2,
            s_q * q * 0.08 / y**4,
            s_d * d * 0.004 / x**6,
            s_q * q * 0.006 / y**6,
        ]
    )


def _energy(psi_m: float, l_d: float, l_q: float, poly: Array) -> Magnetics:
    """The energy with these coefficients, in an unbounded box."""
    coefficients = dict(zip(COEFFICIENTS, poly.tolist(), strict=True))
    energy = Energy(is_map=False, psi_m=psi_m, inverse_l_d=1.0 / l_d, inverse_l_q=1.0 / l_q, **coefficients)
    return Magnetics(energy, np.zeros((4, 4)))
