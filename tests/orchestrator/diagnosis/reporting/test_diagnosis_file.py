"""The diagnosis in a run's results: what comes back is what was written, and what is damaged is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from orchestrator.diagnosis.reporting.diagnosis_file import REPORT_NAME, STEPS_NAME, load_diagnosis, save_diagnosis
from protocols import RecordingError, StorageError
from tests.plugins.streams.report.example_diagnosis import WORDS, a_diagnosis, some_steps
from tests.support.close import assert_close

REPORT, STEPS = a_diagnosis(), some_steps()


@pytest.fixture
def results(tmp_path: Path) -> Path:
    save_diagnosis(tmp_path, REPORT, WORDS, STEPS)
    return tmp_path / "results"


def test_what_was_saved_comes_back(results: Path) -> None:
    kept = load_diagnosis(results.parent)
    assert kept is not None
    assert (kept.report, kept.words) == (REPORT, WORDS)
    assert json.loads((results / REPORT_NAME).read_text()).keys() == {"report", "words"}
    for have, want in zip(kept.steps, STEPS, strict=True):
        assert have.stage == want.stage
        assert (have.index, have.added, have.effects, have.chi2) == (want.index, want.added, want.effects, want.chi2)
        for name in ("time_s", "i_dq", "residual_dq_v", "noise_v", "i_abc", "residual_abc_v"):
            assert_close(getattr(have, name), getattr(want, name), 1e-6)
        assert [e.segment for e in have.excerpts] == [e.segment for e in want.excerpts]
        for excerpt, written in zip(have.excerpts, want.excerpts, strict=True):
            assert_close(excerpt.predicted_a, written.predicted_a, 1e-6)
        for loop, written_loop in zip(have.loops, want.loops, strict=True):
            assert_close(loop.psi_measured, written_loop.psi_measured, 1e-6)
        assert have.resistance is not None
        assert want.resistance is not None
        assert_close(have.resistance.measured_ohm, want.resistance.measured_ohm, 1e-6)


def test_what_every_rung_shares_is_written_once(results: Path) -> None:
    with np.load(results / STEPS_NAME) as archive:
        assert "0.i_dq" in archive
        assert "1.i_dq" not in archive
        assert "1.residual_dq_v" in archive


def test_a_directory_without_a_diagnosis_has_none(tmp_path: Path) -> None:
    assert load_diagnosis(tmp_path) is None


def test_a_diagnosis_without_pictures_has_no_steps(results: Path) -> None:
    (results / STEPS_NAME).unlink()
    kept = load_diagnosis(results.parent)
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
def test_a_damaged_file_is_one_line_that_names_it(results: Path, name: str, damage: Callable[[bytes], bytes]) -> None:
    file = results / name
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(RecordingError) as raised:
        load_diagnosis(results.parent)
    assert str(file) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_pickled_arrays_are_refused(results: Path) -> None:
    np.savez(results / STEPS_NAME, steps=np.array([{"added": None}], dtype=object))
    with pytest.raises(RecordingError, match=STEPS_NAME):
        load_diagnosis(results.parent)


def test_pictures_of_another_diagnosis_are_refused(results: Path) -> None:
    save_diagnosis(results.parent, REPORT, WORDS, STEPS[:1])
    with pytest.raises(RecordingError, match="not of the diagnosis"):
        load_diagnosis(results.parent)


def test_where_nothing_can_be_written_one_line_says_so(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("a file where a folder should be")
    with pytest.raises(StorageError, match="results"):
        save_diagnosis(tmp_path, REPORT, WORDS, STEPS)
