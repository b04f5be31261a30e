"""A flexible form is freed where it pays, and nowhere else; the simple form comes back where it does as well."""

from __future__ import annotations

from dataclasses import replace

import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.selection.adding import full_model
from orchestrator.diagnosis.selection.scoring import movable
from orchestrator.diagnosis.selection.shape_moves import fix_moves, form_moves, free_moves, with_best_shapes
from plugins.effects.inverter import DeadTime, DeviceDrop
from plugins.effects.iron import Hysteresis
from plugins.effects.resistance import PhaseResistanceImbalance
from protocols import ParameterRole
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage
from tests.orchestrator.diagnosis.selection.states import errors_of, joint_state, made, state_of, view_of
from tests.support.cases import few


def _machine(**coordinates: float) -> Fitter:
    """With a dead time of this form, in standardised values beside neutral."""
    recording = prepared(plan())
    (candidate,) = scaled_library([DeadTime()], recording.manifest)
    active = candidate.absent().moved(candidate.amplitudes[0], 4.0)
    for name, x in coordinates.items():
        active = active.moved(name, active.standardised_value(name) + x)
    return fitter(with_voltage(recording, errors_of(active, recording)))


@few("flexible, freed", [(0.0, False), (1.0, True)])
def test_the_flexible_form_is_freed_where_the_simple_one_will_not_do(flexible: float, freed: bool) -> None:
    refinements = DeadTime.Parameters.declared()
    names = [p.name for p in refinements if p.role is ParameterRole.REFINEMENT]
    maker = _machine(**dict.fromkeys(names, flexible))
    simple = state_of(maker, maker.fit(with_free(free_model(), maker, DeadTime(), voltage_v=0.5)))
    better = with_best_shapes(simple)
    assert bool(better.fit.model.active[0].free_refinements) is freed
    assert better.fit.chi2_per_dof < 1.3
    # Forms that are needed stay free.
    assert all(move.make() is None for move in fix_moves(better))


def test_refinements_without_effect_are_fixed_again() -> None:
    maker = _machine()
    model = with_free(free_model(), maker, DeadTime(), voltage_v=0.5)
    (active,) = model.active
    state = state_of(maker, maker.fit(model.with_active([active.release("threshold_a", "wide")])))
    (move,) = fix_moves(state)
    (fixed,) = made(move).fit.model.active
    assert fixed.free_refinements == ()
    assert fixed.values["wide"] == fixed.candidate.named("wide").neutral


@pytest.mark.slow
def test_few_parameters_make_a_form_and_details_wait() -> None:
    sharp = _machine(softness=-1.3)
    start = state_of(sharp, sharp.fit(with_free(free_model(), sharp, DeadTime(), voltage_v=0.5)))
    better = with_best_shapes(start).fit
    assert better.model.active[0].free_refinements == ("softness",)
    assert better.chi2_per_dof < 1.2
    # A tangent's knee needs its parts, and nothing of how a leg switches.
    curved = _machine(softness=-3.0, wide=0.6, narrow=0.5)
    start = state_of(curved, curved.fit(with_free(free_model(), curved, DeadTime(), voltage_v=0.5)))
    better = with_best_shapes(start).fit
    assert {"wide", "narrow", "wider"} & set(better.model.active[0].free_refinements)
    assert not {"switched", "grading"} & set(better.model.active[0].free_refinements)
    assert better.chi2_per_dof < 1.2


def test_a_parameter_that_its_bound_holds_gains_nothing() -> None:
    """A share of capacitances cannot be negative, however much that would fit."""
    maker = _machine(softness=-1.3)
    view = view_of(state_of(maker, maker.fit(with_free(free_model(), maker, DeadTime(), voltage_v=0.5))), [])
    (charged,) = (k for k in view.columns_of("dead_time") if view.columns[k][1] == "charged")
    for right, moves in ((-view.right, [charged]), (view.right, [])):
        sign = 1.0 if float(view.right[charged]) > 0.0 else -1.0
        assert movable(replace(view, normal=0.0 * view.normal, right=sign * right), [charged]) == moves


