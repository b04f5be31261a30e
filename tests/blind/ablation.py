"""`python -m tests.blind.ablation`: what each rule of the search earns, over stored recordings of the blind suite.

First every rule is observed: how often it is called, how often it gives back anything but what it was given, and what
it takes. A rule that changed nothing anywhere earns nothing. The others are then taken out, one at a time, over those
recordings alone whose answer they had a part in: all other answers are the same without.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial, wraps
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tests.blind.examine import Answer, examine, keep, kept
from tests.blind.hidden import KINDS, draw_case
from tests.blind.score import judge, stated

ROOM = "orchestrator.diagnosis"


@dataclass(frozen=True)
class Rule:
    """One step of the search that can be left out.

    Attributes
    ----------
    module, name : str
        Where its function is, below `ROOM`.
    nothing : callable
        What comes back where it does nothing, by the function's arguments.
    """

    module: str
    name: str
    nothing: Callable[[Mapping[str, Any]], Any]

    @property
    def label(self) -> str:
        return f"{self.module.rpartition('.')[2]}.{self.name}"


def _given(*names: str) -> Callable[[Mapping[str, Any]], Any]:
    """What it was given under these names, as a tuple where they are several."""
    return lambda given: given[names[0]] if len(names) == 1 else tuple(given[name] for name in names)


def _always(value: Any) -> Callable[[Mapping[str, Any]], Any]:
    return lambda _: value


RULES = (
    *(
        Rule(f"selection.{module}", name, _always(None))
        for module, names in (
            ("adding", ("_add_to_joint",)),
            ("shape_moves", ("_free", "_fix", "_switch")),
            ("removing", ("_remove_minor", "_swap", "_merge")),
            ("environment_moves", ("_count_scatter", "refine_quantiser_by_fit", "_estimate_quantiser")),
            ("environment_moves", ("_refine_map", "_coarsen_map")),
            ("search", ("_add_all",)),
        )
        for name in names
    ),
    Rule("selection.adding", "_is_indistinguishable", _always(False)),
    Rule("nuisances.segment_scatter", "with_scatter", _always(None)),
    Rule("selection.environment_moves", "with_detected_quantiser", _given("setup")),
    Rule("selection.environment_moves", "_by_dwells", _given("setup")),
    Rule("selection.naming", "drop_confounded", _given("search")),
)
BY_LABEL = {rule.label: rule for rule in RULES}


@dataclass
class Observed:
    """What a rule did in one diagnosis."""

    calls: int = 0
    changed: int = 0
    seconds: float = 0.0
    """Of CPU, calls within calls counted once."""
    depth: int = 0


def is_same(one: Any, other: Any) -> bool:
    """Whether two results lead a search on in the same way: the same fits, setups and names."""
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(is_same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, list | dict | bool) or one is None:
        return bool(one == other)
    return one is other


@contextmanager
def observing(without: Sequence[str] = ()) -> Iterator[dict[str, Observed]]:
    """What each rule does meanwhile; those named do nothing."""
    seen: dict[str, Observed] = {rule.label: Observed() for rule in RULES}
    changed: list[tuple[Any, str, Any]] = []
    try:
        for rule in RULES:
            function = getattr(import_module(f"{ROOM}.{rule.module}"), rule.name)
            stand_in = _wrapped(rule, function, seen[rule.label], idle=rule.label in without)
            for module in [m for n, m in sys.modules.items() if n.startswith(ROOM) and m is not None]:
                if getattr(module, rule.name, None) is function:
                    changed.append((module, rule.name, function))
                    setattr(module, rule.name, stand_in)
        yield seen
    finally:
        for module, name, function in changed:
            setattr(module, name, function)


def _wrapped(rule: Rule, function: Callable[..., Any], seen: Observed, *, idle: bool) -> Callable[..., Any]:
    signature = inspect.signature(function)

    @wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        given = signature.bind(*args, **kwargs)
        given.apply_defaults()
        nothing = rule.nothing(given.arguments)
        if idle:
            return nothing
        seen.calls += 1
        seen.depth += 1
        start = time.process_time()
        try:
            result = function(*args, **kwargs)
        finally:
            seen.depth -= 1
            if seen.depth == 0:
                seen.seconds += time.process_time() - start
        seen.changed += not is_same(result, nothing)
        return result

    return called


def ask(
    kind: str, index: int, seed: int, recordings: Path, without: tuple[str, ...]
) -> tuple[Answer, dict[str, dict[str, float]]]:
    """Diagnose one case while its rules are observed."""
    import_module(f"{ROOM}._diagnose")
    with observing(without) as seen:
        answer = examine(draw_case(kind, index, seed), recordings, held_against_others=False)
    return answer, {
        label: {"calls": one.calls, "changed": one.changed, "seconds": one.seconds}
        for label, one in seen.items()
        if one.calls
    }


def main(words: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    requested = _parser().parse_args(words)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for label in requested.without:
        if label not in BY_LABEL:
            print(f"--without {label}: no such rule; one of {', '.join(BY_LABEL)}", file=sys.stderr)
            return 2
    requested.recordings.mkdir(parents=True, exist_ok=True)
    known = kept(requested.answers, requested.seed)
    cases = [case for case in _cases(requested) if case not in known]
    question = partial(ask, seed=requested.seed, recordings=requested.recordings, without=tuple(requested.without))
    with ProcessPoolExecutor(requested.jobs, mp_context=get_context("spawn")) as pool:
        tasks = [pool.submit(question, *case) for case in cases]
        for task in as_completed(tasks):
            answer, rules = task.result()
            keep(requested.answers, requested.seed, answer, rules=rules)
            mark = "MISS" if judge(answer).wrong else "ok"
            print(
                f"{mark:<5}{answer.case.label:<34}{answer.cpu_s:6.1f} s  {answer.case.hidden} -> {stated(answer)}",
                flush=True,
            )
    print(table(requested.answers))
    return 0


def _cases(requested: argparse.Namespace) -> list[tuple[str, int]]:
    """Those named, or all whose recordings are stored; where rules are left out, of those that they had a part in."""
    if requested.cases:
        return [(kind, int(index)) for kind, index in (case.split(":") for case in requested.cases)]
    stored = [path.name.rpartition("-") for path in requested.recordings.iterdir() if not path.name.startswith(".")]
    cases = sorted(
        ((kind, int(index)) for kind, _, index in stored if kind in KINDS), key=lambda case: (case[1], case[0])
    )
    if requested.observed is None:
        return cases
    concerned = {
        tuple(row["case"])
        for row in map(json.loads, requested.observed.read_text(encoding="utf-8").splitlines())
        if any(row["rules"].get(label, {}).get("changed") for label in requested.without)
    }
    return [case for case in cases if case in concerned]


def table(answers: Path) -> str:
    """Of each rule: calls, those that changed anything, recordings in which one did, and its part of the CPU time."""
    rows = [json.loads(line) for line in answers.read_text(encoding="utf-8").splitlines()]
    total = sum(row["cpu_s"] for row in rows) or 1.0
    lines = ["| rule | calls | changed | recordings | % of the time |", "| --- | --- | --- | --- | --- |"]
    for rule in RULES:
        seen = [found for row in rows if (found := row.get("rules", {}).get(rule.label))]
        calls, changed = (round(sum(one[name] for one in seen)) for name in ("calls", "changed"))
        where, part = sum(one["changed"] > 0 for one in seen), 100.0 * sum(one["seconds"] for one in seen) / total
        lines.append(f"| `{rule.label}` | {calls} | {changed} | {where} | {part:.1f} |")
    return "\n".join(lines)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.blind.ablation", description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--recordings", type=Path, required=True, help="where the recordings are stored")
    parser.add_argument("--answers", type=Path, required=True, help="file to keep the answers in, a line each")
    parser.add_argument("--without", nargs="*", default=[], metavar="RULE", help="rules that do nothing")
    parser.add_argument(
        "--observed", type=Path, help="answers with all rules: only recordings that RULE changed are requested"
    )
    parser.add_argument("--cases", nargs="*", metavar="CASE", help="only these, e.g. single:3")
    parser.add_argument("--jobs", type=int, default=2)
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
