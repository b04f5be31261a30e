"""The fit: R_s and the map come out, the objective falls, and its gradient is what finite differences say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import EffectTerm, scaled_library
from orchestrator.diagnosis.fitting.fit import COLUMNS_PER_EVALUATION, OBJECTIVE_SLACK, Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.numerics.frames import from_two_phases, to_phases
from plugins.effects.frame import BrakeCompliance
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.sensors import CurrentNonlinearity
from protocols import Effect, Signals
from tests.orchestrator.diagnosis.pieces import (
    L_D,
    L_Q,
    R_S,
    Array,
    fitter,
    free_model,
    plan,
    prepared,
    with_voltage,
)

ERROR_V = np.array([0.3, -0.2])


def _bent(signals: Signals, square: float) -> Signals:
    """As two sensors read it that bend in one direction."""
    a, b, _ = to_phases(np.asarray(signals.i_ab)).T
    read = from_two_phases(a + square * a**2, b + square * b**2)
    return replace(signals, i_ab=read, i_m_ab=read)


def with_free(model: Model, maker: Fitter, effect: Effect, **values: float) -> Model:
    (candidate,) = scaled_library([effect], maker.prepared.manifest)
    active = candidate.absent()
    return model.with_active([EffectTerm(candidate, {**active.values, **values}, active.free)])


@pytest.fixture(scope="module")
def clean() -> Fitter:
    return fitter(prepared(plan()))


@pytest.fixture(scope="module")
def biased() -> Fitter:
    return fitter(with_voltage(prepared(plan()), ERROR_V))


def test_resistance_and_inductances_of_the_machine_are_found_and_noise_is_left(clean: Fitter) -> None:
    fit = clean.fit(free_model())
    assert fit.model.r_s == pytest.approx(R_S, rel=1e-3)
    inductance = fit.model.magnetics.flux_and_inductance(np.array([[0.0, 0.0], [1.5, 1.0]]))[1]
    np.testing.assert_allclose(inductance[:, [0, 2]], [[L_D, L_Q]] * 2, rtol=0.01)
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / fit.dof))


def test_what_was_held_out_is_noise_too(clean: Fitter) -> None:
    chi2 = clean.fit(free_model()).chi2_of(lambda p: p.held_out)
    assert chi2 == pytest.approx(1.0, abs=0.5)


def test_a_wrong_voltage_is_found_as_large_as_it_is(biased: Fitter) -> None:
    bare = biased.fit(free_model())
    fit = biased.fit(with_free(bare.model, biased, VoltageBias()))
    (active,) = fit.model.active
    assert active.values["bias_a_v"] == pytest.approx(ERROR_V[0], abs=0.005)
    assert active.values["bias_b_v"] == pytest.approx(-0.5 * ERROR_V[0] + np.sqrt(0.75) * ERROR_V[1], abs=0.005)
    assert bare.chi2_per_dof > 5.0
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / fit.dof))


def test_sensors_that_bend_evenly_are_found_without_a_cube() -> None:
    """Started from straight ones: the square has a column of its own there."""
    made, square = prepared(plan()), 2e-3
    read = [replace(p, signals=_bent(p.signals, square)) for p in made.pieces]
    maker = fitter(replace(made, pieces=tuple(read)))
    (active,) = maker.fit(with_free(free_model(), maker, CurrentNonlinearity())).model.active
    assert active.values["square_per_a"] == pytest.approx(square, rel=0.02)
    assert abs(active.values["cubic_per_a2"]) < 0.02 * square


def test_a_step_that_left_a_curved_valley_is_led_back_to_it() -> None:
    made, true = prepared(plan()), {"voltage_v": 2.0, "threshold_a": 0.2, "softness": 0.2}
    maker = fitter(with_voltage(made, {p.segment.id: _lost(p.signals, **true) for p in made.pieces}))
    model = with_free(free_model(), maker, DeadTime(), voltage_v=0.5)
    (rigid,) = model.active
    fit = maker.fit(model.with_active([rigid.release("threshold_a", "softness")]))
    (active,) = fit.model.active
    ahead = active.moved("threshold_a", active.standardised_value("threshold_a") + 1.0)
    trial = maker.evaluate(fit.model.with_active([ahead]), fit.linearisation)
    wanted = 0.5 * (trial.objective + fit.objective)
    back = maker.correct_step(trial, wanted)
    assert back.objective < wanted < trial.objective
    assert maker.correct_step(fit, fit.objective + 1.0) is fit
    # What no step promises is not tried again and again.
    spent = maker.budget.spent
    hopeless = maker.correct_step(fit, fit.objective - 1e6)
    assert hopeless.objective <= fit.objective + OBJECTIVE_SLACK
    once = (len(fit.model.free) + COLUMNS_PER_EVALUATION) * _samples(maker)
    assert maker.budget.spent - spent <= once


def test_a_descent_that_does_not_bear_relinearisation_is_shortened(clean: Fitter) -> None:
    bare = clean.fit(free_model())
    twisted = with_free(bare.model, clean, BrakeCompliance(), rad_per_nm=0.02)
    far = clean.evaluate(twisted, clean.linearise(bare.model))
    plain = clean.relinearise(far.model, far.linearisation)
    shortened = clean.renewed(far, bare.objective)
    assert shortened.objective < 0.5 * plain.objective
    (active,) = shortened.model.active
    assert 0.0 < active.values["rad_per_nm"] < 0.02
    # What the new linearisation bears is not shortened.
    assert clean.renewed(far, plain.objective).model.active == far.model.active


def _samples(maker: Fitter) -> int:
    return sum(len(p.signals.v_dc) for p in maker.prepared.pieces)


def _lost(signals: Signals, **parameters: float) -> Array:
    """What the command has to have on top of the signals' own voltage for a dead time."""
    effect = DeadTime()
    left = effect.correct(signals, effect.Parameters(**parameters)).v_ab
    assert left is not None
    return np.asarray(signals.v_ab - left, dtype=np.float64)


@pytest.mark.parametrize("steps", [1, 2, 4])
def test_more_steps_never_raise_the_objective(biased: Fitter, steps: int) -> None:
    model = with_free(free_model(), biased, DeadTime(), voltage_v=-1.0)
    linearisation = biased.linearise(model)
    start = biased.evaluate(model, linearisation).objective
    one = biased.fit(model, linearisation, steps=steps, relinearisations=0).objective
    more = biased.fit(model, linearisation, steps=steps + 1, relinearisations=0).objective
    assert one <= start + OBJECTIVE_SLACK
    assert more <= one + OBJECTIVE_SLACK


def test_effort_counts_samples_and_columns_and_what_poll_raises_ends_the_fit() -> None:
    made = prepared(plan(sparse=True))
    samples = sum(len(p.signals.v_dc) for p in made.pieces)
    maker = fitter(made)
    maker.evaluate(model := free_model(), maker.linearise(model))
    assert maker.budget.spent == samples * COLUMNS_PER_EVALUATION

    def stop() -> None:
        raise KeyboardInterrupt

    maker.poll = stop
    with pytest.raises(KeyboardInterrupt):
        maker.fit(model)


def fitted_bias(maker: Fitter) -> Fit:
    return maker.fit(with_free(free_model(), maker, VoltageBias()))
