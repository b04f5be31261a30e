"""What docs/python.md and the README show in Python runs as it stands, and so do the notebooks."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "python.md"
RECORDING = ROOT / "tests" / "data" / "pm400-reduced"
LONG = "## Simulate and run"
"""From here on the page measures: half a minute each."""


def blocks(text: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)


def run_in(folder: Path, pieces: list[str], monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """One after the other in one namespace, in a folder that has the documentation beside it."""
    (folder / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(folder)
    shown: dict[str, Any] = {}
    for piece in pieces:
        exec(compile(piece, "page", "exec"), shown)
    return shown


@pytest.mark.slow
@pytest.mark.long
def test_the_page_s_analysis_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(RECORDING, tmp_path / "runs" / "motor")
    pieces = blocks(PAGE.read_text(encoding="utf-8").split(LONG)[0])
    assert len(pieces) == 5
    shown = run_in(tmp_path, pieces, monkeypatch)
    assert shown["found"].report.verdict == "clean"
    assert shown["model"].title == "saturated"


@pytest.mark.slow
def test_the_page_s_simulations_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pieces = ["import fluxbench", *blocks(PAGE.read_text(encoding="utf-8").split(LONG)[1])]
    assert len(pieces) == 4
    shown = run_in(tmp_path, pieces, monkeypatch)
    assert shown["demo"].diagnosis.report.verdict == "explained"


@pytest.mark.slow
@pytest.mark.parametrize("notebook", sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")), ids=lambda p: p.stem)
def test_a_notebook_runs_from_top_to_bottom(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cells are plain Python: a kernel would add nothing but itself."""
    plt.switch_backend("agg")
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert all(not cell["outputs"] for cell in cells if cell["cell_type"] == "code")
    run_in(tmp_path, code, monkeypatch)
    plt.close("all")
