"""The polynomial energy: a motor that is one gives its coefficients back; one that is not is reported."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from orchestrator.analysis import PolynomialFit, fit_energy, fit_polynomial
from orchestrator.analysis._energy_polynomial import _inverted, terms_of
from tests.orchestrator.analysis.plant import L_D, L_Q, flux_for, saturated_current, saturated_hessian
from tests.orchestrator.analysis.test_energy_fit import PLACES, measured, paths
from tests.orchestrator.analysis.test_sweep import RATED_WB
from tests.support.close import assert_close

TRUE = {(2, 0): 0.5 / L_D, (0, 2): 0.5 / L_Q, (3, 0): 9.0, (1, 2): 6.0, (4, 0): 40.0, (2, 2): 40.0, (0, 4): 50.0}


@cache
def fitted(injected: bool = True, swept: bool = True) -> PolynomialFit:
    points, flux = measured() if injected else None, paths() if swept else ()
    return fit_polynomial(points, flux, fit_energy(points, flux), "test")


@pytest.mark.parametrize(
    ("injected", "swept"),
    [
        (True, True),
        pytest.param(True, False, marks=pytest.mark.slow),
        pytest.param(False, True, marks=pytest.mark.slow),
    ],
)
def test_the_motors_own_coefficients_are_found(injected: bool, swept: bool) -> None:
    fit = fitted(injected, swept)
    assert fit.degree == 4
    assert set(fit.terms) == set(TRUE)
    for term, value, std in zip(fit.terms, fit.coefficients, fit.std, strict=True):
        assert abs(value - TRUE[term]) < 4.0 * std
        assert std < 0.1 * abs(TRUE[term])


@pytest.mark.slow
def test_flux_and_inductance_are_the_motors() -> None:
    fit = fitted()
    flux, std = fit.flux(PLACES)
    off = flux - flux_for(PLACES, saturated_current)
    assert np.abs(off).max() < 2e-3 * RATED_WB
    assert 0.1 < np.sqrt((off**2).mean() / (std**2).mean()) < 3.0
    truth = np.linalg.inv(saturated_hessian(flux_for(PLACES, saturated_current)))[:, [0, 0, 1], [0, 1, 1]]
    assert np.abs(fit.inductance(PLACES)[0] - truth).max() < 3e-3 * truth.max()


@pytest.mark.slow
def test_stated_errors_are_those_of_finite_differences() -> None:
    fit = fitted()
    for axis, e in enumerate(1e-4 * np.eye(2)):
        slope = (fit.flux(PLACES + e)[0] - fit.flux(PLACES - e)[0]) / 2e-4
        assert_close(slope, fit.inductance(PLACES)[0][:, axis : axis + 2], 2e-5)


@pytest.mark.parametrize("terms", [terms_of(4), terms_of(6)])
def test_newton_finds_the_flux_of_every_current(terms: tuple[tuple[int, int], ...]) -> None:
    coefficients = np.array([TRUE.get(term, 10.0) for term in terms])
    plane = np.stack(np.meshgrid(np.linspace(-9, 9, 41), np.linspace(-9, 9, 41)), axis=-1).reshape(-1, 2)
    psi = _inverted(terms, coefficients, plane)
    assert np.isfinite(psi).all()
    if len(terms) == len(TRUE):
        assert_close(saturated_current(psi), plane, 1e-8)


def test_where_there_is_no_flux_there_is_none() -> None:
    terms = terms_of(3)
    folded = np.array([10.0, 7.0, -60.0, 0.0])
    assert np.isnan(_inverted(terms, folded, np.array([[3.0, 0.0]]))).all()
    assert np.isfinite(_inverted(terms, folded, np.array([[0.1, 0.0]]))).all()


def test_a_turned_axis_is_followed() -> None:
    angle = np.radians(3.0)
    points = measured(angle=angle)
    fit = fit_polynomial(points, (), fit_energy(points, ()), "test")
    assert np.degrees(fit.angle_rad) == pytest.approx(3.0, abs=0.15)
    assert fit.coefficients[2] == pytest.approx(9.0, rel=0.1)
