"""One name for each thing: slots, verdicts, rungs, parameters."""

from __future__ import annotations

import pytest

from orchestrator.formatting.names import VERDICTS, parameter_words, rung_name, slots
from protocols import DiagnosisReport, DiagnosisWords


def test_every_verdict_has_its_words() -> None:
    schema = DiagnosisReport.model_json_schema()["properties"]["verdict"]["enum"]
    assert set(VERDICTS) == set(schema)


def test_slots_that_are_filled_come_in_their_order() -> None:
    words = DiagnosisWords(to_decide="b", likely_cause="a", if_added="", what_it_looks_like="", where_it_fails="")
    assert list(slots(words)) == [("likely cause", "a"), ("to decide", "b")]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("bias_a_v", "bias a"),
        ("rise_per_watt", "rise"),
        ("corner_hz", "corner"),
        ("rate_a_a_per_s", "rate a"),
        ("settling_per_s", "settling"),
        ("gain_a_minus_b", "gain a minus b"),
        ("per_watt", "change by power"),
        ("rad_per_nm", "twist by torque"),
        ("leg_a_longer", "leg a longer"),
    ],
)
def test_a_parameter_is_reported_without_its_unit(name: str, words: str) -> None:
    assert parameter_words(name) == words


def test_a_rung_is_named_by_what_was_added() -> None:
    assert [rung_name(None, 0), rung_name("dead_time", 1), rung_name(None, 2)] == [
        "the model alone",
        "+ dead time",
        "refitted",
    ]
