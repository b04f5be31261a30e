"""A modulator's timer in held voltages: found with its step and phases, and not where chance alone puts them off."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from orchestrator.diagnosis.uncertainty.scatter import likelihood_of, scatter_of
from orchestrator.diagnosis.uncertainty.timer_search import timer_of
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from orchestrator.diagnosis.weak_form.timer import with_timer
from protocols import ModelNoise, SegmentStage
from tests.orchestrator.diagnosis.pieces import (
    R_S,
    Plan,
    felt_through,
    fitter,
    free_model,
    hold,
    many_holds,
    plan,
    prepared,
    timer,
    with_voltage,
)

PART = 0.35


@cache
def _recording(step_s: float, centred: bool) -> PreparedRecording:
    return felt_through(timer(step_s, PART, PART, centred=centred), many_holds())


@pytest.mark.parametrize(("step_s", "centred"), [(21.7e-9, True), pytest.param(9.3e-9, False, marks=pytest.mark.slow)])
def test_a_timer_is_found_with_its_step_and_phase(step_s: float, centred: bool) -> None:
    made = _recording(step_s, centred)
    maker = fitter(made)
    fit = maker.fit(free_model())
    assert fit.chi2_per_dof > 2.0
    found = timer_of(maker.prepared, likelihood_of(maker, fit, []), scatter_of(maker, fit, []).noise)
    assert found is not None
    made_out, left = found
    assert made_out.step_s == pytest.approx(step_s, rel=1e-3)
    assert made_out.centred is centred
    # A hold tells a step's part as well as it tells volts: to some hundredths here.
    (phases,) = made_out.phases
    for part in (phases.rise, phases.fall):
        assert abs((part - PART + 0.5) % 1.0 - 0.5) < 0.1
    with_it = fitter(with_timer(made, made_out)).fit(free_model())
    assert with_it.chi2_per_dof < 1.0 + 0.1 * (fit.chi2_per_dof - 1.0)
    # What scatters is told with the timer in.
    before = scatter_of(maker, fit, []).noise
    assert _volts(left) < 0.2 * _volts(before)


def _volts(noise: ModelNoise) -> float:
    """What scatters of a hold's voltage: of holds alone, readings and voltages cannot be told apart."""
    return max(noise.voltage_scatter_v, R_S * noise.offset_scatter_a)


def test_a_timer_that_is_known_is_told_again_nearby() -> None:
    made = _recording(21.7e-9, True)
    maker = fitter(made)
    fit = maker.fit(free_model())
    rough = timer(21.7e-9 * (1.0 + 3e-4), PART, PART)
    found = timer_of(maker.prepared, likelihood_of(maker, fit, []), scatter_of(maker, fit, []).noise, rough)
    assert found is not None
    assert abs(found[0].step_s / 21.7e-9 - 1.0) < 1e-4


def test_voltages_that_are_off_by_chance_have_no_timer() -> None:
    made, rng = prepared(many_holds()), np.random.default_rng(8)
    steps = {p.segment.id: rng.normal(0.0, 0.05, 2) for p in made.pieces if p.stage is SegmentStage.RESISTANCE}
    maker = fitter(with_voltage(made, steps))
    fit = maker.fit(free_model())
    scatter = scatter_of(maker, fit, []).noise
    assert scatter.voltage_scatter_v == pytest.approx(0.05, rel=0.3)
    assert timer_of(maker.prepared, likelihood_of(maker, fit, []), scatter) is None


def test_where_nothing_scatters_none_is_looked_for() -> None:
    maker = fitter(prepared(many_holds()))
    fit = maker.fit(free_model())
    assert timer_of(maker.prepared, likelihood_of(maker, fit, []), scatter_of(maker, fit, []).noise) is None


@pytest.mark.slow
def test_what_is_off_at_the_same_commands_again_and_again_bears_witness_once() -> None:
    # Six currents along each axis, of both signs, measured six times; each is off by its own, as a form may be.
    rng, sizes = np.random.default_rng(5), np.linspace(0.3, 2.4, 6)
    off = {(axis, a): rng.normal(0.0, 0.02, 2) for axis in (0, 1) for a in sizes}
    points = [(axis, sign, a) for axis, a in off for sign in (1.0, -1.0)] * 6
    held = [Plan(SegmentStage.RESISTANCE, hold(*(np.eye(2)[axis] * sign * a))) for axis, sign, a in points]
    made = prepared([*(p for p in plan() if p.stage is not SegmentStage.CLASSICAL), *held])
    rests = made.pieces[len(made.pieces) - len(held) :]
    error = {p.segment.id: sign * off[axis, a] for p, (axis, sign, a) in zip(rests, points, strict=True)}
    maker = fitter(with_voltage(made, error))
    fit = maker.fit(free_model())
    assert fit.chi2_per_dof > 2.0
    assert timer_of(maker.prepared, likelihood_of(maker, fit, [])) is None
