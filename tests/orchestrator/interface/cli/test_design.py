"""`fluxbench design` from outside: a file that check and run take, and what is wrong in one line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.support.processes import called
from tests.support.tiny import tiny_file

PAIR = ("current_offset", "voltage_bias")


def test_what_is_designed_is_a_procedure_that_check_takes(tmp_path: Path) -> None:
    out = tmp_path / "shortest.yaml"
    done = called("design", tiny_file(tmp_path), *PAIR, "--out", out)
    assert done.returncode == 0, done.stderr
    assert "largest directional derivative" in done.stdout
    assert max(map(len, done.stdout.splitlines()[:-1])) <= 100
    checked = called("check", out)
    assert checked.returncode == 0, checked.stderr
    assert "gates_off" in checked.stdout


@pytest.mark.slow
def test_what_it_will_tell_is_reported_as_json_too(tmp_path: Path) -> None:
    out = tmp_path / "shortest.yaml"
    result = json.loads(called("design", tiny_file(tmp_path), *PAIR, "--out", out, "--json").stdout)
    assert result["out"] == str(out)
    assert result["points"] > 0
    assert result["duration_s"] > 0.0
    assert set(result["found_at"]) == set(PAIR)
    assert {one["effect"] for one in result["parted_at"]} <= set(PAIR)


@pytest.mark.slow
def test_it_runs_and_its_diagnosis_names_the_one_that_is_there(tmp_path: Path) -> None:
    out, run = tmp_path / "shortest.yaml", tmp_path / "run"
    assert called("design", "demo", *PAIR, "--out", out).returncode == 0
    hidden = "drive.plant.effects={voltage_bias: {bias_a_v: 0.1, bias_b_v: 0.0}}"
    assert called("run", out, "--out", run, "--set", hidden).returncode == 0
    output = called("diagnose", run).stdout
    assert "likely cause        voltage bias" in output
    assert not re.search("current.offset", output)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["ded_time", "--out", "a.yaml"], "dead_time"),
        (["saturation", "--out", "a.yaml"], "saturation"),
        (["dead_time", "--out", "."], "--out"),
        (["dead_time", "--out", "nowhere/a.yaml"], "nowhere/a.yaml"),
        (["rotor_misalignment", "slot_harmonics", "--out", "a.yaml"], "rotor_misalignment or slot_harmonics"),
        (["dead_time", "--out", "a.yaml", "--size", "0"], "--size"),
    ],
)
def test_wrong_words_are_one_line_and_nothing_is_written(words: list[str], message: str, tmp_path: Path) -> None:
    done = called("design", tiny_file(tmp_path), *words, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert message in done.stderr
    assert not (tmp_path / "a.yaml").exists()
