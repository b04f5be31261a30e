from __future__ import annotations

import numpy as np
import pytest

from orchestrator.numerics.tensor_spline import EvenSpline
from tests.orchestrator.analysis.plant import Array

RANDOM = np.random.default_rng(3)
AT = RANDOM.uniform(-1.9, 1.9, (60, 2))


EVERYWHERE = RANDOM.uniform((-3.0, -4.0), (2.0, 4.0), (600, 2))


def fitted(spline: EvenSpline, values: Array) -> Array:
    return np.asarray(np.linalg.lstsq(spline.rows(EVERYWHERE, 0, 0), values, rcond=None)[0])


@pytest.mark.parametrize("cells", [(7, 8), (4, 5)])
def test_the_function_is_even_and_its_derivatives_are_its_own(cells: tuple[int, int]) -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, cells)
    c = RANDOM.normal(size=spline.size)
    mirrored = AT * np.array([1.0, -1.0])
    np.testing.assert_allclose(spline.rows(AT, 0, 0) @ c, spline.rows(mirrored, 0, 0) @ c, atol=1e-12)
    np.testing.assert_allclose(spline.rows(AT, 1, 1) @ c, -spline.rows(mirrored, 1, 1) @ c, atol=1e-12)
    for m, n in ((0, 0), (1, 1), (0, 2)):
        for step, order in ((np.array([1e-4, 0.0]), (m + 1, n)), (np.array([0.0, 1e-4]), (m, n + 1))):
            slope = (spline.rows(AT + step, m, n) - spline.rows(AT - step, m, n)) @ c / 2e-4
            np.testing.assert_allclose(spline.rows(AT, *order) @ c, slope, atol=1e-5)


def test_polynomials_that_are_even_and_of_low_degree_have_no_roughness() -> None:
    spline = EvenSpline(-3.0, 2.0, 4.0, (3, 4))
    x, y = EVERYWHERE.T
    eigenvalues = np.linalg.eigvalsh(spline.roughness)
    assert (eigenvalues[: spline.smooth] < 1e-9 * eigenvalues[-1]).all()
    assert eigenvalues[spline.smooth] > 1e-9 * eigenvalues[-1]
    quartic = fitted(spline, 1.0 + x - x**3 * 2 + x**2 * y**2 + y**4)
    assert abs(quartic @ spline.roughness @ quartic) < 1e-6
    rough = fitted(spline, x**5)
    assert rough @ spline.roughness @ rough > 1.0


def test_roughness_does_not_depend_on_the_unit() -> None:
    one, other = EvenSpline(-3.0, 2.0, 4.0, (3, 4)), EvenSpline(-3000.0, 2000.0, 4000.0, (3, 4))
    np.testing.assert_allclose(one.roughness, other.roughness, rtol=1e-6, atol=1e-6 * one.roughness.max())
