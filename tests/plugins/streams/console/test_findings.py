"""Comparison and diagnosis on the console: a line each, the ladder as it falls, the five slots, JSON for programs."""

from __future__ import annotations

import io
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from orchestrator.analysis import PhaseLoss
from plugins.estimators._maps import SweptFlux
from plugins.streams.console import ConsoleOptions, ConsoleStream
from plugins.streams.console._lines import without_arrays
from plugins.streams.console._words import step_bar, summary_rows
from protocols import (
    Basis,
    Compared,
    Diagnosed,
    DiagnosisWords,
    ExperimentProposed,
    FluxMapEstimate,
    FluxPoints,
    MapChecks,
    MapEstimated,
    MapReport,
    Message,
    NoiseFloor,
    Remark,
    RunEnded,
    StateChanged,
    StreamSetup,
)
from tests.plugins.streams.example_run import a_map, a_report
from tests.plugins.streams.report.example_diagnosis import WORDS, a_comparison, a_diagnosis, some_steps

REMARK = Remark(code="apart", values={"apart_percent": 1.5}, text="they differ by 1.5 %")
COMPARED = Compared(report=a_comparison())
DIAGNOSED = Diagnosed(round=0, report=a_diagnosis(), words=WORDS)
PROPOSED = ExperimentProposed(
    round=0, stage={"kind": "resistance"}, separates=("dead_time", "device_drop"), minutes=0.27, accepted=True
)
MESSAGES: list[Message] = [
    StateChanged(source="estimating", target="comparing"),
    COMPARED,
    *some_steps(),
    DIAGNOSED,
    PROPOSED,
]


class Output(io.StringIO):
    terminal = False

    def isatty(self) -> bool:
        return self.terminal


def printed(monkeypatch: pytest.MonkeyPatch, run: Path, messages: list[Message], mode: str, columns: int = 120) -> str:
    output = Output()
    output.terminal = mode == "live"
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", str(columns))
    stream = ConsoleStream(StreamSetup(run=run, options=ConsoleOptions.model_validate({"mode": mode})))
    for message in messages:
        stream.receive(message)
    stream.close()
    return output.getvalue()


