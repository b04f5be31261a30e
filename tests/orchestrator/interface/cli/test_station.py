"""Limits of a procedure decide about the exit code, and a queue about the next motor."""

from __future__ import annotations

import io
import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.processes import called
from tests.support.tiny import tiny_document

STAGES: list[dict[str, Any]] = [{"kind": "gates_off", "duration_s": 0.02}]


def procedure(folder: Path, accept: dict[str, Any] | None) -> Path:
    document = tiny_document(stages=STAGES) | ({} if accept is None else {"accept": accept})
    (folder / "tiny.yaml").write_text(yaml.safe_dump(document))
    return folder / "tiny.yaml"


def test_a_motor_that_was_not_measured_does_not_pass(tmp_path: Path) -> None:
    file = procedure(tmp_path, {"max_resistance_ohm": "4300 mOhm"})
    done = called("run", file, "--out", tmp_path / "run", "--serial", "PM-1", "--junit", tmp_path / "out.xml")
    assert done.returncode == 4
    assert "PM-1  FAIL  400 W test PMSM" in done.stdout
    reason = "R_s not measured: does not pass, limit at most 4.3 Ω"
    assert done.stderr == f"fluxbench: not accepted: {reason}\n"
    failure = ET.parse(tmp_path / "out.xml").find(".//failure")
    assert failure is not None
    assert failure.get("message") == reason
    again = called("resume", tmp_path / "run", "--json")
    assert again.returncode == 4
    acceptance = json.loads(again.stdout)["acceptance"]
    assert (acceptance["passed"], acceptance["reasons"][0]["quantity"]) == (False, "resistance_ohm")
    (row,) = json.loads(called("runs", "--folder", tmp_path, "--where", "accepted=fail", "--json").stdout)
    assert row["objections"] == reason


def test_a_run_without_limits_ends_as_before(tmp_path: Path) -> None:
    done = called(
        "run", procedure(tmp_path, None), "--out", tmp_path / "run", "--json", "--junit", tmp_path / "out.xml"
    )
    assert done.returncode == 0
    assert json.loads(done.stdout)["acceptance"] is None
    assert ET.parse(tmp_path / "out.xml").find(".//testcase[@name='finished']") is not None


def test_limits_are_typed_and_may_be_set_from_the_command_line(tmp_path: Path) -> None:
    done = called("run", procedure(tmp_path, None), "--out", tmp_path / "run", "--set", "accept.max_resistance_om=4")
    assert done.returncode == 2
    assert "did you mean 'max_resistance_ohm'" in done.stderr


@pytest.mark.parametrize("option", [("--out", "x"), ("--serial", "PM-1"), ("--json",), ("--remote", "page")])
def test_a_queue_excludes_what_belongs_to_one_motor(tmp_path: Path, option: tuple[str, ...]) -> None:
    done = called("run", procedure(tmp_path, None), "--queue", *option)
    assert done.returncode == 2
    assert "excludes" in done.stderr


def test_a_queue_takes_serial_numbers_until_there_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    procedure(tmp_path, {"verdicts": ["clean"]})
    monkeypatch.setattr("sys.stdin", io.StringIO("PM-1\n PM/2  x \n\n"))
    done = called("run", "tiny.yaml", "--queue", "--quiet", "--junit", "out.xml", cwd=tmp_path)
    assert done.returncode == 4
    assert done.stdout.count("serial number of the next motor") == 3
    assert done.stderr.count("not accepted: verdict not diagnosed") == 2
    suites = [suite.get("name") for suite in ET.parse(tmp_path / "out.xml").getroot()]
    assert suites == ["PM-1", "PM/2 x"]
    rows = json.loads(called("runs", "--json", cwd=tmp_path).stdout)
    assert [row["serial"] for row in rows] == suites
    assert "tiny-PM-2-x-" in rows[1]["run"]
