"""Stretches for pictures: a loop closes where the model is the machine, and the frames are the believed one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.excerpts import MAX_POINTS, excerpts, flux_loops, ripple_pair
from protocols import SegmentStage
from tests.orchestrator.diagnosis.pieces import (
    FS,
    NOISE_A,
    R_S,
    Plan,
    fitter,
    free_model,
    piece,
    plan,
    prepared,
    ripple,
)

ANGLE = 0.6


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fitter(prepared(plan(), angle=ANGLE)).fit(free_model())


def test_flux_of_a_sweep_by_integration_is_that_of_the_map(fit: Fit) -> None:
    loops = {loop.swept_axis: loop for loop in flux_loops(fit)}
    assert set(loops) == {"d", "q"}
    for number, loop in enumerate((loops["d"], loops["q"])):
        assert np.ptp(loop.i_dq[:, number]) > 10.0 * np.ptp(loop.i_dq[:, 1 - number])
        np.testing.assert_allclose(loop.psi_measured, loop.psi_model, atol=0.02 * float(np.ptp(loop.psi_model)))


def test_a_loop_states_what_the_noise_of_the_readings_adds_to_its_flux(fit: Fit) -> None:
    for loop in flux_loops(fit):
        assert loop.noise_wb is not None
        walk = [R_S * NOISE_A * np.sqrt(0.5 * period_s / FS) for period_s in (0.1, 10.0)]
        assert walk[0] < loop.noise_wb < walk[1]


def test_predicted_current_is_the_measured_one_but_for_its_noise(fit: Fit) -> None:
    shown = excerpts(fit)
    assert {e.stage for e in shown} == {"injection", "classical"}
    for excerpt in shown:
        left = np.asarray(excerpt.predicted_a) - np.asarray(excerpt.measured_a)
        assert float(np.sqrt(np.mean(left**2))) < 2.0 * NOISE_A
        assert np.diff(excerpt.time_s).min() > 0.0
        assert len(excerpt.time_s) <= MAX_POINTS + 1


def test_a_trapezoid_that_was_held_out_is_shown_first(fit: Fit) -> None:
    (held,) = (p.segment.id for p in fit.prepared.pieces if p.held_out)
    assert held in {e.segment for e in excerpts(fit)}


def test_two_amplitudes_at_one_point_are_a_pair_and_the_smaller_comes_first() -> None:
    small, large, far = (
        piece(Plan(SegmentStage.INJECTION, ripple(d, 0.0, volts), settings={"amplitude_v": volts}))
        for d, volts in ((1.0, 20.0), (1.0, 40.0), (-2.0, 20.0))
    )
    assert ripple_pair([far, large, small], 1.3) == (2, 1)
    assert ripple_pair([far, large], 1.3) == (1,)
    assert ripple_pair([replace(far, held_out=True)], 1.3) == (0,)
    assert ripple_pair([], 1.3) == ()
