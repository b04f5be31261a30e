"""The fit: R_s and the map come out, the objective falls, and its gradient is what finite differences say."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.candidates import EffectTerm, scaled_library
from orchestrator.diagnosis.fitting.fit import COLUMNS_PER_EVALUATION, Fitter, fit_with_frozen_jacobian
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.numerics.frames import from_two_phases, to_phases
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.sensors import CurrentNonlinearity
from protocols import Contrast, Correction, Effect, EffectLayer, EffectParameters, Signals, amplitude
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


def test_a_shape_far_away_is_reached_along_a_curved_valley() -> None:
    made, true = prepared(plan()), {"voltage_v": 2.0, "threshold_a": 0.2, "softness": 0.2}
    maker = fitter(with_voltage(made, {p.segment.id: _lost(p.signals, **true) for p in made.pieces}))
    (rigid,) = with_free(free_model(), maker, DeadTime(), voltage_v=0.5).active
    fit = maker.fit(free_model().with_active([rigid.release("threshold_a", "softness")]))
    (active,) = fit.model.active
    ahead = active.moved("threshold_a", active.standardised_value("threshold_a") + 1.0)
    again = maker.fit(fit.model.with_active([ahead]), fit.linearisation)
    assert again.objective == pytest.approx(fit.objective, abs=1.0)
    assert again.model.active[0].values["threshold_a"] == pytest.approx(active.values["threshold_a"], rel=1e-3)


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
    assert one <= start
    assert more <= one


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


@pytest.fixture(scope="module")
def maker() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, -0.1])))


def test_both_descents_end_in_the_same_place(maker: Fitter) -> None:
    model = with_free(free_model(), maker, VoltageBias())
    anew = maker.fit(model, steps=8, relinearisations=3, tolerance=1e-6)
    kept = fit_with_frozen_jacobian(maker, model, rounds=10, tolerance=1e-6)
    assert kept.objective == pytest.approx(anew.objective, rel=1e-3)
    for name in ("bias_a_v", "bias_b_v"):
        assert kept.model.active[0].values[name] == pytest.approx(anew.model.active[0].values[name], rel=0.01)


def test_more_rounds_do_not_climb(maker: Fitter) -> None:
    model = with_free(free_model(), maker, VoltageBias())
    ends = [fit_with_frozen_jacobian(maker, model, rounds=rounds, tolerance=1e-4).objective for rounds in (0, 1, 3)]
    assert all(after <= before for before, after in itertools.pairwise(ends))
    assert ends[-1] < 0.01 * ends[0]


def test_a_model_without_effects_is_evaluated(maker: Fitter) -> None:
    fit = fit_with_frozen_jacobian(maker, free_model(), rounds=3, tolerance=1e-4)
    assert fit.objective == pytest.approx(maker.evaluate(free_model(), maker.linearise(free_model())).objective)


def test_what_is_taken_from_an_earlier_fit_leads_to_the_same_place(maker: Fitter) -> None:
    model = with_free(free_model(), maker, VoltageBias())
    first = fit_with_frozen_jacobian(maker, model, rounds=1, tolerance=1e-6)
    away = model.with_active([model.active[0].moved("bias_a_v", 5.0)])
    known = fit_with_frozen_jacobian(maker, away, rounds=10, tolerance=1e-6, known=first)
    anew = fit_with_frozen_jacobian(maker, away, rounds=10, tolerance=1e-6)
    assert known.objective == pytest.approx(anew.objective, rel=1e-3)


class BentBias:
    """A voltage along alpha that hardly grows beyond a tenth of its typical size: the secant from nothing is flat."""

    name: ClassVar[str] = "bent_bias"
    summary: ClassVar[str] = "A voltage that soon stops growing."
    signature: ClassVar[str] = "A constant residual."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        size: float = amplitude("1", typical=1.0, prior_width=1.0, low=0.0, high=4.0)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        return Correction(v_ab=signals.v_ab - [0.5 * float(np.tanh(10.0 * p.size)), 0.0])


def test_an_amplitude_that_is_no_multiple_of_its_secant_is_reached() -> None:
    maker = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.15, 0.0])))
    begun = with_free(free_model(), maker, BentBias())
    reached = fit_with_frozen_jacobian(maker, begun, rounds=10, tolerance=1e-4)
    assert 0.5 * np.tanh(10.0 * reached.model.active[0].values["size"]) == pytest.approx(0.15, rel=0.02)


def test_steps_that_a_new_frame_undoes_are_not_made_again_and_again(maker: Fitter) -> None:
    tried: list[float] = []

    @dataclass
    class Undoing(Fitter):
        def relinearise(self, model: Model, *args: Any, **known: Any) -> Fit:
            made = super().relinearise(model, *args, **known)
            tried.append(made.model.active[0].values["bias_a_v"])
            return replace(made, objective=made.objective + (1e9 if len(tried) > 1 else 0.0))

    undoing = Undoing(maker.prepared, maker.noise, maker.pm_flux_wb)
    fit = fit_with_frozen_jacobian(undoing, with_free(free_model(), maker, VoltageBias()), rounds=20, tolerance=1e-4)
    assert fit.model.active[0].values["bias_a_v"] == 0.0
    assert 1 < len(tried) < 8
