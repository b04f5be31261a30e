"""The paper's polynomial from derivatives that are known."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.analysis import PolynomialFit
from plugins.commands.reproduction.literal._energy import TERMS, fitted_to_flux, fitted_to_second_derivatives

TRUE = PolynomialFit(
    TERMS, np.array([11.5, 7.2, 8.0, 6.0, 400.0, 150.0, 90.0]), np.zeros((7, 7)), 0.0, np.nan, np.nan, {}
)
CURRENT = np.array([[d, q] for d in np.linspace(-3.0, 3.0, 9) for q in np.linspace(-3.0, 3.0, 9)])


def hessians() -> np.ndarray:
    dd, dq, qq = TRUE.inductance(CURRENT)[0].T
    return np.linalg.inv(np.moveaxis(np.array([[dd, dq], [dq, qq]]), -1, 0))


def test_second_derivatives_give_the_coefficients_back() -> None:
    found = fitted_to_second_derivatives(CURRENT, hessians())
    assert found.coefficients == pytest.approx(TRUE.coefficients, rel=1e-5)


def test_the_flux_gives_the_coefficients_back() -> None:
    start = fitted_to_second_derivatives(CURRENT, 1.02 * hessians())
    found = fitted_to_flux(CURRENT, TRUE.flux(CURRENT)[0], start)
    assert found.coefficients == pytest.approx(TRUE.coefficients, rel=1e-5)
