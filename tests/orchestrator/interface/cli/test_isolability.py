"""`fluxbench check --isolability` from outside: tables that fit a terminal, JSON, and what is wrong in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.processes import called
from tests.support.tiny import tiny_file


@pytest.mark.slow
def test_what_a_plan_will_tell_fits_a_terminal_and_energises_nothing(tmp_path: Path) -> None:
    done = called("check", tiny_file(tmp_path), "--isolability", "--noise", "0.02")
    assert done.returncode == 0, done.stderr
    _, _, message = done.stdout.partition("nothing was energised")
    assert max(map(len, message.splitlines())) <= 100
    for words in ("20 mA of noise", "dead_time", "separated from", "to add, as stages"):
        assert words in message


@pytest.mark.slow
def test_all_of_it_is_in_the_json(tmp_path: Path) -> None:
    report = json.loads(called("check", tiny_file(tmp_path), "--isolability", "--json").stdout)
    names = [effect["name"] for effect in report["effects"]]
    assert len(report["pairs"]) == len(names) * (len(names) - 1) // 2
    assert all(addition["minutes"] > 0.0 for addition in report["additions"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--noise", "0.01"], "--isolability"),
        (["--isolability", "--noise", "0"], "--noise"),
        (["--isolability", "--model", "linear"], "--model"),
        (["--isolability", "--model", "nowhere.json"], "nowhere.json"),
        (["--isolability", "--set", "motor.d_inductance_h=null"], "d_inductance_h"),
    ],
)
def test_wrong_words_are_one_line(words: list[str], message: str, tmp_path: Path) -> None:
    done = called("check", tiny_file(tmp_path), *words)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert message in done.stderr
