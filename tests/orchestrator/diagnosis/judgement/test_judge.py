"""A verdict follows from its record alone, and its reasons hold the numbers that decided it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis import judge, save_diagnosis
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.judgement.verdict import verdict_limits
from protocols import DiagnosisReport, VerdictRecord
from tests.plugins.streams.report.example_diagnosis import WORDS, a_diagnosis

LIMITS = verdict_limits(Criteria())
SOUND = {
    "chi2_before": 900.0, "chi2_after": 1.01, "degrees_of_freedom": 4000.0, "held_out_chi2": 1.05, "effects": 1,
    "left_of_excitation": 0.001, "gates_off_v": 1e-4, "gates_off_probability": 0.5, "least_excitation_v": 5.0,
    "effect_widths": {"dead_time": 0.4}, "noise_v": 0.003, "excitation_v": 10.0, "current_error": 0.001,
}  # fmt: skip
NONE = {"chi2_before": 1.01, "effects": 0, "effect_widths": {}}
LEFT = {"chi2_after": 2.0, "held_out_chi2": None}
FORMS = {"chi2_after": 9.0, "chi2_before": 9e3, "chi2_in_other_forms": 4.0, "other_forms": ("hysteresis",)}
LARGE = {"dead_time": 2.0, "hysteresis": 1.8, "skin_effect": 1.6}

CASES = [
    (NONE, "clean", "chi2_per_dof"),
    (NONE | {"chi2_before": 1.12, "chi2_after": 1.12, "held_out_chi2": 1.1}, "clean", "chi2_per_dof"),
    (NONE | {"chi2_after": 1.5, "left_of_excitation": 1e-4}, "clean", "chi2_per_dof"),
    (NONE | {"chi2_after": 1.12, "left_of_excitation": 0.02}, "unknown_remains", "effects"),
    (NONE | {"chi2_after": 90.0, "left_of_excitation": 0.02}, "unknown_remains", "effects"),
    ({}, "explained", "chi2_per_dof"),
    ({"chi2_after": 1.3}, "explained", "left_of_first_error_percent"),
    ({"held_out_chi2": 2.0}, "mostly_explained", "held_out_chi2_per_dof"),
    (LEFT, "mostly_explained", "chi2_per_dof"),
    (LEFT | {"chi2_before": 101.0}, "mostly_explained", "left_of_first_error_percent"),
    (LEFT | {"chi2_after": 4.0, "chi2_before": 1e6}, "mostly_explained", "chi2_per_dof"),
    (LEFT | {"chi2_after": 4.0, "chi2_before": 1e6, "left_of_excitation": 0.02}, "unknown_remains", "chi2_per_dof"),
    (LEFT | {"chi2_before": 9.0}, "unknown_remains", "left_of_first_error_percent"),
    (LEFT | {"chi2_after": 8.0, "chi2_before": 1e6}, "unknown_remains", "chi2_per_dof"),
    (LEFT | {"shape_widths": 5.0, "shape_effect": "dead_time"}, "unknown_remains", "shape_widths"),
    (FORMS, "explained_in_another_form", "taken_up_by_other_forms_percent"),
    (FORMS | {"chi2_after": 60.0, "chi2_in_other_forms": 9.0, "chi2_before": 1e6}, "unknown_remains", "chi2_per_dof"),
    (FORMS | {"chi2_in_other_forms": 8.5}, "unknown_remains", "chi2_per_dof"),
    (FORMS | {"chi2_before": 500.0}, "unknown_remains", "chi2_per_dof"),
    (FORMS | {"chi2_before": 80.0}, "unknown_remains", "left_of_first_error_percent"),
    ({"periodic_lines": 2}, "unknown_remains", "periodic_lines"),
    ({"gates_off_v": 0.5, "gates_off_probability": 1e-9}, "unknown_remains", "gates_off_v"),
    ({"chi2_after": 0.01}, "cannot_tell", "chi2_per_dof"),
    (NONE | {"chi2_before": 0.0098, "chi2_after": 0.0098}, "cannot_tell", "chi2_per_dof"),
    (NONE | {"chi2_before": 0.68, "chi2_after": 0.68}, "clean", "chi2_per_dof"),
    ({"noise_v": 2.0}, "cannot_tell", "noise_of_excitation_percent"),
    ({"current_error": 0.46}, "cannot_tell", "current_error_percent"),
    ({"effect_widths": LARGE}, "cannot_tell", "large_effects"),
    (NONE | {"hidden_map_error": 0.02}, "cannot_tell", "hidden_map_error_percent"),
    (NONE | {"map_error": 0.02, "hidden_map_error": 0.001}, "clean", "chi2_per_dof"),
    ({"hidden_map_error": 0.02}, "explained", "chi2_per_dof"),
    ({"noise_v": 2.0, "chi2_after": 90.0, "chi2_before": 91.0}, "unknown_remains", "left_of_first_error_percent"),
]  # fmt: skip


def a_record(**changes: Any) -> VerdictRecord:
    return VerdictRecord.model_validate(SOUND | {"limits": LIMITS} | changes)


@pytest.mark.parametrize(("changes", "verdict", "quantity"), CASES)
def test_a_verdict_has_the_number_that_decided_it_as_its_first_reason(
    changes: dict[str, Any], verdict: str, quantity: str
) -> None:
    judgement = judge(a_record(**changes))
    assert judgement.verdict == verdict
    assert judgement.reasons[0].quantity == quantity


@pytest.mark.parametrize(("changes", "verdict", "quantity"), CASES)
def test_a_written_diagnosis_holds_all_that_its_verdict_follows_from(
    changes: dict[str, Any], verdict: str, quantity: str, tmp_path: Path
) -> None:
    record = a_record(**changes)
    judgement = judge(record)
    report = a_diagnosis(verdict=judgement.verdict, reasons=judgement.reasons, verdict_record=record)
    save_diagnosis(tmp_path, report, WORDS, ())
    written = json.loads((tmp_path / "results" / "diagnosis.json").read_text())["report"]
    again = judge(VerdictRecord.model_validate(written["verdict_record"]))
    assert again.verdict == written["verdict"]
    assert [reason.model_dump() for reason in again.reasons] == written["reasons"]


@pytest.mark.parametrize("changes", [case[0] for case in CASES])
def test_reasons_are_short_sentences_with_their_limit(changes: dict[str, Any]) -> None:
    for reason in judge(a_record(**changes)).reasons:
        assert reason.sentence.endswith(".")
        for sentence in re.split(r"[.:;] (?=[A-Za-z])", reason.sentence):
            assert len(sentence.split()) <= 25, sentence
        if reason.limit is not None and reason.quantity != "gates_off_v":  # which has a prefix
            assert f"{reason.limit:.4g}" in reason.sentence


def test_other_limits_make_another_verdict_of_the_same_record() -> None:
    record = a_record(**LEFT)
    assert judge(record).verdict == "mostly_explained"
    assert judge(record, LIMITS.model_copy(update={"explained_excess_chi2": 2.0})).verdict == "explained"


def test_two_numbers_that_round_alike_are_written_apart() -> None:
    (reason, *_) = judge(a_record(chi2_after=1.4000001, held_out_chi2=None)).reasons
    assert "chi2 1.4000001 per degree of freedom" in reason.sentence
    assert "allows up to 1.4." in reason.sentence


def test_a_fit_without_a_finite_error_explains_nothing() -> None:
    judgement = judge(a_record(chi2_after=None, left_of_excitation=None))
    assert judgement.verdict == "unknown_remains"
    assert "infinite" in judgement.reasons[0].sentence


def test_few_readings_may_differ_from_the_noise_by_chance() -> None:
    few = NONE | {"degrees_of_freedom": 200.0, "held_out_chi2": None}
    judgement = judge(a_record(**few | {"chi2_after": 1.2}))
    assert judgement.verdict == "clean"
    assert judgement.reasons[0].limit == pytest.approx(1.3)
    assert judge(a_record(**few | {"chi2_after": 1.35, "left_of_excitation": 0.02})).verdict == "unknown_remains"


@pytest.mark.parametrize(
    ("equations", "verdict"), [(0, "mostly_explained"), (50, "explained"), (5000, "mostly_explained")]
)
def test_few_held_out_equations_may_differ_from_the_noise_by_chance(equations: int, verdict: str) -> None:
    judgement = judge(a_record(held_out_chi2=1.7, held_out_equations=equations))
    assert judgement.verdict == verdict
    if equations == 50:
        (held_out,) = [r for r in judgement.reasons if r.quantity == "held_out_chi2_per_dof"]
        assert held_out.limit == pytest.approx(1.4 + 3.0 * np.sqrt(2.0 / 50.0))


def test_a_report_of_an_older_version_has_no_reasons_and_keeps_its_notes() -> None:
    old = json.loads(a_diagnosis().model_dump_json())
    for name in ("reasons", "verdict_record", "search", "remarks"):
        del old[name]
    report = DiagnosisReport.model_validate(old)
    assert (report.reasons, report.verdict_record, report.search) == ((), None, ())
    assert report.notes == a_diagnosis().notes


def test_reasons_are_no_remarks() -> None:
    judgement = judge(a_record())
    report = a_diagnosis(reasons=judgement.reasons)
    without = {
        name: value for name, value in report.model_dump(mode="json").items() if name not in ("remarks", "notes")
    }
    again = DiagnosisReport.model_validate(without)
    assert again.reasons == judgement.reasons
    assert again.remarks == ()
