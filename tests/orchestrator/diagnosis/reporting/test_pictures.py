"""A rung of the ladder as pictures take it: rows that add up to the ladder, waveforms that meet where the model is
right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, baseline_model
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.reporting.excerpts import ripple_pair
from orchestrator.diagnosis.reporting.ladder import rung
from orchestrator.diagnosis.reporting.pictures import diagnosis_step, kept_rows
from orchestrator.diagnosis.selection.contrasts import MIN_AMPLITUDE_RATIO
from orchestrator.diagnosis.selection.search import with_effect
from orchestrator.diagnosis.selection.search_state import AcceptedModel
from orchestrator.recording import Recording
from plugins.effects.inverter import DeadTime
from protocols import DiagnosisStep, Saturated
from tests.support.close import assert_close

Ladder = tuple[tuple[AcceptedModel, ...], DiagnosisSetup, tuple[DiagnosisStep, ...]]

RATIO = MIN_AMPLITUDE_RATIO


@pytest.fixture(scope="module")
def ladder(with_dead_time: Recording) -> Ladder:
    """The map alone, then with the dead time that is really there."""
    setup = open_for_diagnosis(with_dead_time)
    bare = setup.fitter.fit(baseline_model(setup, Saturated()), relinearisations=1)
    candidate = scaled_library([DeadTime()], setup.prepared.manifest)[0]
    steps = (AcceptedModel(None, bare), AcceptedModel("dead_time", with_effect(setup, bare, candidate)))
    return steps, setup, tuple(diagnosis_step(k, step) for k, step in enumerate(steps))


def test_a_step_says_what_the_ladder_says(ladder: Ladder) -> None:
    steps, _, pictures = ladder
    for step, picture in zip(steps, pictures, strict=True):
        numbers = rung(step)
        assert (picture.added, picture.chi2, picture.rms_v) == (numbers.added, numbers.chi2, numbers.rms_v)
        assert picture.heldout_rms_v == numbers.heldout_rms_v
        assert picture.current_rms_a == numbers.current_rms_a
    assert pictures[1].effects == ("dead_time",)


def test_the_residual_falls_to_the_noise_of_its_rows(ladder: Ladder) -> None:
    _, _, (before, after) = ladder
    in_noise = [np.sqrt(np.mean((s.residual_dq_v / s.noise_v[:, None]) ** 2)) for s in (before, after)]
    assert in_noise[0] > 5.0
    assert 0.9 < in_noise[1] < 1.1


def test_phase_components_have_no_sum_and_the_same_size(ladder: Ladder) -> None:
    for step in ladder[2]:
        for three, two in ((step.residual_abc_v, step.residual_dq_v), (step.i_abc, step.i_dq)):
            assert_close(three.sum(axis=1), np.zeros(len(three)), 1e-14, of=three)
            # Amplitude-invariant Clarke: the squares of the phases add up to 3/2 of the vector's.
            assert_close((three**2).sum(axis=1), 1.5 * (two**2).sum(axis=1), 1e-12)


def test_dead_time_is_one_curve_over_each_phase_current(ladder: Ladder) -> None:
    before, after = ladder[2]
    large = np.abs(before.i_abc) > 0.5
    sign = np.sign(before.i_abc[large])
    assert np.mean(before.residual_abc_v[large] * sign) > 5.0 * abs(np.mean(after.residual_abc_v[large] * sign))


def test_rows_are_the_same_at_every_step(ladder: Ladder) -> None:
    before, after = ladder[2]
    assert before.stage == after.stage
    assert np.array_equal(before.time_s, after.time_s)
    assert np.array_equal(before.i_dq, after.i_dq)


def test_ripple_is_shown_at_one_point_with_two_amplitudes(ladder: Ladder) -> None:
    ripples = [e for e in ladder[2][1].excerpts if e.stage == "injection"]
    small, large = ripples
    assert (small.amplitude_v, large.amplitude_v) == (20.0, 40.0)
    assert np.hypot(small.i_d_a - large.i_d_a, small.i_q_a - large.i_q_a) < 0.1
    swings = [np.ptp(e.measured_a[:, 0]) for e in ripples]
    assert swings[1] == pytest.approx(2.0 * swings[0], rel=0.1)
    # Injected along d: the ripple is there, and begins to rise where the excerpt begins.
    assert np.ptp(large.measured_a[:, 0]) > 5.0 * np.ptp(large.measured_a[:, 1])
    assert large.measured_a[5, 0] > large.measured_a[0, 0]


def test_predicted_currents_meet_the_measured_ones_once_the_effect_is_in(ladder: Ladder) -> None:
    for before, after in zip(ladder[2][0].excerpts, ladder[2][1].excerpts, strict=True):
        assert np.array_equal(before.measured_a, after.measured_a)
        apart = [np.sqrt(np.mean((e.predicted_a - e.measured_a) ** 2)) for e in (before, after)]
        assert apart[1] < apart[0]
        assert apart[1] < 0.01  # where the sensors' noise is 5 mA a component
    trapezoids = [step.excerpts[-1] for step in ladder[2]]
    missed = [np.abs(e.predicted_a - e.measured_a).max() for e in trapezoids]
    assert missed[0] > 5.0 * missed[1]


def test_flux_loops_of_the_measurement_close_on_the_map(ladder: Ladder) -> None:
    _, _, (before, after) = ladder
    assert [loop.swept_axis for loop in after.loops] == ["d", "q", "dq"]
    for one, other in zip(before.loops, after.loops, strict=True):
        apart = [np.abs(loop.psi_measured - loop.psi_model).max() for loop in (one, other)]
        assert apart[1] < apart[0]
        assert apart[1] < 2e-3  # of some 0.2 Wb
        assert not other.psi_measured[0].any()
        assert len(other.i_dq) <= 401


def test_every_dwell_asks_for_the_true_resistance_once_the_effect_is_in(ladder: Ladder) -> None:
    before, after = (step.resistance for step in ladder[2])
    assert before is not None
    assert after is not None
    assert np.ptp(before.measured_ohm) > 0.3
    assert np.allclose(after.measured_ohm, 4.31, atol=0.03)
    assert np.allclose(after.model_ohm, after.model_ohm[0])
    assert np.all(np.diff(after.heat_j[np.argsort(after.time_s)]) >= 0.0)


def test_small_stages_are_kept_whole_and_large_ones_evenly() -> None:
    stages = ["resistance"] * 30 + ["classical"] * 20_000 + ["injection"] * 3000
    kept = kept_rows(stages, 4000)
    assert abs(len(kept) - 4000) < 5
    assert (kept < 30).sum() == 30
    of_sweeps = kept[(kept >= 30) & (kept < 20_030)]
    assert np.diff(of_sweeps).max() < 4 * 20_000 / len(of_sweeps)
    # Out of step with anything periodic: every eighth row is kept as often as any other.
    counts = np.bincount((of_sweeps - 30) % 8, minlength=8)
    assert counts.max() < 1.1 * counts.min()
    assert list(kept_rows(stages[:100], 4000)) == list(range(100))


def test_without_two_amplitudes_one_ripple_is_shown(ladder: Ladder) -> None:
    _, setup, _ = ladder
    pieces = setup.prepared.pieces
    small, large = ripple_pair(pieces, RATIO)
    one = [pieces[large]]
    assert ripple_pair(one, RATIO) == (0,)
    assert ripple_pair([p for p in pieces if p.stage.value == "resistance"], RATIO) == ()
    other = replace(pieces[small], segment=pieces[small].segment.model_copy(update={"settings": {"amplitude_v": 41.0}}))
    assert len(ripple_pair([other, pieces[large]], RATIO)) == 1
