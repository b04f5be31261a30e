"""Exceptions of plugins and of ours: one line with plugin, file and line on the screen, the traceback in a file."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from orchestrator.interface.cli._defects import TRACEBACKS, describe_defect, keep_traceback
from tests.support.processes import called
from tests.support.tiny import run_tiny, tiny_file

PLUGINS = """from plugins.drives.simulated import SimulatedDrive
from plugins.estimators.resistance import ResistanceEstimator

class Estimator(ResistanceEstimator):
    name = "torn"

    def estimate(self, recording, context):
        return lookup()

class Drive(SimulatedDrive):
    name = "torn"

    def execute(self, excitation):
        return lookup()

def lookup():
    return {}["gone\\nand more"]
"""
LINE = PLUGINS.splitlines().index('    return {}["gone\\nand more"]') + 1
ENTRIES = "[fluxbench.estimators]\ntorn = torn_plugins:Estimator\n[fluxbench.drives]\ntorn = torn_plugins:Drive\n"


@pytest.fixture
def plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A distribution with an estimator and a drive that raise, installed."""
    folder = tmp_path / "plugins"
    about = folder / "torn-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: torn\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(ENTRIES)
    (folder / "torn_plugins.py").write_text(PLUGINS)
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    sys.modules.pop("torn_plugins", None)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_tiny(tmp_path_factory.mktemp("runs"), stages=[{"kind": "gates_off", "duration_s": 0.02}]).path


def test_an_estimator_that_raises_is_one_line_and_the_traceback_is_in_the_run(plugins: Path, run: Path) -> None:
    done = called("estimate", run, "--estimator", "torn")
    assert done.returncode == 2
    place = re.escape(f"{plugins / 'torn_plugins.py'}, line {LINE}")
    line = rf"fluxbench: estimators: torn: KeyError: 'gone\\nand more' \({place}\); the traceback is in (.+)\n"
    found = re.fullmatch(line, done.stderr)
    assert found, done.stderr
    assert found[1] == str(run / TRACEBACKS)
    kept = Path(found[1]).read_text()
    assert "Traceback (most recent call last):" in kept
    assert "torn_plugins.py" in kept


def test_a_drive_that_raises_is_one_line_after_a_safe_end(plugins: Path, tmp_path: Path) -> None:
    procedure = tiny_file(tmp_path)
    done = called("run", procedure, "--drive", "torn", "--out", tmp_path / "run", "--quiet")
    assert done.returncode == 3
    (line,) = done.stderr.splitlines()
    assert f"raised KeyError: 'gone\\nand more' ({plugins / 'torn_plugins.py'}, line {LINE})" in line
    assert f"the traceback is in {tmp_path / 'run' / TRACEBACKS}; `fluxbench resume" in line
    assert "Traceback" in (tmp_path / "run" / TRACEBACKS).read_text()


def test_a_defect_of_ours_is_one_line_with_its_place(tmp_path: Path) -> None:
    try:
        os.fspath(5)  # type: ignore[call-overload]
    except TypeError as error:
        line, is_plugins = describe_defect(error)
        kept = keep_traceback(error, tmp_path)
        again = keep_traceback(error, tmp_path)
    assert not is_plugins
    assert line.startswith("a defect of fluxbench, please report it: TypeError: ")
    assert re.search(r"\(.*test_defects\.py, line \d+\)$", line)
    assert kept == again == f"; the traceback is in {tmp_path / TRACEBACKS}"
    assert (tmp_path / TRACEBACKS).read_text().count("Traceback (most recent call last):") == 2


def test_where_a_run_cannot_be_written_the_traceback_goes_to_a_temporary_file(tmp_path: Path) -> None:
    kept = keep_traceback(ValueError("x"), tmp_path / "nowhere")
    file = Path(kept.removeprefix("; the traceback is in "))
    assert "ValueError: x" in file.read_text()
    file.unlink()


@pytest.mark.parametrize("words", [["report"], ["resume"], ["estimate"], ["compare"], ["view"]])
def test_half_a_character_in_a_run_is_one_line(words: list[str], run: Path, tmp_path: Path) -> None:
    whole = (run / "run.json").read_text()
    (run / "run.json").write_text(re.sub(r'"name": *"[^"]*"', r'"name": "x\\ud800"', whole, count=1))
    try:
        done = called(*words, run)
    finally:
        (run / "run.json").write_text(whole)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == f"fluxbench: {run / 'run.json'}: broken JSON: '\\ud800' is half a character"


INTERRUPTED = """
import sys
class Interrupting:
    def find_spec(self, name, path, target=None):
        if name == "orchestrator.interface.cli._early_signals":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupting())
from orchestrator.interface.cli import main
main()
"""


def test_an_interrupt_before_its_handler_is_there_is_one_line() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (130, "fluxbench: interrupted by SIGINT\n")
