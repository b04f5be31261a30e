"""Entry points are read once, and never too seldom."""

from __future__ import annotations

import importlib.metadata
import os
from pathlib import Path

import pytest

from orchestrator.registry import entry_points
from orchestrator.registry.entry_points import entries_of


def install(folder: Path, name: str) -> None:
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[fluxbench.streams]\n{name} = {name}:Stream\n")


def test_they_are_read_once_while_nothing_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    found = tuple(entries_of("fluxbench.streams"))
    assert {"console", "report"} <= {entry.name for entry in found}
    monkeypatch.setattr(entry_points, "entry_points", None)
    assert tuple(entries_of("fluxbench.streams")) == found
    assert "simulated" in entries_of("fluxbench.drives").names


def test_what_is_installed_meanwhile_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    before = entries_of("fluxbench.streams").names
    assert before == importlib.metadata.entry_points(group="fluxbench.streams").names
    os.utime(tmp_path, ns=(0, 0))  # installed long ago, however fast this machine is
    assert entries_of("fluxbench.streams").names == before
    install(tmp_path, "acme")
    assert entries_of("fluxbench.streams").names == before | {"acme"}


def test_a_folder_on_the_path_that_there_is_not_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path / "nowhere"))
    assert "console" in entries_of("fluxbench.streams").names
