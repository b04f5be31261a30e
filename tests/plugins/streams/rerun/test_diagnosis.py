"""The page of a diagnosis in the viewer: its reasons first, what the search tried last."""

from __future__ import annotations

import numpy as np
import pytest
import rerun as rr

from orchestrator.diagnosis.fitting.progress import SearchRecorder
from plugins.streams.rerun import _diagnosis, _words
from plugins.streams.rerun._tape import Entry, When, entry
from protocols import Diagnosed, DiagnosisReport, LawLearned, Reason
from tests.plugins.streams.report.example_diagnosis import WORDS
from tests.plugins.streams.report.example_diagnosis import a_diagnosis as reported


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Texts of the viewer's pages, as they are written."""
    written: list[str] = []

    def page(path: str, when: When, text: str) -> Entry:
        written.append(text)
        return entry(path, when, rr.TextDocument(text))

    monkeypatch.setattr(_diagnosis, "page", page)
    return written


def show(report: DiagnosisReport) -> None:
    _diagnosis.Diagnosis().take(Diagnosed(round=0, report=report, words=WORDS))


def test_reasons_stand_first_and_the_search_last_a_line_for_each_move(pages: list[str]) -> None:
    recorder = SearchRecorder()
    recorder.record("add", ["dead_time"], measure="log_evidence", score=812.0, threshold=16.0, taken=True)
    recorder.record("remove", ["bus_sag"], taken=False)
    reason = Reason(quantity="chi2_per_dof", value=1.02, limit=1.08, sentence="chi2 is 1.02; noise makes up to 1.08.")
    show(reported(reasons=[reason], search=recorder.events))
    page = pages[-1]
    assert page.startswith("# The diagnosis\n\n- chi2 is 1.02")
    assert page.endswith("1. add: dead time; gain 812 nat (needed 16 nat); accepted\n\n2. remove: bus sag; rejected")


def test_an_older_diagnosis_has_its_slots_alone(pages: list[str]) -> None:
    show(reported())
    (page,) = pages
    assert page.startswith("# The diagnosis\n\n## Where it fails")
    assert "search" not in page


def test_a_learned_law_is_a_chart_with_its_band_and_formula_beside_its_sentence(pages: list[str]) -> None:
    x = np.linspace(-1.0, 1.0, 9)
    law = LawLearned(
        sentence="A voltage.", formula="a i", x_label="i [A]", y_label="leg voltage [V]", x=x, y=0.1 * x,
        y_std=np.full(9, 0.01), y_form=0.1 * x,
    )  # fmt: skip
    shown = _diagnosis.Diagnosis()
    drawn = {one.path for k in range(2) for one in shown.take(law)}
    assert {f"law/{k}/{part}" for k in range(2) for part in ("band", "curve", "formula")} < drawn
    assert shown.laws == 2
    assert pages[-1].count("**y = a i**") == 2


def test_the_words_of_a_page_are_in_printed_characters(monkeypatch: pytest.MonkeyPatch) -> None:
    texts: list[str] = []
    monkeypatch.setattr(rr, "TextDocument", lambda text, **_: texts.append(text))
    _words.page("trust", When(), "| --- |\n- branches differ by +-138 %, R_s 4.3 -> 4.2 ohm")
    assert texts == ["| --- |\n- branches differ by ±138 %, R_s 4.3 → 4.2 Ω"]
