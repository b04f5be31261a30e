"""What a list of ten thousand runs costs: the index made anew, and read when nothing has changed.

`python -m tests.benchmarks.shelf 1000` takes so many runs. They are small: few lines in the journal, no samples.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
import tempfile
import time
from pathlib import Path

from orchestrator.interface.cli._runs import RunsOptions, list_runs
from orchestrator.runs._record import hash_of
from orchestrator.shelf.index import INDEX_NAME
from tests.orchestrator.shelf.example_runs import a_run

RUNS = 10_000


def many_runs(folder: Path, count: int) -> None:
    """So many runs of 50 motors; files that are the same in all are links."""
    template = a_run(folder.parent / "template")
    record = json.loads((template / "run.json").read_text())
    same = [path.relative_to(template) for path in template.rglob("*") if path.is_file() and path.name != "run.json"]
    for number in range(count):
        path = folder / f"tiny-{number:05d}"
        (path / "results").mkdir(parents=True)
        path.with_name(f"{path.name}.sealed").mkdir()
        record["procedure"]["about"] |= {"serial": f"PM-{number % 50:04d}", "tags": ["cold"] if number % 2 else []}
        record["procedure_sha256"] = hash_of(record["procedure"])
        record["created"] = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(1.7e9 + 600 * number))
        (path / "run.json").write_text(json.dumps(record))
        for name in same:
            os.link(template / name, path / name)


def main(count: int = RUNS) -> None:
    """Print the figures."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "runs"
        many_runs(folder, count)
        time.sleep(2.5)  # of files that changed just now an index would not be sure
        print(f"{count} runs: the index anew in {_seconds(folder):.1f} s of the processor", flush=True)
        listed = min(_seconds(folder) for _ in range(5))
        found = min(_seconds(folder, "pm-0007", "cold") for _ in range(5))
        size = (folder / INDEX_NAME).stat().st_size / count
        print(f"listed and printed in {listed:.3f} s, searched by two words in {found:.3f} s; {size:.0f} bytes a run")


def _seconds(folder: Path, *words: str) -> float:
    began = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        list_runs(folder, RunsOptions(words=words))
    return time.process_time() - began


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
