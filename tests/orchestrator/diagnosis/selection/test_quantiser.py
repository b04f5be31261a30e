"""A modulator's timer in a diagnosis: taken out of every voltage where the readings bear one, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate
from orchestrator.diagnosis.selection.quantiser import refine_quantiser_by_fit, with_detected_quantiser
from protocols import SegmentStage
from tests.orchestrator.diagnosis.pieces import (
    NOISE_A,
    felt_through,
    fitter,
    free_model,
    many_holds,
    plan,
    prepared,
    setup_of,
    timer,
    with_voltage,
)


def test_voltages_that_differ_by_chance_are_no_timer_s() -> None:
    made, rng = prepared(many_holds()), np.random.default_rng(6)
    by_chance = {p.segment.id: rng.normal(0.0, 0.01, 2) for p in made.pieces if p.stage is SegmentStage.RESISTANCE}
    setup = setup_of(fitter(with_voltage(made, by_chance)))
    assert with_detected_quantiser(setup, setup.fitter.fit(free_model()), []) is setup


def test_a_timer_is_reported_again_where_a_fit_with_it_leaves_something() -> None:
    true, off = timer(21.7e-9, 0.35, 0.62), timer(21.7e-9, 0.40, 0.58)
    felt = felt_through(true, plan(), noise_a=0.002)
    given = replace(setup_of(fitter(felt)), quantisers=(QuantiserEstimate(off, 9.0, np.zeros((3, 3))),))
    setup = given.with_quantiser(off)
    fit = setup.part_fitter.fit(free_model())
    assert fit.chi2_per_dof > 1.08
    timer_and_fit = refine_quantiser_by_fit(setup, fit, [])
    assert timer_and_fit is not None
    timed, beside = timer_and_fit
    assert beside.chi2_per_dof < 1.08
    assert timed.prepared.quantiser == beside.prepared.quantiser
    assert timed.prepared.quantiser is not None
    (at,) = timed.prepared.quantiser.phases
    # Which of the two edges is which, mean voltages do not say.
    assert sorted((at.rise, at.fall)) == pytest.approx((0.35, 0.62), abs=0.01)
    # Nothing is left beside the right one.
    assert refine_quantiser_by_fit(timed, beside, []) is None


@pytest.mark.parametrize("rounding", [0, 3, 4, 7])
def test_where_a_descent_meets_a_command_s_jump_it_goes_on_beyond(rounding: int) -> None:
    """Which way a descent goes between jumps is decided by the last digits: all have to lead to the timer."""
    off = timer(21.7e-9, 0.40, 0.58)
    felt = felt_through(timer(21.7e-9, 0.35, 0.62), plan(), noise_a=NOISE_A * (1.0 + 1e-9 * rounding))
    given = replace(setup_of(fitter(felt)), quantisers=(QuantiserEstimate(off, 9.0, np.zeros((3, 3))),))
    setup = given.with_quantiser(off)
    timer_and_fit = refine_quantiser_by_fit(setup, setup.part_fitter.fit(free_model()), [])
    assert timer_and_fit is not None
    timed, beside = timer_and_fit
    assert beside.chi2_per_dof < 1.06
    assert timed.prepared.quantiser is not None
    (at,) = timed.prepared.quantiser.phases
    assert sorted((at.rise, at.fall)) == pytest.approx((0.35, 0.62), abs=0.035)


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
    setup = setup_of(fitter(rounded))
    fit = setup.fitter.fit(free_model())
    timed = with_detected_quantiser(setup, fit, [])
    assert timed.prepared.quantiser is not None
    assert timed.prepared.quantiser.step_s == pytest.approx(21.7e-9, rel=1e-4)
    assert timed.part_fitter.prepared.quantiser == timed.prepared.quantiser
    with_it = timed.fitter.fit(free_model())
    assert with_it.chi2_per_dof - 1.0 < 0.1 * (fit.chi2_per_dof - 1.0)
    # As commanded again, the timer is not in the voltages.
    for piece, first in zip(timed.with_quantiser(None).prepared.pieces, rounded.pieces, strict=True):
        np.testing.assert_array_equal(piece.signals.v_ab, first.signals.v_ab)
