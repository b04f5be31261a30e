"""A diagnosis is kept with its words and pictures; where the disk does not take it, it is reported all the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from orchestrator.diagnosis import Diagnosis
from orchestrator.diagnosis.reporting import keeping
from orchestrator.diagnosis.reporting.diagnosis_file import load_diagnosis
from orchestrator.diagnosis.selection.search_state import SearchResult
from orchestrator.recording import Recording
from protocols import DiagnosisStep
from tests.plugins.streams.report.example_diagnosis import WORDS, a_diagnosis, some_steps

REPORT, STEPS = a_diagnosis(), some_steps()


@pytest.fixture
def requested(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the diagnosis was requested; it finds the example at once."""
    seen: dict[str, Any] = {}

    def diagnose(
        recording: Recording, effects: object, *, on_step: Callable[[DiagnosisStep], None], **requested: Any
    ) -> Any:
        seen.update(requested)
        for step in STEPS:
            on_step(step)
        return Diagnosis(REPORT, None, SearchResult([]), ())

    monkeypatch.setattr(keeping, "diagnose_recording", diagnose)
    monkeypatch.setattr(keeping, "in_words", lambda diagnosis: WORDS)
    return seen


def test_report_words_and_every_step_are_kept_where_it_was_stated(
    requested: dict[str, Any], clean: Recording, tmp_path: Path
) -> None:
    seen: list[DiagnosisStep] = []
    diagnosis, saved = keeping.diagnose_and_keep(
        clean, (), propose=None, model="linear", out=tmp_path, on_step=seen.append
    )
    assert (requested["model"], requested["out"]) == ("linear", tmp_path)
    assert tuple(seen) == saved.steps == STEPS
    assert diagnosis.report is saved.report is REPORT
    kept = load_diagnosis(tmp_path)
    assert kept is not None
    assert (kept.report, kept.words, len(kept.steps)) == (REPORT, WORDS, 2)
    assert load_diagnosis(clean.path) is None


def test_a_step_that_raises_ends_it_and_nothing_is_kept(
    requested: dict[str, Any], clean: Recording, tmp_path: Path
) -> None:
    def stop(step: DiagnosisStep) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        keeping.diagnose_and_keep(clean, (), propose=None, out=tmp_path, on_step=stop)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_written_is_reported_all_the_same(
    requested: dict[str, Any], clean: Recording, tmp_path: Path
) -> None:
    (tmp_path / "results").write_text("a file where a folder should be")
    diagnosis, saved = keeping.diagnose_and_keep(clean, (), propose=None, out=tmp_path)
    (remark,) = (r for r in diagnosis.report.remarks if r.code == "not_written")
    assert str(tmp_path / "results") in remark.text
    assert saved.report == diagnosis.report
    assert (saved.words, saved.steps) == (WORDS, STEPS)
