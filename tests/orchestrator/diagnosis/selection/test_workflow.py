"""The course of a diagnosis, step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.selection.forward_search import Search, Step
from orchestrator.diagnosis.selection.workflow import pruned, with_its_scatter, with_its_timer
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from plugins.effects.inverter import VoltageBias
from plugins.effects.resistance import PhaseResistanceImbalance
from protocols import SegmentStage
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import (
    L_D,
    L_Q,
    R_S,
    felt_through,
    fitter,
    free_model,
    many_holds,
    plan,
    prepared,
    timer,
    with_voltage,
)


@pytest.mark.parametrize(("of_resistance", "spared"), [(4e-4, []), (0.0, ["phase_resistance_imbalance"])])
def test_what_takes_the_rest_to_the_noise_is_named_however_large_the_first_error_was(
    of_resistance: float, spared: list[str]
) -> None:
    biased = with_voltage(prepared(plan(), noise_a=0.002), np.array([2.0, -1.0]))
    extra = {p.segment.id: of_resistance * R_S * p.signals.i_ab * np.array([1.0, 0.0]) for p in biased.pieces}
    maker = fitter(with_voltage(biased, extra))
    steps = [Step(None, maker.fit(free_model()))]
    for effect in (VoltageBias(), PhaseResistanceImbalance()):
        before = steps[-1].fit.model
        model = before.with_active([*before.active, *with_free(before, maker, effect).active])
        steps.append(Step(effect.name, maker.fit(model), 100.0))
    assert steps[0].fit.chi2_per_dof > 1e5 > 1e4 * steps[-1].fit.chi2_per_dof
    setup = DiagnosisSetup(maker.prepared, maker, maker, L_D, L_Q, 2.5, ())
    assert pruned(setup, Search(steps))[1] == spared


def _setup(recording: PreparedRecording) -> DiagnosisSetup:
    maker = fitter(recording)
    return DiagnosisSetup(recording, maker, maker, L_D, L_Q, 2.5, ())


def test_voltages_that_differ_by_chance_are_noise_and_no_timer() -> None:
    made, rng = prepared(many_holds()), np.random.default_rng(6)
    by_chance = {p.segment.id: rng.normal(0.0, 0.01, 2) for p in made.pieces if p.stage is SegmentStage.RESISTANCE}
    setup = _setup(with_voltage(made, by_chance))
    fit = setup.fitter.fit(free_model())
    assert with_its_timer(setup, fit, []) is setup
    noisy = with_its_scatter(setup, fit, [])
    assert noisy is not None
    assert noisy.fitter.noise.of_model.scatters
    assert noisy.fitter.fit(free_model()).chi2_per_dof < 1.2


@pytest.mark.slow
def test_a_timer_is_taken_out_of_every_voltage() -> None:
    rng, plans = np.random.default_rng(4), [*many_holds(), *(p for p in plan() if p.stage is SegmentStage.CLASSICAL)]
    # Current control trembles with the readings' noise.
    trembling = [
        p
        if p.stage in (SegmentStage.GATES_OFF, SegmentStage.RESISTANCE)
        else replace(p, v_dq=np.tile(p.v_dq, (4, 1)) + rng.normal(0.0, 0.3, (4 * len(p.v_dq), 2)))
        for p in plans
    ]
    rounded = felt_through(timer(21.7e-9, 0.35, 0.35), trembling, noise_a=0.001)
    setup = _setup(rounded)
    fit = setup.fitter.fit(free_model())
    timed = with_its_timer(setup, fit, [])
    assert timed.prepared.timer is not None
    assert timed.prepared.timer.step_s == pytest.approx(21.7e-9, rel=1e-4)
    assert timed.coarse_fitter.prepared.timer == timed.prepared.timer
    with_it = timed.fitter.fit(free_model())
    assert with_it.chi2_per_dof - 1.0 < 0.1 * (fit.chi2_per_dof - 1.0)
    # As commanded again, the timer is not in the voltages.
    for piece, first in zip(timed.bare.prepared.pieces, rounded.pieces, strict=True):
        np.testing.assert_array_equal(piece.signals.v_ab, first.signals.v_ab)
