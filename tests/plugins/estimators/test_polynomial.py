"""The polynomial energy against the motor's own map and the flexible energy."""

from __future__ import annotations

import numpy as np
import pytest

from plugins.estimators.polynomial import PolynomialEstimator
from protocols import EstimationContext
from tests.plugins.estimators.recordings import (
    classical_of,
    clean,
    flux_error_percent,
    injection_of,
)
from tests.plugins.estimators.test_energy import energy_of


def test_the_polynomial_gives_its_coefficients_and_says_how_good_it_is() -> None:
    context = EstimationContext((injection_of(False), classical_of(False), energy_of(False)))
    found = PolynomialEstimator().estimate(clean(), context)
    assert found.map.method == "polynomial"
    rms, worst = flux_error_percent(found.map)
    assert rms < 0.1
    assert worst < 0.3
    inside = np.isfinite(energy_of(False).map.psi_d)
    assert np.isfinite(found.map.psi_d[inside]).all()
    assert found.form is not None
    coefficients = {one.name: one for one in found.form.coefficients}
    assert coefficients["alpha30"].unit == "A/Wb^2"
    assert coefficients["L_d"].value == pytest.approx(0.0432, abs=3.0 * coefficients["L_d"].std + 5e-4)
    (goodness,) = found.remarks
    assert goodness.values["off_percent"] == pytest.approx(0.05, abs=0.05)
