"""Answer a set, recording by recording; answers that are there are kept, so that it may be ended at any time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from orchestrator.benchmark.definition import MANIFEST, RECORDINGS
from orchestrator.validation.json_text import parse_json
from orchestrator.validation.messages import first_problem
from protocols import InputError
from protocols.benchmark import BenchmarkAnswer

Answerer = Callable[[Path, dict[str, Any]], BenchmarkAnswer]
"""From a recording's folder and its entry of the manifest."""


def answerer() -> Answerer:
    """fluxbench's own, with the library that is installed."""
    from orchestrator.benchmark.answering import answer
    from orchestrator.registry.plugins import PluginKind, make_plugins

    library = make_plugins(PluginKind.EFFECTS)
    return lambda folder, entry: answer(folder, entry, library)


def read_manifest(folder: Path) -> dict[str, Any]:
    """`benchmark.json` of a set; raises `InputError` where the folder is none."""
    file = folder / MANIFEST
    try:
        manifest: dict[str, Any] = parse_json(file.read_text(encoding="utf-8"))
        if manifest["format"] != "fluxbench-benchmark" or not manifest["recordings"]:
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            str(file), "", "not the manifest of a benchmark's set; `fluxbench benchmark make DIR` makes one"
        ) from None
    return manifest


def read_answers(file: Path) -> dict[str, BenchmarkAnswer]:
    """Answers by recording; raises `InputError` with the line that is none."""
    answers = {}
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise InputError(str(file), "", "is not there; expected a file of answers, a line of JSON for each") from None
    except (OSError, UnicodeDecodeError):
        raise InputError(str(file), "", "cannot be read as a text; expected a file of answers") from None
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            raw = parse_json(line)
        except ValueError:
            raise InputError(str(file), f"line {number}", "not a line of JSON") from None
        try:
            found = BenchmarkAnswer.model_validate_json(line)
        except ValidationError as error:
            problem = first_problem(error, BenchmarkAnswer, raw)
            raise InputError(str(file), f"line {number}: {problem.field}", problem.text) from None
        answers[found.id] = found
    return answers


def answer_set(
    folder: Path, out: Path, answerer: Answerer, only: Sequence[str] = ()
) -> Iterator[tuple[BenchmarkAnswer, int]]:
    """Append an answer to each recording that has none yet; yields it and how many are left.

    Parameters
    ----------
    only : sequence of str
        Ids; all by default.
    """
    manifest = read_manifest(folder)
    known = {entry["id"] for entry in manifest["recordings"]}
    strange = next((name for name in only if name not in known), None)
    if strange is not None:
        raise InputError("--only", strange, f"no recording of {folder}")
    done = read_answers(out) if out.exists() else {}
    todo = [e for e in manifest["recordings"] if e["id"] not in done and (not only or e["id"] in only)]
    for left, entry in zip(range(len(todo) - 1, -1, -1), todo, strict=True):
        found = answerer(folder / RECORDINGS / entry["id"], entry)
        with out.open("a", encoding="utf-8") as lines:
            lines.write(found.model_dump_json(exclude_none=True) + "\n")
        yield found, left
