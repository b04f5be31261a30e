"""The moves of a search as rows: one unit for a gain and its threshold, and no more digits than needed."""

from __future__ import annotations

from orchestrator.diagnosis.fitting.progress import SearchRecorder
from orchestrator.diagnosis.reporting.explanation import explanation_of
from orchestrator.formatting.explaining import (
    accuracy_sentences,
    basis_head,
    basis_rows,
    limit_notes,
    log_evidence_notes,
    reason_sentences,
    search_legend,
    search_lines,
    search_rows,
)
from protocols import EffectBasis, Reason, SearchEvent
from tests.orchestrator.diagnosis.judgement.test_judge import a_record
from tests.plugins.streams.report.example_diagnosis import a_diagnosis


def some_moves() -> SearchRecorder:
    recorder = SearchRecorder()
    recorder.record("full_model", [f"effect_{k}" for k in range(23)], taken=True)
    recorder.of_part().record(
        "add", ["dead_time"], measure="log_evidence", score=12820.4, threshold=16.0, taken=False, note="too small"
    )
    recorder.record("screen", ["skin_effect"], measure="chi2", score=4.2056, threshold=32.0, taken=False)
    recorder.record("remove", ["hysteresis"], measure="block_scatter", score=0.31, threshold=0.2, taken=True)
    recorder.record("quantiser", measure="chi2_per_dof", score=1.234567, threshold=1.5, taken=True)
    return recorder


def test_a_gain_stands_beside_its_threshold_in_one_unit() -> None:
    rows = search_rows(some_moves().events)
    assert rows[0][1:4] == ("full model", "whole", "effect 0, effect 1, effect 2 and 20 more")
    assert rows[1] == ("2", "add", "part", "dead time", "12820 nat", "16 nat", "–", "rejected: too small")
    assert rows[2][4:6] == ("Δchi2 4.21", "Δchi2 32")
    assert rows[3][4:6] == ("31 %", "20 %")
    assert rows[4][3:6] == ("–", "chi2 1.23", "chi2 1.5")


def test_a_screen_and_a_refit_say_what_follows_and_large_gains_are_short() -> None:
    recorder = SearchRecorder()
    recorder.record("screen", ["dead_time"], measure="chi2", score=3.546e8, threshold=3.66e7, taken=None)
    recorder.record("refit", ["dead_time"], measure="log_evidence", score=242829.0, threshold=16.0, taken=None)
    recorder.record("screen", ["bus_sag"], measure="chi2", score=22.6, threshold=32.8, taken=False)
    rows = search_rows(recorder.events)
    assert [row[-1] for row in rows] == ["refitted next", "compared", "too small"]
    assert rows[0][4:6] == ("Δchi2 3.55·10⁸", "Δchi2 3.66·10⁷")
    assert rows[1][4] == "2.43·10⁵ nat"


def test_a_legend_explains_the_moves_and_gains_that_occur() -> None:
    legend = search_legend(some_moves().events)
    assert [line.partition(":")[0] for line in legend] == [
        "recording", "full model", "add", "screen", "quantiser", "nat", "Δchi2", "%", "chi2",
    ]  # fmt: skip


def test_a_move_is_a_line() -> None:
    lines = search_lines(some_moves().events)
    assert (
        lines[1] == "2. add on a part of the recording: dead time; gain 12820 nat (needed 16 nat); rejected: too small"
    )
    assert lines[4] == "5. quantiser; gain chi2 1.23 (needed chi2 1.5); accepted"


def test_how_well_the_model_does_is_stated_where_it_is_known() -> None:
    current, flux = accuracy_sentences(a_diagnosis(reproduces_current_percent=0.0558, map_error_percent=0.12))
    assert "0.056 % of its range" in current
    assert "±0.12 % of the rated flux" in flux
    assert accuracy_sentences(a_diagnosis()) == []
    (flux,) = accuracy_sentences(a_diagnosis(verdict="unknown_remains", map_error_percent=0.12))
    assert flux.startswith("If the model is right, ")


def test_a_value_beside_two_limits_is_one_sentence() -> None:
    sentences = [
        "The fitted stages have chi2 2 per degree of freedom; explained allows up to 1.5.",
        "60 % of the first error is left; explained allows up to 30 %.",
        "The fitted stages have chi2 2 per degree of freedom; mostly explained allows up to 2.5.",
        "No effect explains a part.",
    ]
    assert reason_sentences([Reason(quantity="x", value=1.0, limit=None, sentence=s) for s in sentences]) == [
        f"{sentences[0].removesuffix('.')}, mostly explained allows up to 2.5.",
        *sentences[1::2],
    ]


def test_a_limit_stands_in_the_head_of_its_column_where_the_search_compared_with_it() -> None:
    recorder = SearchRecorder()
    for limit in (16.0, 16.0):
        recorder.record("add", ["dead_time"], measure="log_evidence", score=812.0, threshold=limit, taken=True)
    recorder.record("name", ["bus_sag"], measure="share", score=0.5, threshold=0.57, taken=False)
    record = a_record()
    explained = explanation_of(a_diagnosis(search=recorder.events, verdict_record=record))
    heads = [head.split("\n") for head in basis_head(explained)]
    assert heads[2:4] == [["error without it", " ", " "], ["log evidence", "> 16 nat", " "]]
    assert heads[5] == ["material", "> 0.2 % of flux", "or 0.5 % of voltage"]
    assert len(limit_notes(explained)) == 1
    recorder.record("name", ["dead_time"], measure="share", score=0.9, threshold=0.05, taken=True)
    named = explanation_of(a_diagnosis(search=recorder.events))
    assert (basis_head(named)[2], basis_head(named)[5]) == ("error without it\n> 5 %", "material\n ")
    assert len(limit_notes(named)) == 2


def test_evidence_of_a_part_of_the_recording_is_marked_and_the_mark_explained() -> None:
    common = {"effects": ("dead_time",), "measure": "log_evidence", "score": 812.0, "decision": "accepted",
              "evaluations": 1.0, "seconds": 1.0, "move": "add", "step": 1}  # fmt: skip
    part, whole = ([SearchEvent.model_validate(common | {"data": data})] for data in ("part", "whole"))
    basis = EffectBasis(
        name="dead_time", relative_size=1.0, log_evidence=812.0, probability=1.0, share=1.0, material=True, twins=(),
        steps=(1,),
    )  # fmt: skip
    assert [basis_rows([basis], events)[0][3] for events in (part, whole)] == ["812 nat (part)", "812 nat"]
    assert [len(log_evidence_notes([basis], events)) for events in (part, whole)] == [2, 1]
