"""`fluxbench runs`: the runs below a folder with their motors and outcomes, filtered by words."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from orchestrator.formatting.sentences import text_table
from orchestrator.interface.cli._output import complain, say, say_document
from orchestrator.runs import run_rows
from protocols import InputError


def runs(folder: Path, words: Sequence[str], as_json: bool) -> int:
    """List the runs that contain all words, the newest last; unreadable runs are reported and skipped."""
    if not folder.is_dir():
        raise InputError(str(folder), "", "no such folder")
    rows = sorted((row for row in run_rows(folder, complain) if _has(row, words)), key=lambda row: row["created"])
    if as_json:
        say_document(json.dumps(rows, indent=2))
    elif rows:
        columns = ("run", "created", "motor", "serial", "operator", "outcome", "tags", "notes")
        say(text_table(columns, [tuple(row[name] for name in columns) for row in rows], numbers=False))
    else:
        say(f"no run below {folder}" + (f" has the words {' '.join(words)}" if words else ""))
    return 0


def _has(row: dict[str, str], words: Sequence[str]) -> bool:
    text = " ".join(row.values()).lower()
    return all(word.lower() in text for word in words)
