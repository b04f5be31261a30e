"""What a diagnosis costs, beside an older commit of the project and beside itself; prints, and judges nothing.

`python -m tests.benchmarks.diagnosis [PART ...] [--against COMMIT] [--cache DIR]`. Costs are the processor's seconds of
whole commands, of their helpers too, with compiled kernels. Recordings are made once, in the cache.
"""

from __future__ import annotations

import argparse
import ast
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from orchestrator.formatting.sentences import text_table

HERE = Path(__file__).parents[2]
REFERENCE = "b8678b8"
BLIND, SEED = ("clean", "single", "clutter"), 20261129
ROUNDS = 5
"""Of which the median counts, where a command takes seconds."""


@dataclass(frozen=True)
class Row:
    """A line of the table: a value, what it is held against, and what their ratio (or the value) should be."""

    label: str
    value: float
    reference: float | None
    aim: str = ""

    @property
    def ratio(self) -> float | None:
        """Value over reference; None where there is none."""
        return self.value / self.reference if self.reference else None


@dataclass(frozen=True)
class Cost:
    """Of one command: processor's seconds, seconds of wall time, and the most memory of one of its processes [MB]."""

    cpu_s: float
    wall_s: float
    peak_mb: float


class Bench:
    """Recordings and the reference's tree, each made when it is requested first.

    Parameters
    ----------
    cache : Path
        Keeps the recordings.
    reference : Path
        A tree of the commit that is compared with.
    """

    def __init__(self, cache: Path, reference: Path) -> None:
        self._cache, self.reference = cache, reference
        self._diagnosed: dict[tuple[Path, Path], Cost] = {}

    @cached_property
    def demo(self) -> Path:
        """A finished run of the demo, not diagnosed."""
        path = self._cache / "demo"
        if not path.exists():
            cost_of(HERE, "run", self.plain_demo, "--out", path)
        return path

    @cached_property
    def plain_demo(self) -> Path:
        """The demo's procedure without its diagnoses."""
        import yaml

        self._cache.mkdir(parents=True, exist_ok=True)
        procedure = yaml.safe_load((HERE / "protocols" / "procedures" / "demo.yaml").read_text(encoding="utf-8"))
        procedure["stages"] = [stage for stage in procedure["stages"] if stage["kind"] != "diagnose"]
        path = self._cache / "demo-plain.yaml"
        path.write_text(yaml.safe_dump(procedure, sort_keys=False), encoding="utf-8")
        return path

    def blind(self, kind: str) -> tuple[Path, tuple[str, ...]]:
        """The first recording of a class of the blind suite, and options of its diagnosis."""
        from tests.blind.examine import stored_recording
        from tests.blind.hidden import draw_case

        case = draw_case(kind, 0, SEED)
        self._cache.mkdir(parents=True, exist_ok=True)
        return stored_recording(case, self._cache), tuple(f"--without={name}" for name in case.without)

    def diagnosis(self, tree: Path, recording: Path, *options: str) -> Cost:
        """Of `fluxbench diagnose`, measured once for each tree and recording."""
        if (tree, recording) not in self._diagnosed:
            self._compiled(tree)
            with tempfile.TemporaryDirectory() as out:
                self._diagnosed[tree, recording] = cost_of(tree, "diagnose", recording, *options, "--out", out)
        return self._diagnosed[tree, recording]

    def _compiled(self, tree: Path) -> None:
        """A tree's kernels, by a diagnosis of a small recording that is not counted."""
        if not any(known == tree for known, _ in self._diagnosed):
            small = HERE / "tests" / "data" / "pm400-reduced"
            with tempfile.TemporaryDirectory() as out:
                self._diagnosed[tree, small] = cost_of(tree, "diagnose", small, "--out", out)


def against_reference(bench: Bench) -> Iterator[Row]:
    """A diagnosis of the demo's recording."""
    now, then = (bench.diagnosis(tree, bench.demo).cpu_s for tree in (HERE, bench.reference))
    yield Row("diagnose the demo [s]", now, then)


def blind_recordings(bench: Bench) -> Iterator[Row]:
    """Diagnoses of blind recordings: all, the median and the worst ratio."""
    rows = []
    for kind in BLIND:
        path, options = bench.blind(kind)
        now, then = (bench.diagnosis(tree, path, *options).cpu_s for tree in (HERE, bench.reference))
        rows.append(Row(f"diagnose {kind}:0 [s]", now, then))
        yield rows[-1]
    ratios = [row.ratio for row in rows if row.ratio is not None]
    yield Row("blind recordings, median ratio", statistics.median(ratios), None)
    yield Row("blind recordings, worst ratio", max(ratios), None)


def switched(bench: Bench) -> Iterator[Row]:
    """A bench behind an inverter that switches, beside the demo's."""
    path, options = bench.blind("switched")
    yield Row("diagnose switched:0 [s], beside the demo", bench.diagnosis(HERE, path, *options).cpu_s,
              bench.diagnosis(HERE, bench.demo).cpu_s)  # fmt: skip


def whole_run(bench: Bench) -> Iterator[Row]:
    """`run demo`, beside the same procedure without its diagnoses."""
    with tempfile.TemporaryDirectory() as folder:
        whole = cost_of(HERE, "run", "demo", "--out", Path(folder) / "whole").cpu_s
        plain = cost_of(HERE, "run", bench.plain_demo, "--out", Path(folder) / "plain").cpu_s
    yield Row("run demo [s], beside it undiagnosed", whole, plain)
    yield Row("run demo, undiagnosed [s]", plain, None, "below 15 s")