def test_a_form_is_begun_again_without_what_ran_to_the_end_of_its_range() -> None:
    """Beside a junction's logarithm a step of any softness is stuck, and the logarithm is not begun from there."""
    recording = prepared(plan())
    (candidate,) = scaled_library([DeviceDrop()], recording.manifest)
    active = candidate.absent().moved("voltage_v", 1.0)
    active = replace(active, values={**active.values, "growth": 1.0, "threshold_a": 0.01})
    maker = fitter(with_voltage(recording, errors_of(active, recording)))
    (step,) = with_free(free_model(), maker, DeviceDrop(), voltage_v=0.5).active
    soft = replace(step, values={**step.values, "softness": 1.0}).release("threshold_a", "softness")
    stuck = maker.fit(free_model().with_active([soft]))
    assert stuck.chi2_per_dof > 3.0
    better = with_best_shapes(state_of(maker, stuck)).fit
    assert better.chi2_per_dof < 1.2
    assert "growth" in better.model.active[0].free


def test_a_second_form_is_also_begun_with_the_first_one_s_refinements() -> None:
    """Iron of many thresholds asks for two stops and for soft ones: neither is worth much without the other."""
    recording = prepared(plan())
    (candidate,) = scaled_library([Hysteresis()], recording.manifest)
    extended = candidate.absent().release("yield_wb").moved("variance", 0.6).release("variance")
    maker = fitter(recording)
    fit = maker.fit(free_model())
    state = state_of(maker, replace(fit, model=fit.model.with_active([extended])))
    forms = [(form.values["softness"], form.values["variance"]) for form in extended.alternative_forms()]
    assert forms == [(0.6, 0.0), (0.6, extended.values["variance"])]
    assert [move.kind for move in form_moves(state)] == ["switch_form", "switch_form"]
    assert len({move.key(state) for move in form_moves(state)}) == 2


def test_of_a_joint_model_shapes_of_significant_effects_are_freed_together() -> None:
    recording = prepared(plan(sparse=True))
    (dead_time,) = scaled_library([DeadTime()], recording.manifest)
    true = replace(dead_time.absent(), values={**dead_time.absent().values, "voltage_v": 2.0, "threshold_a": 0.4})
    maker = fitter(with_voltage(recording, errors_of(true, recording)))
    rigid = joint_state(maker, [dead_time.absent()])
    move = next(free_moves(rigid, view_of(rigid, []), details=False))
    formed = made(move)
    assert rigid.fit.chi2_per_dof > 1.5 > formed.fit.chi2_per_dof
    assert formed.fit.model.active[0].values["threshold_a"] == pytest.approx(0.4, rel=0.1)


def test_a_dead_time_all_within_its_commutation_is_reached_from_its_second_form() -> None:
    recording = prepared(plan(), noise_a=0.002)
    library = scaled_library([DeadTime(), PhaseResistanceImbalance()], recording.manifest)
    absent = library[0].absent()
    wanted = {"voltage_v": 2.0, "threshold_a": 2.5, "switched": 1.0, "grading": 0.5}
    true = replace(absent, values={**absent.values, **wanted})
    maker = fitter(with_voltage(recording, errors_of(true, recording)))
    joint = full_model(state_of(maker), library)
    (move,) = form_moves(joint)
    switched = made(move)
    (begun,) = (a for a in switched.fit.model.active if a.name == "dead_time")
    assert begun.values["threshold_a"] == library[0].named("threshold_a").other_form
    (reached,) = (a for a in with_best_shapes(switched).fit.model.active if a.name == "dead_time")
    assert reached.values["voltage_v"] == pytest.approx(2.0, rel=0.1)
    assert reached.values["threshold_a"] == pytest.approx(2.5, rel=0.1)
