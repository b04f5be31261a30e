"""A rung of the ladder as pictures take it: rows that add up to the ladder, waveforms that meet where the model is
right, files that come back as they were written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, baseline_model
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.reporting.diagnosis_file import REPORT_NAME, STEPS_NAME, load_diagnosis, save_diagnosis
from orchestrator.diagnosis.reporting.excerpts import ripple_pair
from orchestrator.diagnosis.reporting.ladder import rung
from orchestrator.diagnosis.reporting.pictures import diagnosis_step, kept_rows
from orchestrator.diagnosis.selection.forward_search import Step, with_effect
from orchestrator.recording import Recording
from plugins.effects.inverter import DeadTime
from protocols import (
    DiagnosisReport,
    DiagnosisStep,
    DiagnosisWords,
    NoiseFloor,
    RecordingError,
    Saturated,
    StorageError,
    Unexplained,
)
from tests.support.close import assert_close

Ladder = tuple[tuple[Step, ...], DiagnosisSetup, tuple[DiagnosisStep, ...]]

RATIO = Criteria().selection.amplitudes_apart


@pytest.fixture(scope="module")
def ladder(with_dead_time: Recording) -> Ladder:
    """The map alone, then with the dead time that is really there."""
    setup = open_for_diagnosis(with_dead_time)
    bare = setup.fitter.fit(baseline_model(setup, Saturated()), renewals=1)
    candidate = scaled_library([DeadTime()], setup.prepared.manifest)[0]
    steps = (Step(None, bare), Step("dead_time", with_effect(setup.fitter, bare, candidate)))
    return steps, setup, tuple(diagnosis_step(k, step, setup) for k, step in enumerate(steps))


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


def a_report(steps: tuple[DiagnosisStep, ...]) -> DiagnosisReport:
    rungs = [
        {"added": s.added, "chi2": s.chi2, "rms_v": s.rms_v, "heldout_rms_v": s.heldout_rms_v, "current_rms_a": None}
        for s in steps
    ]
    return DiagnosisReport.model_validate(
        {
            "recording": "on-paper",
            "noise_floor": NoiseFloor(rms_v=0.001),
            "verdict": "explained",
            "effects": (),
            "traces": (),
            "joint": (),
            "ladder": tuple(rungs),
            "unexplained": Unexplained(fraction=0.01, shape=()),
            "next_experiment": None,
            "notes": ("a note − with a true minus",),
            "seconds": 1.0,
        }
    )


WORDS = DiagnosisWords(where_it_fails="a", what_it_looks_like="b", likely_cause="c", if_added="d", to_decide="e")


def test_what_was_saved_comes_back(ladder: Ladder, tmp_path: Path) -> None:
    steps = ladder[2]
    report = a_report(steps)
    save_diagnosis(tmp_path, report, WORDS, steps)
    kept = load_diagnosis(tmp_path)
    assert kept is not None
    assert kept.report == report
    assert kept.words == WORDS
    assert json.loads((tmp_path / "results" / REPORT_NAME).read_text()).keys() == {"report", "words"}
    for have, want in zip(kept.steps, steps, strict=True):
        assert have.stage == want.stage
        assert (have.index, have.added, have.effects, have.chi2) == (want.index, want.added, want.effects, want.chi2)
        for name in ("time_s", "i_dq", "residual_dq_v", "noise_v", "i_abc", "residual_abc_v"):
            assert_close(getattr(have, name), getattr(want, name), 1e-6)
        assert have.excerpts[0].segment == want.excerpts[0].segment
        assert_close(have.excerpts[0].predicted_a, want.excerpts[0].predicted_a, 1e-5)
        assert_close(have.loops[1].psi_measured, want.loops[1].psi_measured, 1e-5)
        assert have.resistance is not None
        assert want.resistance is not None
        assert np.allclose(have.resistance.measured_ohm, want.resistance.measured_ohm, rtol=1e-6)
    assert (tmp_path / "results" / STEPS_NAME).stat().st_size < 120 * Criteria().pictures.most_rows


def test_a_directory_without_a_diagnosis_has_none(tmp_path: Path) -> None:
    assert load_diagnosis(tmp_path) is None


def test_a_diagnosis_without_pictures_has_no_steps(ladder: Ladder, tmp_path: Path) -> None:
    save_diagnosis(tmp_path, a_report(ladder[2]), WORDS, ladder[2])
    (tmp_path / "results" / STEPS_NAME).unlink()
    kept = load_diagnosis(tmp_path)
    assert kept is not None
    assert kept.steps == ()


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        (REPORT_NAME, lambda whole: b"{"),
        (REPORT_NAME, lambda whole: b"[1, 2]"),
        (REPORT_NAME, lambda whole: whole.replace(b'"explained"', b'"solved"')),
        (REPORT_NAME, lambda whole: b"\xff" + whole),
        (STEPS_NAME, lambda whole: b"not a zip"),
        (STEPS_NAME, lambda whole: whole[: len(whole) // 2]),
        (STEPS_NAME, lambda whole: b""),
        (STEPS_NAME, lambda whole: whole[:5000] + bytes(200) + whole[5200:]),
    ],
)
def test_a_damaged_file_is_one_line_that_names_it(ladder: Ladder, tmp_path: Path, name: str, damage: object) -> None:
    save_diagnosis(tmp_path, a_report(ladder[2]), WORDS, ladder[2])
    file = tmp_path / "results" / name
    assert callable(damage)
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(RecordingError) as raised:
        load_diagnosis(tmp_path)
    assert str(file) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_pickled_arrays_are_refused(ladder: Ladder, tmp_path: Path) -> None:
    save_diagnosis(tmp_path, a_report(ladder[2]), WORDS, ladder[2])
    np.savez(tmp_path / "results" / STEPS_NAME, steps=np.array([{"added": None}], dtype=object))
    with pytest.raises(RecordingError, match=STEPS_NAME):
        load_diagnosis(tmp_path)


def test_pictures_of_another_diagnosis_are_refused(ladder: Ladder, tmp_path: Path) -> None:
    save_diagnosis(tmp_path, a_report(ladder[2]), WORDS, ladder[2])
    kept = (tmp_path / "results" / REPORT_NAME).read_bytes()
    save_diagnosis(tmp_path, a_report(ladder[2][:1]), WORDS, ladder[2][:1])
    (tmp_path / "results" / REPORT_NAME).write_bytes(kept)
    with pytest.raises(RecordingError, match="not of the diagnosis"):
        load_diagnosis(tmp_path)


def test_where_nothing_can_be_written_one_line_says_so(ladder: Ladder, tmp_path: Path) -> None:
    (tmp_path / "results").write_text("a file where a folder should be")
    with pytest.raises(StorageError, match="results"):
        save_diagnosis(tmp_path, a_report(ladder[2]), WORDS, ladder[2])