def estimating(bench: Bench) -> Iterator[Row]:
    """`estimate` of a finished run of the demo, again and again."""
    costs = []
    for tree in (HERE, bench.reference):
        with tempfile.TemporaryDirectory() as folder:
            run = Path(folder) / "run"
            subprocess.run(["cp", "-r", bench.demo, run], check=True)
            cost_of(tree, "estimate", run)  # kernels, and a report of these results
            costs.append(statistics.median(cost_of(tree, "estimate", run).cpu_s for _ in range(ROUNDS)))
    yield Row("estimate the demo [s]", costs[0], costs[1], "at most 0.3")


def memory(bench: Bench) -> Iterator[Row]:
    """Most memory of a diagnosis of the demo's recording."""
    now, then = (bench.diagnosis(tree, bench.demo).peak_mb for tree in (HERE, bench.reference))
    yield Row("peak memory of diagnose [MB]", now, then)


def workers(bench: Bench) -> Iterator[Row]:
    """Wall time with two threads, beside one."""
    walls = []
    for count in (2, 1):
        with tempfile.TemporaryDirectory() as out:
            call = f"diagnose({str(bench.demo)!r}, out={out!r}, workers={count})"
            walls.append(python(HERE, "-c", f"from orchestrator.interface.api import diagnose; {call}").wall_s)
    yield Row("two threads [s of wall time], beside one", walls[0], walls[1])


def size(bench: Bench) -> Iterator[Row]:
    """Lines and files of the diagnosis, and numbers in its criteria."""
    labels = ("lines of orchestrator/diagnosis", "files of orchestrator/diagnosis", "fields of its criteria")
    for label, now, then in zip(labels, size_of(HERE), size_of(bench.reference), strict=True):
        yield Row(label, now, then)


PARTS: dict[str, Callable[[Bench], Iterator[Row]]] = {
    "diagnose": against_reference,
    "blind": blind_recordings,
    "switched": switched,
    "run": whole_run,
    "estimate": estimating,
    "memory": memory,
    "workers": workers,
    "size": size,
}


def size_of(tree: Path) -> tuple[int, int, int]:
    """Lines, files, and fields of the criteria in a tree."""
    folder = tree / "orchestrator" / "diagnosis"
    texts = [path.read_text(encoding="utf-8") for path in folder.rglob("*.py")]
    criteria = (folder / "criteria.py").read_text(encoding="utf-8")
    return sum(len(text.splitlines()) for text in texts), len(texts), fields_in(criteria)


def fields_in(source: str) -> int:
    """Fields of the classes in a module's text; those that are a class of the module, or imported, are not counted."""
    body = ast.parse(source).body
    classes = [node for node in body if isinstance(node, ast.ClassDef)]
    imported = {alias.name for node in body if isinstance(node, ast.ImportFrom) for alias in node.names}
    names = imported | {node.name for node in classes}
    fields = [line for node in classes for line in node.body if isinstance(line, ast.AnnAssign)]
    return sum(ast.unparse(field.annotation) not in names for field in fields)


def cost_of(tree: Path, *words: str | Path) -> Cost:
    """Of one command of the project in a tree."""
    return python(tree, "-m", "fluxbench", *map(str, words))


def python(tree: Path, *words: str) -> Cost:
    """Of Python in a tree, with this process' own packages; raises `RuntimeError` where it fails."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    began = time.perf_counter()
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            [sys.executable, *words],
            cwd=tree,
            env={**kept, "PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=errors,
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            errors.seek(0)
            raise RuntimeError(f"{' '.join(words)}: {errors.read().decode(errors='replace')[-500:]}")
    return Cost(used.ru_utime + used.ru_stime, time.perf_counter() - began, used.ru_maxrss / 1024)


@contextmanager
def tree_of(commit: str) -> Iterator[Path]:
    """A temporary worktree of a commit."""
    with tempfile.TemporaryDirectory(prefix="fluxbench-reference-") as folder:
        tree = Path(folder) / "tree"
        subprocess.run(["git", "worktree", "add", "--quiet", "--detach", tree, commit], cwd=HERE, check=True)
        try:
            yield tree
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", tree], cwd=HERE, check=True)


def cells(row: Row) -> tuple[str, ...]:
    """A row as text."""
    numbers = (row.value, row.reference, row.ratio)
    value, reference, ratio = ("--" if one is None else f"{one:.3g}" if one < 1000 else f"{one:.0f}" for one in numbers)
    return row.label, value, reference, ratio, row.aim or "--"


def parsed(words: Sequence[str]) -> argparse.Namespace:
    """The parts, the commit and the cache that are meant."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.diagnosis", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all by default")
    parser.add_argument("--against", default=REFERENCE, metavar="COMMIT", help="the reference (default %(default)s)")
    cache = Path(tempfile.gettempdir()) / "fluxbench-benchmarks"
    parser.add_argument("--cache", type=Path, default=cache, metavar="DIR", help="recordings (default %(default)s)")
    requested = parser.parse_args(words)
    unknown = [part for part in requested.parts if part not in PARTS]
    if unknown:
        parser.error(f"no part {unknown[0]!r}: there is {', '.join(PARTS)}")
    requested.parts = requested.parts or list(PARTS)
    return requested


def main(words: Sequence[str] = ()) -> None:
    """Print the table of the parts that are named, of all by default."""
    requested = parsed(words)
    with tree_of(requested.against) as reference:
        bench = Bench(requested.cache, reference)
        rows = [cells(row) for part in requested.parts for row in PARTS[part](bench)]
    print(text_table(("what", "here", "reference", "ratio", "aim"), rows))


if __name__ == "__main__":
    main(sys.argv[1:])
