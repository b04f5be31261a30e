"""Provenance: true, quick to ask for, and silent about checkouts that are not the project's."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from orchestrator.registry.plugins import PluginKind, installed
from orchestrator.runs import Provenance, provenance
from orchestrator.runs._provenance import _git_state
from tests.support.tiny import STAGES, run_tiny


def git(folder: Path, *words: str) -> str:
    identity = ["-c", "user.name=t", "-c", "user.email=t@example.org"]
    command = ["git", "-C", str(folder), *identity, *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def test_versions_are_those_that_are_running() -> None:
    found = provenance(installed(PluginKind.DRIVES))
    assert found.packages["numpy"] == np.__version__
    assert found.python == platform.python_version()
    assert "simulated" in {plugin.name for plugin in found.plugins}
    assert not any(" " in name or ">" in name for name in found.packages)
    assert Provenance.model_validate_json(found.model_dump_json()) == found


def test_a_checkout_is_named_by_its_commit_and_whether_it_was_changed(tmp_path: Path) -> None:
    git(tmp_path, "init", "-q")
    (tmp_path / "a").write_text("1")
    git(tmp_path, "add", "a")
    git(tmp_path, "commit", "-q", "-m", "x")
    clean = _git_state(tmp_path)
    assert clean is not None
    assert clean.sha == git(tmp_path, "rev-parse", "HEAD")
    assert not clean.dirty
    (tmp_path / "untracked").touch()
    assert _git_state(tmp_path) == clean
    (tmp_path / "a").write_text("2")
    changed = _git_state(tmp_path)
    assert changed is not None
    assert changed.dirty


def test_a_package_inside_somebody_elses_checkout_has_none(tmp_path: Path) -> None:
    git(tmp_path, "init", "-q")
    (tmp_path / "site-packages").mkdir()
    assert _git_state(tmp_path / "site-packages") is None


def test_without_git_there_is_no_state_and_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / ".git").mkdir()
    assert _git_state(tmp_path) is None
    monkeypatch.setenv("PATH", "")
    assert _git_state(tmp_path) is None


def test_a_run_says_nothing_of_who_made_it_or_of_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secrets = {"HOME": "/home/lovelace", "USER": "lovelace", "LOGNAME": "lovelace", "API_TOKEN": "hush-hush"}
    for name, value in secrets.items():
        monkeypatch.setenv(name, value)
    run = run_tiny(tmp_path, stages=STAGES[:1]).path
    for file in ("run.json", "recording.json"):
        text = (run / file).read_text(encoding="utf-8")
        found = [secret for secret in {*secrets.values(), str(Path.cwd()), str(tmp_path), sys.prefix} if secret in text]
        assert found == [], file
