"""The map's band is as wide as maps scatter from one noise to the next."""

from __future__ import annotations

import numpy as np

from orchestrator.diagnosis.uncertainty.map_band import flux_rows, map_band_wb
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared

POINTS = np.array([[0.0, 0.0], [1.5, 0.0], [-1.5, 0.5], [0.0, 1.5], [1.0, 1.0]])


def test_rows_give_the_flux_less_its_mean() -> None:
    maker = fitter(prepared(plan(sparse=True)))
    fit = maker.fit(free_model())
    psi = fit.model.magnetics.flux_and_inductance(POINTS)[0]
    expected = (psi - psi.mean(axis=0)).ravel()
    np.testing.assert_allclose(flux_rows(fit, POINTS) @ fit.model.magnetics.coefficients, expected, rtol=1e-9)


def test_the_band_is_as_wide_as_noise_moves_the_map() -> None:
    fluxes, bands = [], []
    for seed in range(8):
        fit = fitter(prepared(plan(sparse=True), seed=seed)).fit(free_model())
        psi = fit.model.magnetics.flux_and_inductance(POINTS)[0]
        fluxes.append((psi - psi.mean(axis=0)).ravel())
        bands.append(map_band_wb(fit, POINTS))
    scatter = float(np.sqrt(np.mean(np.var(fluxes, axis=0, ddof=1))))
    # 80 numbers of few degrees of freedom: their scatter is known to a third.
    assert 0.6 < 1.96 * scatter / np.mean(bands) < 1.6
