"""Make a case's recording, ask the diagnosis about it, and keep what it stated. Nothing is judged here."""

from __future__ import annotations

import gzip
import json
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal, TextIO, cast

from orchestrator.fleet import ClusterSettings, Task, connected, work_through
from tests.blind.baselines import baselines
from tests.blind.campaign import record
from tests.blind.delivered import held_against
from tests.blind.hidden import MANY, Case, draw_case
from tests.blind.removal import removals


@dataclass(frozen=True)
class Answer:
    """What the diagnosis stated of a case."""

    case: Case
    report: dict[str, Any] | None
    """The JSON contract's object; None where there was an error instead."""
    error: str | None
    samples: int
    seconds: float
    """Of wall time, for the diagnosis alone."""
    cpu_s: float
    peak_mb: float
    """Of the process during the diagnosis; so far, where a system keeps no other."""
    delivered: dict[str, Any] | None = None
    """Fields of `Delivered`; None where nothing was."""
    baselines: dict[str, list[str]] | None = None
    """What simpler searches name, by method; None where nothing was fitted."""
    removal: dict[str, dict[str, float]] | None = None
    """Fields of `Removal` by hidden effect, where many are hidden; None elsewhere."""


def examine(case: Case, recordings: Path | None = None, *, held_against_others: bool = True) -> Answer:
    """Diagnose a case's recording through the public API of the command line.

    Parameters
    ----------
    recordings : Path, optional
        Where recordings are stored, by `stored_recording`; by default each is made in a temporary place.
    held_against_others : bool
        Whether simpler searches and the plant are requested too, which takes as long as a quick diagnosis.
    """
    from orchestrator.diagnosis import diagnose_recording
    from orchestrator.recording import open_recording
    from orchestrator.registry.plugins import PluginKind, installed, load_plugin
    from protocols import FluxbenchError

    with tempfile.TemporaryDirectory(prefix="blind-") as folder:
        path = stored_recording(case, Path(folder) if recordings is None else recordings)
        recording = open_recording(path)
        samples = sum(segment.samples for segment in recording.manifest.segments)
        library = [load_plugin(PluginKind.EFFECTS, info.name)() for info in installed(PluginKind.EFFECTS)]
        forget_peak()
        start, cpu = time.perf_counter(), time.process_time()
        report, error, delivered, named = None, None, None, None
        try:
            found = diagnose_recording(recording, library, model="saturated", without=case.without, out=Path(folder))
            report = found.report.model_dump(mode="json")
            if (made := found.delivery) is not None:
                delivered = asdict(held_against(case, made.map, made.resistance, not made.objections))
        except FluxbenchError as refused:
            error = str(refused)
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        if delivered is not None and held_against_others:
            named = baselines(recording, [effect for effect in library if effect.name not in case.without])
    done = stored_removals(case, recordings) if case.kind in MANY else None
    return Answer(case, report, error, samples, seconds, cpu, peak, delivered, named, done)


def stored_recording(case: Case, folder: Path) -> Path:
    """The case's recording in a folder of recordings; made there where it is missing."""
    path = folder / f"{case.kind}-{case.index}"
    if not path.exists():
        unfinished = folder / f".{path.name}-{os.getpid()}"
        shutil.rmtree(unfinished, ignore_errors=True)
        record(case.bench, case.campaign, unfinished)
        unfinished.rename(path)
    return path


def stored_removals(case: Case, folder: Path | None) -> dict[str, dict[str, float]]:
    """Fields of `Removal` by hidden effect, kept in a folder of recordings where there is one.

    The plant is simulated once more for each effect, which takes several times as long as the diagnosis.
    """
    file = None if folder is None else folder / f".{case.kind}-{case.index}-removal.json"
    if file is not None and file.exists():
        stored: dict[str, dict[str, float]] = json.loads(file.read_text(encoding="utf-8"))
        return stored
    found = {name: asdict(one) for name, one in removals(case).items()}
    if file is not None:
        file.write_text(json.dumps(found), encoding="utf-8")
    return found


def forget_peak() -> None:
    """Let the kernel begin anew with the most memory that this process has had (Linux: proc(5), clear_refs)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def examine_all(
    wanted: Sequence[tuple[str, int]], seed: int, jobs: int, recordings: Path | None = None
) -> Iterator[Answer]:
    """Examine the cases (class, index) in as many processes, in order of completion."""
    rest = iter(wanted)

    def next_task() -> Task | None:
        case = next(rest, None)
        return None if case is None else Task(f"{case[0]}-{case[1]}", _draw_and_examine, (*case, seed, recordings))

    with nullcontext() if jobs == 1 else connected(ClusterSettings(jobs=jobs)) as client:
        for done in work_through(next_task, client):
            if done.failed is not None:
                raise RuntimeError(f"{done.task.name}: {done.failed}")
            yield done.result


def keep(file: Path | None, seed: int, answer: Answer, **more: Any) -> None:
    """Append an answer to a file of JSON lines, compressed where it ends in .gz; nowhere, where there is none."""
    if file is None:
        return
    names = ("report", "error", "samples", "seconds", "cpu_s", "peak_mb", "delivered", "baselines", "removal")
    row = {name: getattr(answer, name) for name in names}
    with _opened(file, "at") as lines:
        lines.write(json.dumps({"seed": seed, "case": [answer.case.kind, answer.case.index], **row, **more}) + "\n")


def kept(file: Path | None, seed: int) -> dict[tuple[str, int], Answer]:
    """The answers in such a file that belong to this seed, by class and index."""
    if file is None or not file.exists():
        return {}
    answers = {}
    with _opened(file, "rt") as lines:
        for row in map(json.loads, lines):
            kind, index = row.pop("case")
            if row["seed"] == seed:
                named = {field.name: row[field.name] for field in fields(Answer) if field.name in row}
                answers[kind, index] = Answer(draw_case(kind, index, seed), **named)
    return answers


def _opened(file: Path, mode: Literal["rt", "at"]) -> TextIO:
    if file.suffix == ".gz":
        return cast(TextIO, gzip.open(file, mode, encoding="utf-8"))
    return cast(TextIO, file.open(mode, encoding="utf-8"))


def _draw_and_examine(kind: str, index: int, seed: int, recordings: Path | None) -> Answer:
    return examine(draw_case(kind, index, seed), recordings)
