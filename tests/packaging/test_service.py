"""The services start the page as its command takes it, and give a run the time to end by itself."""

from __future__ import annotations

import configparser
import inspect
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import pytest

from plugins.commands.serve import _command
from plugins.commands.serve._run import RunOfThePage

FOLDER = Path(__file__).parents[2] / "packaging" / "service"
RUN_END_S = inspect.signature(RunOfThePage.close).parameters["timeout_s"].default


def unit() -> configparser.ConfigParser:
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(FOLDER / "fluxbench.service")
    return parser


def service() -> ElementTree.Element:
    return ElementTree.parse(FOLDER / "fluxbench.xml").getroot()


def started(words: Sequence[str], monkeypatch: pytest.MonkeyPatch, folder: Path) -> tuple[Path, int]:
    """Folder and port with which these words start the page."""
    calls: list[tuple[Path, int]] = []

    def serve_page(folder: Path, host: str, port: int) -> int:
        calls.append((folder, port))
        return 0

    monkeypatch.setattr("plugins.commands.serve._server.serve_page", serve_page)
    assert words[0] == "serve"
    assert _command.command([str(folder), *words[2:]]) == 0
    (call,) = calls
    return call


def test_systemd_starts_the_page_with_options_that_there_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program, *words = shlex.split(unit()["Service"]["ExecStart"])
    assert program == "/opt/fluxbench/bin/fluxbench"
    assert words[1] == unit()["Service"]["WorkingDirectory"]
    assert started(words, monkeypatch, tmp_path) == (tmp_path, 8350)


def test_windows_starts_the_page_with_options_that_there_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    words = shlex.split(str(service().findtext("arguments")), posix=False)
    assert words[1].strip('"') == service().findtext("workingdirectory")
    assert started(words, monkeypatch, tmp_path) == (tmp_path, 8350)


def test_a_run_has_the_time_to_disarm_before_anything_is_killed() -> None:
    assert float(unit()["Service"]["TimeoutStopSec"]) > RUN_END_S
    assert unit()["Service"]["KillMode"] == "mixed", "the server alone is told to end; it ends its run"
    assert float(str(service().findtext("stoptimeout")).split()[0]) > RUN_END_S


def test_logs_do_not_grow_without_end() -> None:
    log = service().find("log")
    assert log is not None
    assert log.get("mode") == "roll-by-size"
    assert int(str(log.findtext("keepFiles"))) * int(str(log.findtext("sizeThreshold"))) < 1e6, "in kilobytes"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not here")
def test_systemd_finds_no_fault_with_the_unit() -> None:
    done = subprocess.run(
        ["systemd-analyze", "verify", str(FOLDER / "fluxbench.service")], capture_output=True, text=True, check=False
    )
    assert "Unknown" not in done.stderr
