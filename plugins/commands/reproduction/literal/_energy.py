"""The paper's polynomial energy, fitted to second derivatives alone and, for comparison, to first ones.

    H(x, y) = x^2 / 2 L_d + y^2 / 2 L_q + a_30 x^3 + a_12 x y^2 + a_40 x^4 + a_22 x^2 y^2 + a_04 y^4

"It is numerically better to fit the derivatives of a function than the function itself" (Combes, Malrait, Martin,
Rouchon, section "Experimental results" of the proposed method): H_kl by injection needs no integral. The
terms are those of A. K. Jebai et al., doi:10.1109/CDC.2014.7040330.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orchestrator.analysis import PolynomialFit
from orchestrator.numerics.types import Array

TERMS = ((2, 0), (0, 2), (3, 0), (1, 2), (4, 0), (2, 2), (0, 4))


def fitted_to_second_derivatives(current: Array, hessian: Array) -> PolynomialFit:
    """Energy fitted to measured Hessians, shape (n, 2, 2) [A/Wb], at currents, shape (n, 2)."""
    measured = _entries(hessian)

    def residual_of(energy: PolynomialFit) -> Array:
        dd, dq, qq = energy.inductance(current)[0].T
        matrix = np.stack([np.stack([dd, dq], axis=1), np.stack([dq, qq], axis=1)], axis=1)
        return _entries(np.linalg.inv(matrix)) - measured

    return _least_squares(residual_of, current, _first_guess(current, hessian))


def fitted_to_flux(current: Array, psi: Array, start: PolynomialFit) -> PolynomialFit:
    """Energy fitted to integrated flux, shape (n, 2) [Wb], from another fit as start."""
    return _least_squares(lambda energy: energy.flux(current)[0] - psi, current, start.coefficients)


def _entries(matrix: Array) -> Array:
    return np.stack([matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]], axis=1)


def _first_guess(current: Array, hessian: Array) -> Array:
    """Start: the linear motor at zero current, with x^4 and y^4 terms for convexity at all currents."""
    middle = hessian[np.argmin(np.linalg.norm(current, axis=1))]
    coefficients = np.zeros(len(TERMS))
    coefficients[:2] = 0.5 * np.diag(middle)
    coefficients[[4, 6]] = 0.01 * _sizes(current, coefficients)[[4, 6]]
    return coefficients


def _sizes(current: Array, coefficients: Array) -> Array:
    """Scale of each coefficient: its term equals the quadratic ones at the largest current."""
    stiffness, largest_a = float(coefficients[:2].sum()), float(np.abs(current).max())
    return np.array([stiffness * (stiffness / largest_a) ** (m + n - 2) for m, n in TERMS])


def _least_squares(residual_of: Callable[[PolynomialFit], Array], current: Array, start: Array) -> PolynomialFit:
    from scipy.optimize import least_squares

    scale = _sizes(current, start)

    def residual(x: Array) -> Array:
        # Where the energy cannot be inverted the flux is NaN, which counts as a large residual.
        return np.nan_to_num(residual_of(_energy(scale * x)), nan=1e6).ravel()

    return _energy(scale * least_squares(residual, start / scale, x_scale="jac").x)


def _energy(coefficients: Array) -> PolynomialFit:
    none = np.zeros((len(TERMS), len(TERMS)))
    return PolynomialFit(TERMS, coefficients, none, 0.0, float("nan"), float("nan"), {})
