"""The example in docs/import.md is whole: its script, its mapping and its command give the recording it began with."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from orchestrator.importing import Finding, import_files
from orchestrator.recording import open_recording
from tests.support.close import assert_close

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "import.md").read_text(encoding="utf-8")
REDUCED = ROOT / "tests" / "data" / "pm400-reduced"


def snippets() -> dict[str, str]:
    """The page's files by name: each code block opens with a comment that holds it."""
    return dict(re.findall(r"^```(?:python|yaml)\n# (\S+)\n(.*?)^```$", PAGE, re.M | re.S))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The page's files and the recording that its script asks for."""
    for name, text in snippets().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    shutil.copytree(REDUCED, tmp_path / "tests" / "data" / "pm400-reduced")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_example_of_the_page_works(folder: Path) -> None:
    done = subprocess.run(
        [sys.executable, "bench.py"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    (command,) = re.findall(r"^fluxbench import (.*)$", PAGE, re.M)
    mapping, *files, option, out = shlex.split(command)
    assert option == "--out"
    report = import_files(Path(mapping), list(map(Path, files)), Path(out))
    original = open_recording(REDUCED)
    before, after = original.segments("resistance", "classical", "injection"), open_recording(Path(out)).segments()  # type: ignore[arg-type]
    assert report.segments == len(before) == len(after)
    for segment, again in zip(before, after, strict=True):
        assert (again.stage, again.samples) == (segment.stage, segment.samples)
        assert again.start_s == pytest.approx(segment.start_s, abs=1e-6)
        captured, imported = original.load(segment), open_recording(Path(out)).load(again)
        assert_close(imported.i_ab, captured.i_ab, 2.0**-22)
        assert_close(imported.v_ab, captured.v_ab, 2.0**-22)


def test_the_page_lists_all_findings() -> None:
    assert set(re.findall(r"^\| `(\w+)` \|", PAGE, re.M)) == {finding.value for finding in Finding}
