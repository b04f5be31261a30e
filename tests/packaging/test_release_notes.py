"""The notes of a release are a version's part of the list of changes, the newest one's by default."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "packaging" / "release_notes.py"


def printed(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(SCRIPT), *words], capture_output=True, text=True, check=False)


def test_the_newest_version_s_part_is_printed_as_it_is_written() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    notes = printed().stdout
    assert notes.startswith("### ")
    assert notes.strip() in text
    assert "## [" not in notes
    assert notes not in printed("Unreleased").stdout


def test_a_version_that_there_is_not_is_refused_with_those_that_there_are() -> None:
    done = printed("9.9.9")
    assert done.returncode == 1
    assert "no version 9.9.9" in done.stderr
    assert "Unreleased" in done.stderr
