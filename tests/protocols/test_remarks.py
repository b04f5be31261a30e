"""A remark's figures are its sentence's; what was written before remarks had codes is read."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pydantic import TypeAdapter

from protocols import (
    Diagnosed,
    EstimationReport,
    JournalledMessage,
    Remark,
    ResistanceEstimate,
    ResistanceEstimated,
    RunEnded,
)

JOURNALLED: TypeAdapter[Any] = TypeAdapter(JournalledMessage)

OLD_ESTIMATES = {
    "resistance": {"value_ohm": 4.3, "low": 4.2, "high": 4.4, "first_ohm": 4.3, "last_ohm": 4.3},
    "method": "energy",
    "crossings": {"d_percent": 0.4, "q_percent": None},
    "parity": None,
    "reciprocity_percent": None,
    "classical_against_injection_percent": 1.0,
    "usable": True,
    "reasons": ["energy: the flux is known to +-0.11 % of the rated flux (95 %, over the map)"],
    "files": {"flux_map": "results/flux_map.nc"},
}
OLD_DIAGNOSIS = {
    "recording": "old",
    "noise_floor": {"rms_v": 0.004},
    "verdict": "clean",
    "effects": [],
    "traces": [],
    "joint": [],
    "ladder": [],
    "unexplained": {"fraction": 0.0, "shape": []},
    "next_experiment": None,
    "notes": ["no gates-off reading"],
    "seconds": 1.0,
}


def test_a_sentence_is_made_of_its_values() -> None:
    remark = Remark.of("apart", "{axis} differs by {apart_percent:.1f} %", axis="d", apart_percent=1.26)
    assert remark == Remark(code="apart", values={"axis": "d", "apart_percent": 1.26}, text="d differs by 1.3 %")
    assert remark.by("energy") == Remark(code="energy.apart", values=remark.values, text="energy: d differs by 1.3 %")


def test_a_sentence_without_one_of_its_values_is_a_defect() -> None:
    with pytest.raises(KeyError, match="apart_percent"):
        Remark.of("apart", "differs by {apart_percent:.1f} %")


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_value_that_is_no_number_is_null(value: float) -> None:
    assert Remark(code="c", values={"x": value, "name": "12"}, text="t").values == {"x": None, "name": "12"}


def test_reports_print_their_remarks_and_the_sentences_alone() -> None:
    printed = json.loads(EstimationReport.model_validate(OLD_ESTIMATES).model_dump_json())
    assert printed["reasons"] == OLD_ESTIMATES["reasons"]
    assert [remark["text"] for remark in printed["remarks"]] == OLD_ESTIMATES["reasons"]
    assert EstimationReport.model_validate(printed).model_dump(mode="json") == printed


def test_messages_of_older_journals_are_read() -> None:
    words = dict.fromkeys(("where_it_fails", "what_it_looks_like", "likely_cause", "if_added", "to_decide"), "text")
    diagnosed = JOURNALLED.validate_python({"kind": "diagnosed", "round": 0, "report": OLD_DIAGNOSIS, "words": words})
    assert isinstance(diagnosed, Diagnosed)
    assert diagnosed.report.notes == ("no gates-off reading",)
    reading = {"start_s": 0.0, "value_ohm": 4.3, "std_ohm": 0.01}
    resistance = {**OLD_ESTIMATES["resistance"], "readings": [reading], "notes": ["no DC holds"]}  # type: ignore[dict-item]
    message = JOURNALLED.validate_python({"kind": "resistance_estimated", "estimate": resistance})
    assert isinstance(message, ResistanceEstimated)
    assert [remark.text for remark in message.estimate.remarks] == ["no DC holds"]


@pytest.mark.parametrize(("written", "usable"), [({}, None), (OLD_ESTIMATES, True)])
def test_older_ends_of_runs_are_read(written: dict[str, object], usable: bool | None) -> None:
    end = {"kind": "run_ended", "outcome": "finished", "reason": "", "run": "r", "estimates": written}
    ended = JOURNALLED.validate_python(end)
    assert isinstance(ended, RunEnded)
    assert (ended.estimates and ended.estimates.usable) == usable


def test_an_estimate_takes_remarks_alone() -> None:
    given = (Remark(code="no_holds", text="no DC holds"),)
    values = {"value_ohm": 4.3, "low": 4.2, "high": 4.4, "first_ohm": 4.3, "last_ohm": 4.3}
    assert ResistanceEstimate(**values, readings=(), remarks=given).remarks == given
