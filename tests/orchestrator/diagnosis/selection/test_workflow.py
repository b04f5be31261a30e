"""The course of a diagnosis, step by step."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.selection.forward_search import Search, Step
from orchestrator.diagnosis.selection.workflow import pruned, with_its_scatter
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


@pytest.mark.slow
def test_what_scatters_is_a_timer_s_doing_where_it_repeats_and_noise_where_it_does_not() -> None:
    plans = many_holds()
    made, rng = prepared(plans), np.random.default_rng(6)
    by_chance = {p.segment.id: rng.normal(0.0, 0.01, 2) for p in made.pieces if p.stage is SegmentStage.RESISTANCE}
    found = []
    rounded = felt_through(timer(21.7e-9, 0.35, 0.35), plans)
    for recording in (rounded, with_voltage(made, by_chance)):
        maker = fitter(recording)
        setup = DiagnosisSetup(recording, maker, maker, L_D, L_Q, 2.5, ())
        wider = with_its_scatter(setup, maker.fit(free_model()), [])
        assert wider is not None
        assert wider.fitter.fit(free_model()).chi2_per_dof < 1.2
        found.append(wider)
    timed, noisy = found
    assert timed.prepared.timer is not None
    assert timed.coarse_fitter.prepared.timer == timed.prepared.timer
    assert not timed.fitter.noise.of_model.scatters
    assert noisy.prepared.timer is None
    assert noisy.fitter.noise.of_model.scatters
    # As commanded again, the timer is not in the voltages.
    for piece, first in zip(timed.bare.prepared.pieces, rounded.pieces, strict=True):
        np.testing.assert_array_equal(piece.signals.v_ab, first.signals.v_ab)
