"""`fluxbench runs` and `fluxbench note`: the runs below a folder, and their tags and notes."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orchestrator.formatting.sentences import for_output, text_table
from orchestrator.interface.cli._output import complain, say, say_document
from orchestrator.shelf import (
    COLUMNS,
    DEFAULT_COLUMNS,
    Condition,
    RunFacts,
    RunQuery,
    cells,
    find_runs,
    is_text,
    known_column,
    with_intervals,
)
from protocols import InputError

MIN_ANNOUNCED_RUNS = 500
"""Number of runs to be read from which on a person has to wait for seconds."""


@dataclass(frozen=True)
class RunsOptions:
    """What of the runs is listed, and how."""

    words: Sequence[str] = ()
    conditions: Sequence[str] = ()
    columns: Sequence[str] = ()
    """Empty: the usual ones; as JSON all."""
    sort: str = "created"
    limit: int = -1
    skip_damaged: bool = False
    as_json: bool = False


def list_runs(folder: Path, options: RunsOptions) -> int:
    """Print the runs, by default the newest last; 3 where one cannot be read, unless that is skipped."""
    if not folder.is_dir():
        raise InputError(str(folder), "", "no such folder; --folder names the one with your runs")
    columns = [known_column(name, "--columns") for name in options.columns]
    wanted = RunQuery(
        words=options.words,
        conditions=[*map(Condition.parse, options.conditions)],
        sort=options.sort,
        limit=options.limit,
        above=f"{folder}/",
    )
    shown = with_intervals(columns or (COLUMNS if options.as_json else DEFAULT_COLUMNS))
    found = find_runs(folder, wanted, shown, _announce)
    if options.as_json:
        rows = [_with_path(folder, dict(zip(shown, row, strict=True))) for row in found.rows]
        say_document(json.dumps(rows, indent=2))
    elif found.rows:
        head = columns or DEFAULT_COLUMNS
        say(text_table(head, _in_print(folder, head, shown, found.rows), numbers=False))
    else:
        say(_none_found(folder, options))
    for problem in found.problems:
        complain(problem)
    return 3 if found.problems and not options.skip_damaged else 0


def note(path: Path, notes: Sequence[str], tags: Sequence[str], untag: Sequence[str], as_json: bool) -> int:
    """Change a run's tags and notes, and print them."""
    from orchestrator.shelf import relabel

    labels = relabel(path, tags=tags, untag=untag, notes=notes)
    if as_json:
        say_document(labels.model_dump_json(indent=2, include={"tags", "notes"}))
    else:
        say(f"tags: {', '.join(labels.tags) or 'none'}", *(f"note: {text}" for text in labels.notes))
    return 0


def _with_path(folder: Path, row: dict[str, object]) -> dict[str, object]:
    return row | {"run": str(folder / str(row["run"]))} if "run" in row else row


def _in_print(
    folder: Path, head: Sequence[str], shown: Sequence[str], rows: Sequence[tuple[Any, ...]]
) -> list[tuple[str, ...]]:
    texts: list[tuple[str, ...]]
    if all(map(is_text, head)):
        texts = [*rows]
    else:
        texts = [cells(RunFacts(**{"run": "", **dict(zip(shown, row, strict=True))}), head) for row in rows]
    if "run" not in head or folder == Path():
        return texts
    at = head.index("run")
    return [(*row[:at], f"{folder}/{row[at]}", *row[at + 1 :]) for row in texts]


def _none_found(folder: Path, options: RunsOptions) -> str:
    place = next((word for word in options.words if Path(word).is_dir()), None)
    hint = "" if place is None else f"; `fluxbench runs --folder {place}` lists those below {place}"
    words = f" has the words {' '.join(options.words)}" if options.words else ""
    where = f"{' and' if words else ' has'} {' and '.join(options.conditions)}" if options.conditions else ""
    return f"no run below {folder}{words}{where}{hint}"


def _announce(done: int, of: int) -> None:
    if done == 0 and of >= MIN_ANNOUNCED_RUNS:
        print(for_output(f"reading {of} runs that are new or changed", sys.stderr), file=sys.stderr, flush=True)
