"""`fluxbench fleet`: words in, a table out, and one line for whatever does not go together."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from orchestrator.interface.cli._running import run_app
from tests.orchestrator.fleet.small import damage, small_recordings


def test_without_a_source_it_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["fleet"]) == 2
    assert "SOURCE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--do", "divine"], "divine"),
        (["--do", "import"], "--mapping"),
        (["--do", "export"], "--keep"),
        (["--do", "import", "--mapping", "nowhere.yaml"], "nowhere.yaml: no such file"),
    ],
)
def test_what_does_not_go_together_is_one_line(
    tmp_path: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_app(["fleet", str(tmp_path), "--out", str(tmp_path / "table"), *words]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (tmp_path / "table").exists()


@pytest.mark.parametrize("module", ["fsspec.core", "distributed"])
def test_what_is_not_installed_is_stated_with_what_installs_it(
    tmp_path: Path, module: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    small_recordings(tmp_path / "bench", 1)
    monkeypatch.setitem(sys.modules, module, None)
    assert run_app(["fleet", str(tmp_path / "bench"), "--out", str(tmp_path / "table")]) == 2
    error = capsys.readouterr().err
    assert "pip install 'fluxbench[fleet]'" in error
    assert error.count("\n") == 1


@pytest.mark.slow
def test_a_folder_becomes_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damage(small_recordings(tmp_path / "bench", 4)[2])
    words = ["fleet", str(tmp_path / "bench"), "--out", str(tmp_path / "table"), "--jobs", "1"]
    assert run_app([*words, "--limit", "3", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["sources"], report["new"], report["known"]) == (3, 3, 0)
    assert "sha256" in report["failed"][0]["problem"]
    assert run_app(["fleet", "run", *words[1:]]) == 0
    output = capsys.readouterr()
    assert "4 recordings: 1 new row; 3 known, 1 of them failed (--retry-failed does those again)" in output.out
    assert output.err == ""
    assert run_app(["fleet", "--help"]) == 0
    assert "report" in capsys.readouterr().out
