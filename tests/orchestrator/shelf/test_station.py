"""A station: one motor after the other, judged, with a label line and a result for what collects results."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest

from orchestrator.shelf import judge_run, run_folder_of, work_through, write_junit
from protocols import DriveFault, FaultCause, InputError
from tests.orchestrator.shelf.example_runs import a_run

ACCEPT = {"max_resistance_ohm": 4.3, "verdicts": ["clean", "explained"]}


def test_the_label_has_serial_number_judgement_and_what_was_measured(tmp_path: Path) -> None:
    good = judge_run(a_run(tmp_path / "good", accept=ACCEPT, about={"serial": "PM-7"}))
    assert good.exit_code == 0
    assert good.label.startswith("PM-7  PASS  400 W test PMSM  R_s 4.250 Ω  L_dd 43.00 mH  L_qq 69.00 mH  rated flux ")
    assert good.label.endswith("  good")
    bad = judge_run(a_run(tmp_path / "bad", accept=ACCEPT, r_s=4.4))
    assert bad.exit_code == 4
    assert bad.label.startswith("no serial number  FAIL")


def test_a_run_without_limits_or_without_an_end_is_not_judged(tmp_path: Path) -> None:
    for name, outcome, accept in (("free", "finished", None), ("faulted", "faulted", ACCEPT)):
        judged = judge_run(a_run(tmp_path / name, outcome=outcome, accept=accept))
        assert (judged.acceptance, judged.exit_code) == (None, 0)
        assert f"  {outcome}  " in judged.label


def test_results_are_junit_xml_with_a_case_for_each_quantity(tmp_path: Path) -> None:
    runs = [
        a_run(tmp_path / "good", accept=ACCEPT, about={"serial": "PM-<1>&\x07"}),
        a_run(tmp_path / "bad", accept=ACCEPT, about={"serial": "PM-2"}, r_s=4.4, verdict=None),
        a_run(tmp_path / "faulted", accept=ACCEPT, outcome="faulted"),
    ]
    write_junit(tmp_path / "out.xml", [judge_run(run) for run in runs])
    root = ET.parse(tmp_path / "out.xml").getroot()
    counts = [[suite.get(name) for name in ("name", "tests", "failures", "errors")] for suite in root]
    assert counts == [["PM-<1>&?", "2", "0", "0"], ["PM-2", "2", "2", "0"], ["faulted", "1", "0", "1"]]
    cases = [(case.get("classname"), case.get("name"), [part.tag for part in case]) for case in root.iter("testcase")]
    assert cases[2:] == [
        ("tiny.PM-2", "resistance_ohm", ["failure"]),
        ("tiny.PM-2", "verdict", ["failure"]),
        ("tiny.faulted", "finished", ["error"]),
    ]
    failure = root.find(".//testsuite[@name='PM-2']//failure")
    assert failure is not None
    assert failure.get("message") == "R_s 4.400 Ω (95 %: 4.390 to 4.410): too large, limit at most 4.3 Ω"


@pytest.mark.parametrize(
    ("serial", "name"),
    [("PM-1", "-PM-1-"), ("../../etc", "-etc-"), ("a b/c", "-a-b-c-"), ("", "tiny-2"), ("ß", "tiny-2")],
)
def test_a_run_s_folder_has_the_serial_number_in_its_name(serial: str, name: str) -> None:
    folder = run_folder_of("tiny", serial)
    assert folder.parent == Path("runs")
    assert name in folder.name
    assert len(run_folder_of("tiny", "x" * 500).name) < 100


def fault(serial: str) -> int:
    raise DriveFault(FaultCause.OVERCURRENT, serial)


@pytest.mark.parametrize(
    ("results", "code"),
    [
        ([], 0),
        ([lambda _: 0, lambda _: 0], 0),
        ([lambda _: 4, lambda _: 0], 4),
        ([fault, lambda _: 4], 3),
        ([lambda _: 130, fault], 130),
    ],
)
def test_the_queue_ends_with_the_worst_result(results: list[Callable[[str], int]], code: int) -> None:
    serials = iter([*(f"PM-{k}" for k in range(len(results))), ""])
    complaints: list[str] = []
    given = iter(results)
    assert work_through(lambda: next(serials), lambda serial: next(given)(serial), complaints.append) == code
    assert len(complaints) == (code == 3)


def test_an_input_that_would_end_every_run_ends_the_queue() -> None:
    def refuse(serial: str) -> int:
        raise InputError("tiny.yaml", "", "wrong")

    with pytest.raises(InputError, match="wrong"):
        work_through(lambda: "PM-1", refuse, print)
