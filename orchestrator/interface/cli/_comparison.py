"""`fluxbench compare RUN RUN...`: a comparison of runs, and their changes beyond noise."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from orchestrator.formatting.sentences import text_table
from orchestrator.interface import api
from orchestrator.interface.cli._output import say, say_document, say_notes
from orchestrator.interface.comparison import change_rows, run_rows


def compare_runs(paths: Sequence[Path], as_json: bool) -> int:
    """Print the runs' results, and their changes."""
    comparison = api.compare_runs(*paths).comparison
    if as_json:
        say_document(comparison.model_dump_json(indent=2))
        return 0
    for rows in (run_rows(comparison), change_rows(comparison)):
        say(text_table(rows[0], rows[1:], numbers=False), "")
    say_notes(remark.text for remark in comparison.remarks)
    return 0
