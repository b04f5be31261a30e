"""One step within bounds: exact where all is linear, and never beyond what a parameter may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.gauss_newton import bounded_step, is_stuck, midway, moved_by, newton_step, reach
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.resistance import WindingHeating
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage


@pytest.fixture(scope="module")
def maker() -> Fitter:
    return fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, -0.1])))


def test_one_step_brings_what_is_linear_to_its_end_and_keeps_its_promise(maker: Fitter) -> None:
    model = with_free(free_model(), maker, VoltageBias())
    fit = maker.evaluate(model, maker.linearise(model))
    move, promised = newton_step(fit, fit.projected(), 0.0)
    after = maker.evaluate(moved_by(fit.model, move), fit.linearisation)
    assert fit.objective - after.objective == pytest.approx(promised, rel=1e-3)
    assert newton_step(after, after.projected(), 0.0)[1] < 1e-4 * promised


def test_damping_shortens_the_step(maker: Fitter) -> None:
    model = with_free(free_model(), maker, VoltageBias())
    fit = maker.evaluate(model, maker.linearise(model))
    lengths = [float(np.linalg.norm(newton_step(fit, fit.projected(), damping)[0])) for damping in (0.0, 1.0, 10.0)]
    assert lengths[0] > lengths[1] > lengths[2] > 0.0


def test_a_parameter_at_its_bound_stays_and_the_others_move_as_if_it_were_fixed(maker: Fitter) -> None:
    (active,) = with_free(free_model(), maker, VoltageBias()).active
    low = active.candidate.named("bias_b_v").low
    at_bound = replace(active, values={**active.values, "bias_b_v": low})
    model = free_model().with_active([at_bound])
    fit = maker.evaluate(model, maker.linearise(model))
    own, right = fit.projected()
    right = right.copy()
    right[1] = 1e9  # drawn beyond the bound
    move, _ = newton_step(fit, (own, right), 0.0)
    assert move[1] == 0.0
    alone = -(right[0] + at_bound.standardised_value("bias_a_v")) / (own[0, 0] + 1.0)
    assert move[0] == pytest.approx(alone)


@pytest.mark.parametrize("size", [-1e6, 1e6])
def test_no_step_leaves_the_bounds(maker: Fitter, size: float) -> None:
    model = with_free(free_model(), maker, DeadTime())
    (moved,) = moved_by(model, np.full(len(model.free), size)).active
    for name in moved.free:
        p = moved.candidate.named(name)
        assert p.low <= moved.values[name] <= p.high
        assert is_stuck(moved, name, moved.standardised_value(name) + np.sign(size))
        assert not is_stuck(moved, name, moved.standardised_value(name) - np.sign(size))


def test_a_bounded_step_without_shapes_is_the_whole_step(maker: Fitter) -> None:
    model = with_free(free_model(), maker, VoltageBias())
    fit = maker.evaluate(model, maker.linearise(model))
    move, promised = bounded_step(fit, fit.projected(), 0.1)
    whole, same = newton_step(fit, fit.projected(), 0.0)
    np.testing.assert_allclose(move, whole, rtol=1e-6, atol=1e-9 * np.abs(whole).max())
    assert promised == pytest.approx(same, rel=1e-6)


def test_no_shape_moves_further_than_the_radius_and_less_is_promised(maker: Fitter) -> None:
    (active,) = with_free(free_model(), maker, DeadTime(), voltage_v=1.0).active
    model = free_model().with_active([active.release("threshold_a")])
    fit = maker.evaluate(model, maker.linearise(model))
    promises = []
    for radius in (0.01, 0.1, 1.0):
        move, promised = bounded_step(fit, fit.projected(), radius)
        assert abs(move[1]) <= radius * (1.0 + 1e-9)
        promises.append(promised)
    assert 0.0 <= promises[0] <= promises[1] <= promises[2]


def test_a_bounded_step_ends_at_the_bounds(maker: Fitter) -> None:
    (active,) = with_free(free_model(), maker, VoltageBias()).active
    fit = maker.evaluate(free_model().with_active([active]), maker.linearise(free_model()))
    own, right = fit.projected()
    move, _ = bounded_step(fit, (own, right + 1e12), 1.0)
    low, _ = reach(active, "bias_a_v")
    assert active.standardised_value("bias_a_v") + move[0] == pytest.approx(low)


def test_an_amplitude_that_goes_along_with_its_shape_keeps_to_the_valley_of_their_quotient(maker: Fitter) -> None:
    """As winding heat on a recording shorter than its time constant."""
    (active,) = with_free(free_model(), maker, WindingHeating(), rise_per_watt=1e-3, time_constant_s=200.0).active
    model = free_model().with_active([replace(active, free=("rise_per_watt", "time_constant_s"))])
    x, at = active.standardised_value("rise_per_watt"), active.standardised_value("time_constant_s")
    for step in (-1.0, 0.7):
        folds = np.log(active.moved("time_constant_s", at + step).values["time_constant_s"] / 200.0)
        (moved,) = moved_by(model, np.array([folds * x, step])).active
        assert moved.values["time_constant_s"] == pytest.approx(200.0 * np.exp(folds))
        quotient = moved.values["rise_per_watt"] / moved.values["time_constant_s"]
        assert quotient == pytest.approx(1e-3 / 200.0)


def test_an_amplitude_that_does_not_go_along_with_a_shape_moves_by_its_step(maker: Fitter) -> None:
    (active,) = with_free(free_model(), maker, WindingHeating(), rise_per_watt=1e-3, time_constant_s=200.0).active
    model = free_model().with_active([replace(active, free=("rise_per_watt", "time_constant_s"))])
    x = active.standardised_value("rise_per_watt")
    for by, step in ((0.5, -0.5), (0.5, 0.1), (0.5, 0.0), (0.0, 1.0)):
        (moved,) = moved_by(model, np.array([by * x, step])).active
        assert moved.values["rise_per_watt"] == pytest.approx((1.0 + by) * 1e-3)


def test_half_way_is_half_of_every_size_and_of_the_map(maker: Fitter) -> None:
    bare = free_model()
    other = with_free(bare, maker, VoltageBias(), bias_a_v=0.4)
    magnetics = replace(other.magnetics, coefficients=other.magnetics.coefficients + 2.0)
    half = midway(bare, replace(other, r_s=bare.r_s + 1.0, magnetics=magnetics))
    assert half.active[0].values["bias_a_v"] == pytest.approx(0.2)
    assert half.r_s == pytest.approx(bare.r_s + 0.5)
    np.testing.assert_allclose(half.magnetics.coefficients, bare.magnetics.coefficients + 1.0)
    again = midway(half, other)
    assert again.active[0].values["bias_a_v"] == pytest.approx(0.3)