def test_plain_lines_tell_the_story_of_a_diagnosis(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert printed(monkeypatch, tmp_path, MESSAGES, "plain").splitlines() == [
        "comparison: the saturated model, over all stages: error 1.73 V rms, noise floor 3.45 mV, chi2 54890; "
        "worst in resistance-022: 1.48 V rms, noise floor there 440 µV",
        "the model alone           chi2    5489  fitted   300 mV  held out   350 mV",
        "+ dead time               chi2    1.02  fitted   4.1 mV  held out   4.2 mV",
        "diagnosis: explained",
        "where it fails      worst in resistance-002: 1480 mV rms",
        "what it looks like  An odd step in each phase current.",
        "likely cause        dead time (voltage_v 0.4 V, 95 % −0.399 to 0.401)",
        "if added            held-out error 350 → 4.2 mV; R_s 4.6 → 4.31 Ω",
        "to decide           resistance stage of 0.27 min",
        "next experiment: resistance, 16 s, separates dead time from device drop; the run continues with it",
    ]


def test_a_terminal_sees_the_error_fall_in_colour(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    text = printed(monkeypatch, tmp_path, MESSAGES, "live")
    assert "\x1b[31m━" in text  # red far above the noise
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    before, after = (next(line for line in plain.splitlines() if name in line) for name in ("alone", "+ dead time"))
    assert before.count("━") > 10
    assert after.count("━") <= 1
    assert "✓ diagnosis" in plain
    assert "likely cause" in plain
    assert "next experiment: resistance" in plain


def test_a_narrow_terminal_cuts_the_ladder_instead_of_folding_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    text = printed(monkeypatch, tmp_path, list(some_steps()), "live", columns=60)
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    assert sum("chi2" in line for line in plain.splitlines()) == 2


def test_quiet_leaves_a_diagnosis_to_the_results(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert printed(monkeypatch, tmp_path, MESSAGES, "quiet") == ""


def test_json_lines_hold_no_arrays_and_nothing_as_long_as_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = a_map("energy")
    points = FluxPoints(i_dq=found.psi_d[:2, :2], psi_dq=found.psi_d[:2, :2], segment=("a", "b"))
    estimated = MapEstimated(estimate=FluxMapEstimate(map=found, points=points, checks=MapChecks(), remarks=[REMARK]))
    lines = printed(monkeypatch, tmp_path, [*MESSAGES, estimated], "jsonl").splitlines()
    objects = [json.loads(line) for line in lines]
    assert [o["kind"] for o in objects] == [m.kind for m in [*MESSAGES, estimated]]
    assert max(map(len, lines)) < 6000
    step = objects[2]
    assert step["chi2"] == 5489.0
    assert not {"stage", "time_s", "i_dq", "residual_abc_v", "noise_v"} & step.keys()
    assert step["excerpts"][0] == {
        "segment": "injection-001",
        "stage": "injection",
        "i_d_a": -0.01,
        "i_q_a": 0.0,
        "amplitude_v": 20.0,
    }
    assert step["resistance"] == {}
    assert objects[-1]["estimate"]["map"] == {"method": "energy", "basis": "energy"}
    assert objects[-1]["estimate"]["points"] == {}
    assert objects[-1]["estimate"]["remarks"] == [REMARK.model_dump()]
    assert objects[-3]["words"] == WORDS.model_dump()


def test_json_lines_leave_out_what_an_estimator_keeps_for_itself(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    found = a_map("energy")
    loss = PhaseLoss(np.arange(3.0), np.arange(3.0))
    points = FluxPoints(i_dq=found.psi_d[:2, :2], psi_dq=found.psi_d[:2, :2], segment=("a", "b"))
    swept = SweptFlux(map=found, points=points, checks=MapChecks(), paths=(), loss=loss)
    (line,) = printed(monkeypatch, tmp_path, [MapEstimated(estimate=swept)], "jsonl").splitlines()
    assert json.loads(line)["estimate"]["map"] == {"method": "energy", "basis": "energy"}
    assert "loss" not in json.loads(line)["estimate"]


def test_a_message_without_arrays_is_whole() -> None:
    assert without_arrays(DIAGNOSED) == DIAGNOSED.model_dump(mode="json")


@pytest.mark.parametrize("mode", ["plain", "live"])
def test_what_an_effect_remarks_is_below_the_diagnosis(
    mode: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    report = a_diagnosis()
    remark = Remark(code="leg_differs", text="leg b's is longer").by(report.effects[0].name)
    message = Diagnosed(round=0, report=report.model_copy(update={"remarks": (remark,)}), words=WORDS)
    assert "leg b's is longer" in printed(monkeypatch, tmp_path, [message], mode)


def test_a_report_that_says_little_is_reported_all_the_same(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    bare = a_comparison().model_copy(
        update={"chi2": None, "rms_v": None, "worst": (), "noise_floor": NoiseFloor(rms_v=None)}
    )
    silent = DiagnosisWords(**dict.fromkeys(DiagnosisWords.model_fields, ""))
    empty: list[Message] = [Compared(report=bare), Diagnosed(round=2, report=a_diagnosis(), words=silent)]
    assert printed(monkeypatch, tmp_path, empty, "plain").splitlines() == [
        "comparison: the saturated model, over all stages: error – rms, noise floor –, chi2 –",
        "diagnosis: explained, after experiment 2",
    ]
    assert printed(monkeypatch, tmp_path, empty, "live")


def test_a_bar_is_as_long_as_the_error_has_decades_above_the_noise() -> None:
    step = some_steps()[0]
    for error, cells in ((1e-3, 0), (0.004, 0), (0.04, 8), (4.0, 24), (4e3, 24)):
        assert len(step_bar(step.model_copy(update={"heldout_rms_v": error}), 24)) == cells


def test_a_long_remark_is_one_line_and_numbers_are_typeset() -> None:
    wall = "moved " + ", ".join(f"-{k} +- 0.1 deg" for k in range(30))
    remarks = [Remark(code="moved", text=text) for text in ("moved -0.2 +- 0.1 deg", wall)]
    changes = {"method": "energy", "reciprocity_percent": 0.002, "remarks": remarks}
    energy = {"energy": MapReport(basis=Basis.ENERGY, checks=MapChecks())}
    estimates = a_report().model_copy(update={**changes, "maps": energy})
    ended = RunEnded(outcome="finished", reason="", run="r", estimates=estimates)
    rows = list(summary_rows(ended, Path("runs/r")))
    assert ("remarks", "moved −0.2 ± 0.1 deg") in rows
    assert ("reciprocity", "0.002 % (by construction)") in rows
    assert max(len(text) for _, text in rows) < 270
    assert any(text.endswith("(in full in the report)") for _, text in rows)
