"""Standard output: text for its encoding, and recovery when it can no longer be written."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from orchestrator.formatting.sentences import can_print, cut, for_output, text_table, visible

_FILE_WIDTH = 180
"""Characters of a line of a table that goes to a file or another program."""


def say(*lines: str) -> None:
    """Print lines, one each."""
    for line in lines:
        print(for_output(cut(line), sys.stdout))


def announce(path: Path, as_json: bool) -> None:
    """Print the path being read before slow imports begin.

    On standard error where standard output is one JSON object. A missing path gives an error later.
    """
    if path.exists():
        where = sys.stderr if as_json else sys.stdout
        for line in (f"reading {path}", *_damaged_manifest(path)):
            print(for_output(cut(line), where), file=where, flush=True)


def _damaged_manifest(path: Path) -> list[str]:
    """A note where a run's recording.json is no JSON: a run is read from its journal, of which that is a copy."""
    manifest = path / "recording.json"
    if not ((path / "journal.jsonl").is_file() and manifest.is_file()):
        return []
    try:
        json.loads(manifest.read_bytes())
    except (OSError, ValueError, RecursionError):
        text = "is damaged and not used: segments and checksums come from journal.jsonl, and each capture is checked"
        return [f"note: {manifest} {text}"]
    return []


def announce_loading(name: str, *, aside: bool = False) -> None:
    """Print what is being loaded before slow imports begin; on standard error if `aside`."""
    where = sys.stderr if aside else sys.stdout
    print(for_output(cut(f"loading {name}"), where), file=where, flush=True)


def say_document(text: str) -> None:
    """Print a whole document, as JSON or YAML."""
    print(visible(text))


def complain(line: str, choices: Sequence[str] = (), max_choices: int = 50) -> None:
    """Print an error as one line on standard error, and possible choices in the lines below it."""
    below = [f"  {choice}" for choice in choices[:max_choices]]
    if len(choices) > max_choices:
        below.append(f"  ... and {len(choices) - max_choices} more")
    for text in (f"fluxbench: {' '.join(line.split())}", *below):
        print(for_output(cut(text), sys.stderr), file=sys.stderr)


def say_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table of numbers: columns as wide as they need to be, the first to the left, the others to the right."""
    say(text_table(head, rows))


def say_wide_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table whose cells wrap where the terminal is too narrow; other outputs have room for long lines."""
    import io

    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    frame = box.SIMPLE_HEAD if can_print(sys.stdout) else box.ASCII2
    table = Table(box=frame, pad_edge=False, show_edge=False)
    for name in head:
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*(Text(for_output(cell, sys.stdout)) for cell in row))
    page, width = io.StringIO(), shutil.get_terminal_size().columns if sys.stdout.isatty() else _FILE_WIDTH
    Console(file=page, width=width, color_system=None).print(table)
    say(*(line.rstrip() for line in page.getvalue().splitlines()))


def say_notes(notes: Iterable[str]) -> None:
    """Print notes on a result."""
    say(*(f"note: {note}" for note in notes))


def stage_as_yaml(stage: Mapping[str, Any]) -> str:
    """A stage in the form of a procedure's `stages`, ready to paste."""
    import yaml

    lines = yaml.safe_dump([dict(stage)], sort_keys=False, default_flow_style=None, width=100).splitlines()
    return "\n".join(f"  {line}" for line in lines)


def give_up_broken_output() -> None:
    """Flush standard output; where that fails, discard its buffer, so that no error appears at the end."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
