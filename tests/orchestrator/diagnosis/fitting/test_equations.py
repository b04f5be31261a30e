"""A batch's equations: their columns are derivatives, and effects that are absent only add columns."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.equations import WeakFormEquations
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.weak_form.batches import SegmentBatch
from orchestrator.diagnosis.weak_form.equations import change_of_rows
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.numerics.frames import from_two_phases, to_dq
from plugins.effects.frame import BrakeCompliance
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.iron import EddyCurrents, Hysteresis
from plugins.effects.sampling import SamplingOffset
from plugins.effects.timing import VoltageDelay
from protocols import Effect, LossHistory, SegmentStage
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import (
    L_D,
    L_Q,
    MOTOR,
    PM_WB,
    R_S,
    TRUE_MAP,
    Plan,
    fitter,
    free_model,
    hold,
    plan,
    prepared,
    with_voltage,
)
from tests.support.close import assert_close


@pytest.fixture(scope="module")
def biased() -> Fitter:
    return fitter(with_voltage(prepared(plan()), np.array([0.3, -0.2])))


@pytest.mark.parametrize(
    ("effect", "values"),
    [(VoltageBias(), {"bias_a_v": 0.1}), (DeadTime(), {"voltage_v": 0.4}), (VoltageDelay(), {"delay_s": 5e-6})],
)
def test_gradient_of_the_objective_is_that_of_finite_differences(
    biased: Fitter, effect: Effect, values: dict[str, float]
) -> None:
    (name, _), *_ = values.items()
    fit = biased.evaluate(model := with_free(free_model(), biased, effect, **values), biased.linearise(model))
    k = [n for _, n in model.free].index(name)
    x, h = model.active[0].standardised_value(name), 1e-2 * abs(model.active[0].standardised_value(name))

    def objective(at: float) -> float:
        return biased.evaluate(model.with_active([model.active[0].moved(name, at)]), fit.linearisation).objective

    slope = (objective(x + h) - objective(x - h)) / (2.0 * h)
    # The column is a secant a twentieth of the size long, and an inverter's form bends.
    assert 2.0 * (fit.projected()[1][k] + x) == pytest.approx(slope, rel=0.05)


def test_columns_of_absent_effects_do_not_change_the_fit(biased: Fitter) -> None:
    bare = biased.fit(free_model())
    (candidate,) = scaled_library([VoltageBias()], biased.prepared.manifest)
    requested = biased.evaluate(bare.model, bare.linearisation, [(candidate.absent(), n) for n in candidate.amplitudes])
    assert requested.chi2 == pytest.approx(biased.evaluate(bare.model, bare.linearisation).chi2, rel=1e-12)
    assert requested.columns[0].shape[1] == 2


def test_a_frame_is_kept_as_far_as_the_model_did_not_move(biased: Fitter) -> None:
    model = free_model()
    equations, batch = biased.equations, SegmentBatch.of(biased.prepared.pieces[-2:])
    linearisation = equations.relinearise(model, batch, None).linearisation
    again = equations.relinearise(model, batch, linearisation).linearisation
    delayed = with_free(model, biased, VoltageDelay(), delay_s=1e-5)
    later = equations.relinearise(delayed, batch, linearisation).linearisation
    for first, second, third in zip(linearisation.pieces, again.pieces, later.pieces, strict=True):
        assert second.whitener is first.whitener
        assert second.white_basis is first.white_basis
        assert third.basis is first.basis


def test_what_readings_have_in_common_is_what_an_offset_of_all_of_them_does(biased: Fitter) -> None:
    model = with_free(free_model(), biased, DeadTime(), voltage_v=2.0)
    fit, equations, offset_a = biased.evaluate(model, biased.linearise(model)), biased.equations, 1e-4
    compared = []
    for linearisation in fit.linearisation.batches:
        common = equations.common(model, linearisation)
        for phase, one in enumerate(((1.0, 0.0), (0.0, 1.0))):
            off = linearisation.base.i_ab + offset_a * from_two_phases(*one)
            there = linearisation.with_changed(linearisation.base.changed_along({"i_ab": off}))
            before, after = (equations.rows(equations.at(model, f)) for f in (linearisation, there))
            for j, k in enumerate(linearisation.batch.places):
                moved = (after[j].white - before[j].white) @ np.array([1.0, model.r_s]) / offset_a
                if k < 8:
                    assert np.linalg.norm(common[j][:, phase] - moved) < 0.02 * np.linalg.norm(moved)
                    compared.append(k)
    assert sorted(compared) == sorted([*range(8)] * 2)


def test_a_resistance_below_nothing_loses_nothing(biased: Fitter) -> None:
    """On its way to where it fits R_s may be anything; effects take roots of a loss."""
    history = LossHistory(time_s=np.array([0.0, 1.0]), power_w=np.array([0.0, 5.0]))
    bare = biased.prepared.pieces[0]
    piece = replace(bare, signals=replace(bare.signals, losses=history))
    for r_s, power_w in ((-1.0, 0.0), (2.0 * R_S, 10.0)):
        model = replace(free_model(), r_s=r_s)
        (signals,) = biased.equations.relinearise(model, SegmentBatch.of([piece]), None).linearisation.base.segments
        assert signals.losses is not None
        assert signals.losses.power_w[-1] == pytest.approx(power_w)


@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_effects_see_the_flux_of_the_rotor_where_it_lies(angle: float) -> None:
    """A twist is the torque's, and the torque is that of the twisted rotor: both come out of one equation."""
    made = fitter(prepared([*plan(), Plan(SegmentStage.RESISTANCE, hold(-2.0, 2.0))], angle=angle, noise_a=0.0))
    model = with_free(free_model(), made, BrakeCompliance(), rad_per_nm=0.05)
    piece = made.prepared.pieces[-1]
    batch = SegmentBatch.of([piece])
    state = made.equations.at(model, made.equations.relinearise(model, batch, None).linearisation)
    i_d, i_q = map(float, to_dq(piece.signals.i_ab, angle)[-1])

    def torque_nm(delta: float) -> float:
        d, q = i_d * math.cos(delta) + i_q * math.sin(delta), i_q * math.cos(delta) - i_d * math.sin(delta)
        return 1.5 * MOTOR.pole_pairs * ((PM_WB + L_D * d) * q - L_Q * q * d)

    twist = brentq(lambda delta: delta - 0.05 * torque_nm(delta), -1.0, 1.0)
    assert state.cascade.corrected.theta_rad[-1] - angle == pytest.approx(twist, rel=1e-2)
    assert 0.05 * torque_nm(0.0) != pytest.approx(twist, rel=3e-2)


