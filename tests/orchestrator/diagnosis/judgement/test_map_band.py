"""The map's errors: as wide as maps scatter from one noise to the next, and wider by what the model might lack."""

from __future__ import annotations

import numpy as np

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.judgement.map_band import AbsentEffect, MapUncertainty, flux_rows
from plugins.effects.resistance import WindingHeating
from plugins.effects.sensors import CurrentGainMismatch
from plugins.effects.timing import CurrentFilter, VoltageDelay
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import L_D, L_Q, fitter, free_model, plan, prepared, with_effects

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
        maker = fitter(prepared(plan(sparse=True), seed=seed))
        fit = maker.fit(free_model())
        psi = fit.model.magnetics.flux_and_inductance(POINTS)[0]
        fluxes.append((psi - psi.mean(axis=0)).ravel())
        bands.append(MapUncertainty.of(maker, fit).band_wb(POINTS))
    scatter = float(np.sqrt(np.mean(np.var(fluxes, axis=0, ddof=1))))
    # 80 numbers of few degrees of freedom: their scatter is known to a third.
    assert 0.6 < 1.96 * scatter / np.mean(bands) < 1.6


def test_r_s_and_map_are_no_surer_for_effects_that_may_be_there() -> None:
    maker = fitter(prepared(plan()))
    fit = maker.fit(free_model())
    library = scaled_library([CurrentGainMismatch(), VoltageDelay(), WindingHeating()], maker.prepared.manifest)
    plain, aware = MapUncertainty.of(maker, fit), MapUncertainty.of(maker, fit, library)
    # Asking for the absent effects' columns solves for R_s and the map once more: a little is rounding.
    less = 0.999 * plain.of_map(POINTS)
    assert (aware.of_map(POINTS) >= less - 1e-6 * less.max(axis=0)).all()
    assert aware.resistance_ohm >= 0.999 * plain.resistance_ohm
    assert all(0.0 <= one.probability <= 1.0 for one in aware.absent)


def test_an_effect_that_was_left_out_lies_within_what_it_might_do() -> None:
    delay = VoltageDelay()
    maker = fitter(prepared(plan()))
    (candidate,) = scaled_library([delay], maker.prepared.manifest)
    truth = with_free(free_model(), maker, delay, delay_s=4e-6)
    back = [a.moved("delay_s", -a.standardised_value("delay_s")) for a in truth.active]
    late = fitter(with_effects(maker.prepared, back))
    without = late.fit(free_model())
    (absent,) = MapUncertainty.of(late, without, [candidate]).absent
    assert absent.probability > 0.99
    put = late.fit(without.model.with_active([candidate.absent()]))
    change = put.model.magnetics.coefficients - without.model.magnetics.coefficients
    np.testing.assert_allclose(absent.shift[0], put.model.r_s - without.model.r_s, atol=0.1 * abs(absent.shift).max())
    flux = flux_rows(without, POINTS)
    expected = flux @ change
    np.testing.assert_allclose(flux @ absent.shift[1:], expected, atol=0.1 * np.abs(expected).max())


def test_inductances_of_the_truth_lie_within_their_errors() -> None:
    maker = fitter(prepared(plan(), seed=3))
    fit = maker.fit(free_model())
    found = fit.model.magnetics.flux_and_inductance(POINTS)[1]
    spreads = MapUncertainty.of(maker, fit).of_map(POINTS)[:, 2:]
    assert (np.abs(found - np.array([L_D, 0.0, L_Q])) <= 5.0 * spreads).all()


def test_what_would_have_to_be_less_than_nothing_is_not_there() -> None:
    """A lag of the sensors is none below zero: a lead of the readings is somebody else's."""
    lag = CurrentFilter()
    maker = fitter(prepared(plan()))
    (candidate,) = scaled_library([lag], maker.prepared.manifest)

    def absent_effect_beside(delay_s: float) -> AbsentEffect:
        truth = with_free(free_model(), maker, VoltageDelay(), delay_s=delay_s)
        other = fitter(with_effects(maker.prepared, truth.active))
        (absent,) = MapUncertainty.of(other, other.fit(free_model()), [candidate]).absent
        return absent

    both = absent_effect_beside(4e-6), absent_effect_beside(-4e-6)
    one_way, other_way = sorted(both, key=lambda absent: absent.probability)
    assert other_way.probability > 0.99
    assert one_way.probability < 0.2
    assert np.abs(one_way.shift).max() == 0.0
