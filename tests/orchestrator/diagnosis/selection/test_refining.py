"""A flexible form is freed where it pays, and nowhere else; what is settled is not worse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm, scaled_library
from orchestrator.diagnosis.fitting.fit import OBJECTIVE_SLACK, Fitter
from orchestrator.diagnosis.selection.refining import _alternative_starts, converge, refit_newest
from plugins.effects.inverter import DeadTime, DeviceDrop
from plugins.effects.iron import Hysteresis
from protocols import ParameterRole, Signals
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import Array, fitter, free_model, plan, prepared, with_voltage
from tests.support.cases import few


def _machine(flexible: float) -> Fitter:
    """With an inverter's error of the effect's own form, its refinements that far from neutral."""
    made = prepared(plan())
    (candidate,) = scaled_library([DeadTime()], made.manifest)
    active = candidate.absent().moved(candidate.amplitudes[0], 4.0)
    for name in candidate.of_role(ParameterRole.REFINEMENT):
        active = active.moved(name, active.standardised_value(name) + flexible)
    errors = {p.segment.id: _error(active, made.pieces[k].signals) for k, p in enumerate(made.pieces)}
    return fitter(with_voltage(made, errors))


def _error(active: EffectTerm, signals: Signals) -> Array:
    """What the command has to have on top, so that the signals' own voltage is what the effect leaves of it."""
    error = np.zeros(signals.v_ab.shape)
    for _ in range(5):
        commanded = replace(signals, v_ab=signals.v_ab + error)
        left = np.asarray(active.candidate.effect.correct(commanded, active.parameters).v_ab)
        error = np.asarray(error + signals.v_ab - left, dtype=np.float64)
    return error


@few("flexible, freed", [(0.0, False), (3.0, True)])
def test_the_flexible_form_is_freed_where_the_simple_one_will_not_do(flexible: float, freed: bool) -> None:
    maker = _machine(flexible)
    simple = maker.fit(with_free(free_model(), maker, DeadTime(), voltage_v=0.5))
    better = refit_newest(maker, simple, 1.0)
    refinements = set(simple.model.active[0].candidate.of_role(ParameterRole.REFINEMENT))
    assert bool(refinements & set(better.model.active[0].free)) is freed
    end = converge(maker, better)
    assert end.chi2_per_dof < 1.3
    assert end.objective <= better.objective + OBJECTIVE_SLACK


def test_a_form_is_begun_again_without_what_ran_to_the_end_of_its_range() -> None:
    """Beside a junction's logarithm a step of any softness is stuck, and the logarithm is not begun from there."""
    made = prepared(plan())
    (candidate,) = scaled_library([DeviceDrop()], made.manifest)
    active = candidate.absent().moved("voltage_v", 1.0)
    active = replace(active, values={**active.values, "growth": 1.0, "threshold_a": 0.01})
    maker = fitter(with_voltage(made, {p.segment.id: _error(active, p.signals) for p in made.pieces}))
    (step,) = with_free(free_model(), maker, DeviceDrop(), voltage_v=0.5).active
    soft = replace(step, values={**step.values, "softness": 1.0}).release("threshold_a", "softness")
    stuck = maker.fit(free_model().with_active([soft]))
    assert stuck.chi2_per_dof > 3.0
    better = refit_newest(maker, stuck, 1.0)
    assert better.chi2_per_dof < 1.2
    assert "growth" in better.model.active[0].free


def test_a_second_form_is_also_begun_with_what_the_first_has_been_bent_by() -> None:
    """Iron of many thresholds asks for two stops and for soft ones: neither is worth much without the other."""
    maker = fitter(prepared(plan()))
    (candidate,) = scaled_library([Hysteresis()], maker.prepared.manifest)
    simple = candidate.absent().release("yield_wb")
    extended = simple.moved("variance", 0.6).release("variance")
    fit = maker.fit(free_model())
    best = replace(fit, model=fit.model.with_active([extended]), chi2=3.0 * fit.dof)
    forms = [(form.values["softness"], form.values["variance"]) for form in _alternative_starts(simple, best, 0)]
    assert forms == [(0.6, 0.0), (0.6, extended.values["variance"])]
    assert _alternative_starts(simple, replace(best, chi2=1.0 * fit.dof), 0) == []


def test_few_numbers_bend_a_form_and_details_wait() -> None:
    sharp = _sharp()
    better = refit_newest(sharp, sharp.fit(with_free(free_model(), sharp, DeadTime(), voltage_v=0.5)), 1.0)
    assert better.model.active[0].free_refinements == ("softness",)
    assert better.chi2_per_dof < 1.2
    # A tangent's knee needs its parts, and nothing of how a leg switches.
    curved = _sharp(softness=0.0, wide=0.6, narrow=0.5)
    better = refit_newest(curved, curved.fit(with_free(free_model(), curved, DeadTime(), voltage_v=0.5)), 1.0)
    assert {"wide", "narrow", "wider"} & set(better.model.active[0].free_refinements)
    assert not {"switched", "grading"} & set(better.model.active[0].free_refinements)
    assert better.chi2_per_dof < 1.2


def _sharp(**coordinates: float) -> Fitter:
    made = prepared(plan())
    (candidate,) = scaled_library([DeadTime()], made.manifest)
    active = candidate.absent().moved(candidate.amplitudes[0], 4.0)
    for name, x in (coordinates or {"softness": -1.3}).items():
        active = active.moved(name, x)
    errors = {p.segment.id: _error(active, p.signals) for p in made.pieces}
    return fitter(with_voltage(made, errors))