def test_effects_see_the_flux_of_the_current_that_magnetises() -> None:
    made = fitter(prepared(plan(sparse=True), noise_a=0.0))
    model = with_free(free_model(), made, EddyCurrents(), core_loss_ohm=300.0)
    piece = made.prepared.pieces[-1]
    state = made.equations.at(model, made.equations.relinearise(model, SegmentBatch.of([piece]), None).linearisation)
    magnetising = TRUE_MAP.flux_and_inductance(to_dq(state.cascade.corrected.i_m_ab, 0.0))[0] + np.array([PM_WB, 0.0])
    of_all = TRUE_MAP.flux_and_inductance(to_dq(piece.signals.i_ab, 0.0))[0] + np.array([PM_WB, 0.0])
    seen = state.linearisation.base.psi_ab
    assert seen is not None
    apart = np.abs(of_all - magnetising).max()
    assert apart > 1e-3 * np.ptp(of_all)
    assert_close(seen, magnetising, 1e-6, of=apart)


def test_what_iron_may_remember_is_expected_as_noise() -> None:
    made = fitter(prepared(plan(sparse=True)))
    model = with_free(free_model(), made, Hysteresis(), half_width_a=0.5)
    piece = next(p for p in made.prepared.pieces if p.stage is SegmentStage.CLASSICAL)
    batch = SegmentBatch.of([piece])
    state = made.equations.at(model, made.equations.relinearise(model, batch, None).linearisation)
    plain = made.equations.relinearise(free_model(), batch, None)
    aware, bare = (s.linearisation.pieces[0].whitener for s in (state, plain))
    changes = list(state.cascade.random_directions())
    assert changes
    for change in changes:
        rows = change_of_rows(batch, state.cascade.corrected, change, state.local, PM_WB)
        known, unknown = np.linalg.norm(aware(rows)), np.linalg.norm(bare(rows))
        assert unknown > 3.0
        assert known < 1.0


@pytest.mark.parametrize("offset_s", [0.0, 3e-6])
def test_voltages_of_the_ripple_and_of_readings_beside_it_follow_the_map(offset_s: float) -> None:
    """Against equations that are linearised at the moved map; a resistance that makes R T / L a tenth."""
    one = SegmentBatch.of(prepared([Plan(SegmentStage.RESISTANCE, hold(2.0, -1.0))]).pieces)
    whole = fitter(prepared(plan()))
    equations = WeakFormEquations(whole.noise, PM_WB, ripples=True)
    beside = scaled_library([SamplingOffset()], whole.prepared.manifest)[0].absent()
    beside = beside.moved("offset_s", offset_s / beside.candidate.named("offset_s").prior_width)
    model = replace(free_model(), r_s=40.0, magnetics=TRUE_MAP).with_active([beside] if offset_s else [])
    moved = replace(model, magnetics=Magnetics(TRUE_MAP.grid, 1.01 * TRUE_MAP.coefficients))
    was, now = (equations.relinearise(at, one, None) for at in (model, moved))
    (before,), (after,) = equations.rows(was), equations.rows(now)
    linear = was.linearisation.pieces[0]
    change = moved.magnetics.coefficients - model.magnetics.coefficients
    follows = linear.by_derivatives
    assert follows is not None
    beyond_flux = after.known - before.known - (linear.basis - follows.columns) @ change
    by_columns = follows.columns @ change
    # Beyond first order the ripple itself changes too, by some per cent of what it does.
    assert np.abs(beyond_flux - by_columns).max() < 0.1 * np.abs(beyond_flux).max()
    (along,) = equations.rows(equations.at(moved, was.linearisation))
    assert_close(along.known - before.known, linear.basis @ change, 1e-9)
