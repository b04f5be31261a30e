"""Runs side by side as a file for the viewer: what changed, in words and over the current plane."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from orchestrator.formatting.sentences import markdown_table, shown
from orchestrator.interface.api import compare_runs
from orchestrator.interface.comparison import ComparedRuns, change_rows, run_rows
from plugins.streams.rerun._blueprints import side_by_side
from plugins.streams.rerun._maps import over_plane
from plugins.streams.rerun._tape import Entry, When, blueprint, entry, titled, write_file

_NOW = When(experiment_s=0.0)
"""The viewer wants one time at least."""


def write_comparison(paths: Sequence[Path], file: Path) -> None:
    """Hold runs against the first of them and draw it; raises `RecordingError` where one was not estimated."""
    write_file(file, "comparison", _entries(compare_runs(*paths)))


def _entries(compared: ComparedRuns) -> Iterator[Entry]:
    names = [run.name for run in compared.comparison.runs]
    yield titled(" and ".join(names))
    for name, text in _pages(compared).items():
        yield entry(f"comparison/{name}", _NOW, rr.TextDocument(shown(text), media_type=rr.MediaType.MARKDOWN))
    planes = []
    for k, change in enumerate(compared.comparison.maps, start=1):
        first = compared.runs[0].surface
        if first is None or change.rms_percent is None:
            continue
        length = 1e3 * np.linalg.norm(compared.flux_change(k), axis=2)
        yield from over_plane(f"apart/{k}/amperes", _NOW, (first.i_d, first.i_q), length, "mWb")
        planes.append((shown(f"Flux of {names[k]} less that of {names[0]}, length"), f"/apart/{k}"))
    yield blueprint("comparison", side_by_side(planes))


def _pages(compared: ComparedRuns) -> dict[str, str]:
    comparison = compared.comparison
    changes, runs = change_rows(comparison), run_rows(comparison)
    remarks = "\n".join(f"- {remark.text}" for remark in comparison.remarks)
    return {
        "changes": f"{remarks}\n\n{markdown_table(changes[0], changes[1:])}",
        "runs": markdown_table(runs[0], runs[1:]),
    }
