"""Questions to the index: words, conditions on columns, and an order."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orchestrator.shelf.facts import COLUMNS, NUMBERS
from orchestrator.shelf.index import select
from orchestrator.validation.messages import suggestion
from protocols import InputError

DEFAULT_COLUMNS = (
    "run", "created", "motor", "serial", "operator", "outcome", "verdict", "accepted", "tags", "notes"
)  # fmt: skip
_CONDITION = re.compile(r"\s*(\w+)\s*(<=|>=|!=|!~|=|<|>|~)\s*(.*)", re.DOTALL)


@dataclass(frozen=True)
class Condition:
    """A comparison of one column with a value; ``~`` is true where its text contains the value, in any case."""

    column: str
    operator: str
    value: str | float

    @classmethod
    def parse(cls, text: str) -> Condition:
        """The condition in a text as ``resistance_ohm>4.3``; raises `InputError`."""
        match = _CONDITION.fullmatch(text)
        if match is None:
            raise InputError("--where", "", f"{text!r}; expected COLUMN=VALUE, with = != < > <= >= ~ (contains) or !~")
        column, operator, value = known_column(match[1], "--where"), match[2], match[3].strip()
        if column not in NUMBERS:
            return cls(column, operator, value)
        try:
            return cls(column, operator, float(value))
        except ValueError:
            raise InputError("--where", column, f"expected a number, got {value!r}") from None

    @property
    def sql(self) -> str:
        """With a ``?`` for the value."""
        if "~" in self.operator:
            return f"instr(lower({self.column}), lower(?)) {'=' if self.operator == '!~' else '>'} 0"
        collation = "" if self.column in NUMBERS else " COLLATE NOCASE"
        return f"{self.column} {self.operator} ?{collation}"


@dataclass(frozen=True)
class RunQuery:
    """What of an index is wanted.

    Attributes
    ----------
    words : sequence of str
        Each has to be in a run's path or texts, in any case.
    conditions : sequence of Condition
    sort : str
        A column, or ``-column`` for the largest first; runs without a value come last.
    limit, skip : int
        The number of runs at most, negative for all of them; and of the first ones that are left out.
    above : str
        A path before each run's that words may match too.
    """

    words: Sequence[str] = ()
    conditions: Sequence[Condition] = ()
    sort: str = "created"
    limit: int = -1
    skip: int = 0
    above: str = ""

    @property
    def where(self) -> str:
        """SQL of the conditions."""
        parts = ["outcome != ''", *("instr(? || words, ?) > 0" for _ in self.words), *(c.sql for c in self.conditions)]
        return " AND ".join(parts)

    @property
    def order(self) -> str:
        """SQL of the order."""
        column = known_column(self.sort.removeprefix("-"), "--sort")
        direction = "DESC" if self.sort.startswith("-") else "ASC"
        is_missing = f"{column} IS NULL OR {column} = ''"
        return f"ORDER BY {is_missing}, {column} {direction}, created {direction}, run {direction}"

    @property
    def parameters(self) -> list[str | float]:
        """Values of the ``?`` in `where`."""
        words = [part for word in self.words for part in (self.above.lower(), word.lower())]
        return [*words, *(condition.value for condition in self.conditions)]


COMMON_NAMES: dict[str, str] = {
    **dict.fromkeys(("r", "rs", "resistance"), "resistance_ohm"),
    **dict.fromkeys(("ld", "ldd"), "l_dd_h"),
    **dict.fromkeys(("lq", "lqq"), "l_qq_h"),
    **dict.fromkeys(("flux", "psi", "pmflux", "ratedflux"), "rated_flux_wb"),
    **dict.fromkeys(("date", "time"), "created"),
}
"""Columns by the names that pages and reports give their quantities, in lower case without underscores."""


def known_column(name: str, where: str) -> str:
    """The name of a column; raises `InputError` with the nearest one."""
    if name not in COLUMNS:
        known = COMMON_NAMES.get(name.lower().replace("_", ""))
        hint = suggestion(name, COLUMNS) if known is None else f"did you mean {known!r}?"
        raise InputError(where, name, f"no such column; {hint}")
    return name


@dataclass(frozen=True)
class FoundRuns:
    """Runs of an index.

    Attributes
    ----------
    rows : list of tuple
        Values of the columns in each run.
    count : int
        Number of the runs without the limit.
    problems : list of str
        Errors of all runs in the folder that cannot be read, or not wholly.
    """

    rows: list[tuple[Any, ...]]
    count: int
    problems: list[str]


def find_runs(
    folder: Path,
    wanted: RunQuery,
    columns: Sequence[str] = COLUMNS,
    tell: Callable[[int, int], None] = lambda done, of: None,
    *,
    refreshed: bool = True,
) -> FoundRuns:
    """The runs of a folder that are wanted; the columns are names of `COLUMNS`, the rest as `select` has it."""
    selection, parameters = f"FROM runs WHERE {wanted.where}", wanted.parameters
    rows, ((count,),), problems = select(
        folder,
        [
            (f"SELECT {', '.join(columns)} {selection} {wanted.order} LIMIT ? OFFSET ?",
             [*parameters, wanted.limit, wanted.skip]),
            (f"SELECT count(*) {selection}", parameters),
            ("SELECT problem FROM runs WHERE problem != '' ORDER BY run", ()),
        ],
        tell,
        refreshed=refreshed,
    )  # fmt: skip
    return FoundRuns(rows, int(count), [problem for (problem,) in problems])
