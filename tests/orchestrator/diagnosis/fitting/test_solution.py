"""What is linear is solved for exactly: the residual is at right angles to R_s and the map, prior included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Model
from tests.orchestrator.diagnosis.pieces import R_S, fitter, free_model, plan, prepared


@pytest.fixture(scope="module")
def clean() -> Fitter:
    return fitter(prepared(plan()))


def test_residual_is_orthogonal_to_what_was_solved_for(clean: Fitter) -> None:
    fit = clean.evaluate(model := free_model(), clean.linearise(model))
    parts = zip(clean.prepared.pieces, fit.linearisation.pieces, fit.resistance, fit.residual, strict=True)
    training = [(r, f.white_basis, e) for p, f, r, e in parts if not p.held_out]
    drop = sum(float(r @ e) for r, _, e in training)
    assert abs(drop) < 1e-6 * sum(float(np.abs(r) @ np.abs(e)) for r, _, e in training)
    pull = sum((b.T @ e for _, b, e in training), np.zeros(model.space.grid.size))
    held = model.space.prior.T @ (model.space.prior @ fit.model.magnetics.coefficients)
    np.testing.assert_allclose(pull + held, 0.0, atol=1e-6 * float(np.abs(pull).max()))


def test_a_model_that_is_held_keeps_its_resistance_and_map(clean: Fitter) -> None:
    model = Model(free_model().space, free_model().magnetics, 1.01 * R_S)
    held = clean.hold(model)
    assert held.model.r_s == model.r_s
    np.testing.assert_array_equal(held.model.magnetics.coefficients, model.magnetics.coefficients)
    assert held.chi2 > clean.fit(model).chi2


def test_the_start_does_not_matter_to_what_is_linear(clean: Fitter) -> None:
    near = free_model()
    far = Model(near.space, near.magnetics, 1.3 * R_S)
    one, other = clean.fit(near), clean.fit(far)
    assert other.model.r_s == pytest.approx(one.model.r_s, rel=1e-5)
    at = np.array([[0.0, 0.0], [1.5, 0.0], [0.0, 1.5], [-1.0, 1.0]])
    (psi, _), (again, _) = (fit.model.magnetics.flux_and_inductance(at) for fit in (one, other))
    np.testing.assert_allclose(again - again[0], psi - psi[0], atol=1e-3 * float(np.ptp(psi)))


def test_a_resistance_that_was_measured_before_is_held_as_far_as_it_says(clean: Fitter) -> None:
    def solved(std: float) -> float:
        manifest = clean.prepared.manifest
        motor = manifest.motor.model_copy(
            update={"stator_resistance_ohm": 1.02 * R_S, "stator_resistance_std_ohm": std * R_S}
        )
        reported = replace(clean.prepared, manifest=manifest.model_copy(update={"motor": motor}))
        return replace(clean, prepared=reported).fit(free_model()).model.r_s / R_S

    alone = clean.fit(free_model()).model.r_s / R_S
    assert solved(1e-7) == pytest.approx(1.02, abs=1e-6)
    assert solved(10.0) == pytest.approx(alone, abs=1e-6)
