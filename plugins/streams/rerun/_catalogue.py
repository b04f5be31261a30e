"""A folder of runs as a table, and as a catalogue that the viewer can browse: their properties are its columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from orchestrator.estimation import has_estimates, load_estimates
from orchestrator.formatting.quantities import UNKNOWN, number
from orchestrator.formatting.sentences import text_table
from orchestrator.runs import RunDirectory
from orchestrator.validation.json_text import parse_json
from orchestrator.validation.plain_files import read_bytes
from plugins.streams.rerun._live import HOST
from plugins.streams.rerun._tape import FILE_NAME, is_whole
from protocols import Diagnosed, EstimationReport, FluxbenchError, Message, PointDone, RunEnded, Usability

DATASET = "runs"
COLUMNS = ("run", "created", "motor", "drive", "points", "outcome", "r_s_ohm", "map_by", "usable", "verdict", "view")


def runs_in(folder: Path) -> list[Path]:
    """The runs of a folder, by name."""
    return sorted(path.parent for path in folder.glob("*/run.json"))


def row(path: Path, tell: Callable[[str], None]) -> dict[str, Any]:
    """One run's line of the table; null where it is not known, with a line to `tell` for what cannot be read."""
    cells: dict[str, Any] = dict.fromkeys(COLUMNS)
    file = path / FILE_NAME
    view = "missing" if not file.is_file() else "whole" if is_whole(file) else "torn"
    cells |= {"run": path.name, "outcome": "unreadable", "view": view}
    try:
        run = RunDirectory.open(path)
        messages = [record.message for record in run.journal.read()]
    except FluxbenchError as error:
        tell(f"left out: {error}")
        return cells
    record = run.record
    ended = next((m for m in reversed(messages) if isinstance(m, RunEnded)), None)
    cells |= {"created": record.created, "motor": record.procedure.motor.name, "drive": record.procedure.drive.name}
    cells |= {"points": sum(isinstance(m, PointDone) for m in messages)}
    cells["outcome"] = "unfinished" if ended is None else ended.outcome
    found = _estimates(path, tell) or (None if ended is None else ended.estimates)
    if found is not None:
        value = None if found.resistance is None else found.resistance.value_ohm
        cells |= {
            "r_s_ohm": value,
            "map_by": found.method,
            "usable": None if found.usability is Usability.NOT_JUDGED else found.usable,
        }
    return cells | {"verdict": _verdict(path, messages, tell)}


def _estimates(path: Path, tell: Callable[[str], None]) -> EstimationReport | None:
    """Those of ``results/estimates.json``, which are the newest; None where it has none."""
    try:
        return load_estimates(path) if has_estimates(path) else None
    except FluxbenchError as error:
        tell(f"left out: {error}")
        return None


def _verdict(path: Path, messages: Sequence[Message], tell: Callable[[str], None]) -> Any:
    """That of ``results/diagnosis.json``, which is the newest; else the last one in the journal."""
    file = path / "results" / "diagnosis.json"
    try:
        if file.exists():
            kept = parse_json(read_bytes(file))
            return kept.get("report", kept)["verdict"]
    except (OSError, ValueError, AttributeError, KeyError, TypeError, RecursionError) as error:
        tell(f"left out: {file}: no diagnosis can be read: {type(error).__name__}: {error}")
    verdicts = [m.report.verdict for m in messages if isinstance(m, Diagnosed)]
    return verdicts[-1] if verdicts else None


def as_text(rows: Sequence[dict[str, Any]]) -> str:
    """The table for a person."""
    return text_table(COLUMNS, [[_cell(row[column]) for column in COLUMNS] for row in rows], numbers=False)


def _cell(value: object) -> str:
    if value is None:
        return UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value) if isinstance(value, float) else str(value)


@contextmanager
def served(files: Sequence[Path]) -> Iterator[str]:
    """A catalogue server of these views on this machine; its address, while it lasts."""
    from rerun.server import Server

    with Server(host=HOST, datasets={DATASET: list(files)}) as server:
        yield server.url()
