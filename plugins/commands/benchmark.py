"""`fluxbench benchmark make|run|score`: the benchmark of missing physics."""

from __future__ import annotations

import importlib
import subprocess
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from plugins.command_line import AsJson, group_entry_point
from protocols import InputError

HELP_GROUP = "Try and prove"
"""Its place in the list of commands."""


SET = Annotated[Path, typer.Argument(help="Folder of the 120 recordings, which `make` creates.", metavar="SET")]
Only = Annotated[list[str] | None, typer.Option("--only", help="Only this recording; may be repeated.", metavar="ID")]
FROM_SOURCE = "needs the source tree, whose plants are not in the wheel: start it in a clone of the repository"


class Method(StrEnum):
    """Who answers: fluxbench, or a script of `examples/benchmark`."""

    FLUXBENCH = "fluxbench"
    LEAST_SQUARES = "least_squares"
    THRESHOLDED = "thresholded"
    LASSO = "lasso"
    GAUSSIAN_PROCESS = "gaussian_process"


def make(folder: SET, only: Only = None) -> int:
    """Make the recordings and their sealed truths.

    They are made from seeds and compared with the frozen hashes. Recordings that are there are kept. Exit code 3:
    something differs, or was not made.
    """
    from orchestrator.benchmark import NAME, VERSION, frozen_rows
    from orchestrator.formatting.sentences import shown

    making: Any = _from_source("make", "tests.blind.benchmark.make")
    rows = frozen_rows()
    strange = next((name for name in only or () if name not in {row.id for row in rows}), None)
    if strange is not None:
        raise InputError("--only", strange, f"no recording of {NAME} {VERSION}")
    chosen = [row for row in rows if not only or row.id in only]
    remarks = making.make_set(chosen, folder, lambda name: print(f"making {name}", file=sys.stderr, flush=True))
    for remark in remarks:
        print(shown(remark))
    same = len(chosen) - len({remark.partition(":")[0] for remark in remarks})
    print(shown(f"{folder}: {same} of {len(chosen)} recordings are those of {NAME} {VERSION}"))
    return 3 if remarks else 0


def run(
    folder: SET,
    out: Annotated[Path, typer.Option(help="File of answers, JSON lines: created, or continued.", metavar="FILE")],
    method: Annotated[Method, typer.Option(help="Who answers.")] = Method.FLUXBENCH,
    only: Only = None,
) -> int:
    """Answer each recording that has no answer yet."""
    from orchestrator.benchmark import answer_set, answerer, read_manifest

    read_manifest(folder)
    if method is not Method.FLUXBENCH:
        script = _source("run") / "examples" / "benchmark" / f"{method.value}.py"
        words = [str(folder), "--out", str(out), *(word for name in only or () for word in ("--only", name))]
        return subprocess.run([sys.executable, str(script), *words], check=False).returncode
    for found, left in answer_set(folder, out, answerer(), only or ()):
        names = ", ".join(named.name for named in found.names) or "no name"
        print(f"{found.id} {found.verdict}: {names}; {left} left", file=sys.stderr, flush=True)
    return 0


def score(
    answers: Annotated[Path, typer.Argument(help="File of answers, JSON lines.", metavar="ANSWERS")],
    truth: Annotated[Path, typer.Argument(help="The set's folder of truths.", metavar="TRUTH")],
    answered: Annotated[bool, typer.Option("--answered", help="Leave out recordings without an answer.")] = False,
    as_json: AsJson = False,
) -> int:
    """Score answers against the sealed truths.

    Each truth is checked against its seal. The scores are printed by class, with the worst answers.
    """
    import json

    from orchestrator.benchmark import read_answers, scorer
    from orchestrator.formatting.sentences import shown, visible

    read_answers(answers)
    try:
        scores = scorer.scores_of(answers, truth, answered=answered)
    except scorer.ScoreError as wrong:
        raise InputError("", "", str(wrong)) from None
    if as_json:
        print(visible(json.dumps({"all": scorer.summary(scores), "recordings": scores}, indent=2)))
    else:
        print(shown(scorer.report(scores)))
    return 0


app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    no_args_is_help=True,
    help="The benchmark of missing physics.",
    epilog="Example: fluxbench benchmark run set --out answers.jsonl",
)
app.command("make", epilog="Example: fluxbench benchmark make set")(make)
app.command("run", epilog="Example: fluxbench benchmark run set --out answers.jsonl")(run)
app.command("score", epilog="Example: fluxbench benchmark score answers.jsonl set/truth")(score)
command = group_entry_point(app, "benchmark")


def _source(verb: str) -> Path:
    """The source tree that this module is in; raises `InputError` where it is installed from a wheel."""
    root = Path(__file__).parents[2]
    if not (root / "tests" / "blind" / "benchmark" / "make.py").is_file():
        raise InputError(f"fluxbench benchmark {verb}", "", FROM_SOURCE)
    return root


def _from_source(verb: str, module: str) -> Any:
    """A module of the source tree's tests."""
    root = _source(verb)
    if str(root) not in sys.path:
        raise InputError(f"fluxbench benchmark {verb}", "", FROM_SOURCE)
    return importlib.import_module(module)
