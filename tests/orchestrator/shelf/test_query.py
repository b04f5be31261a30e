"""Runs are found by words and by conditions on columns, in the order of a column."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.shelf import Condition, RunQuery, find_runs
from protocols import InputError
from tests.orchestrator.shelf.example_runs import a_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("shelf") / "runs"
    a_run(path / "a", r_s=4.2, about={"serial": "PM-1", "tags": ["cold"]}, motor={"name": "Small"})
    a_run(path / "b", r_s=4.4, about={"serial": "PM-2", "tags": ["hot"]}, verdict="unknown_remains")
    a_run(path / "c", r_s=None, verdict=None, about={"serial": "PM-1", "notes": ["cold hall"]})
    (path / "broken").mkdir()
    (path / "broken" / "run.json").write_text("{")
    return path


def names(folder: Path, query: RunQuery) -> str:
    found = find_runs(folder, query, ["run"])
    assert len(found.problems) == 1
    return "".join(name for (name,) in found.rows)


@pytest.mark.parametrize(
    ("words", "found"), [([], "abc"), (["COLD"], "ac"), (["cold", "small"], "a"), (["4.2"], ""), (["%"], "")]
)
def test_words_are_sought_in_all_texts(folder: Path, words: list[str], found: str) -> None:
    assert names(folder, RunQuery(words)) == found


@pytest.mark.parametrize(
    ("conditions", "found"),
    [
        (["resistance_ohm>4.3"], "b"),
        (["resistance_ohm <= 4.4"], "ab"),
        (["serial=pm-1"], "ac"),
        (["serial!=PM-1"], "b"),
        (["verdict~REMAINS"], "b"),
        (["verdict!~e"], "c"),
        (["serial=PM-1", "resistance_ohm>0"], "a"),
        (["tags=' OR 1=1 --"], ""),
    ],
)
def test_conditions_compare_columns(folder: Path, conditions: list[str], found: str) -> None:
    assert names(folder, RunQuery(conditions=[*map(Condition.parse, conditions)])) == found


@pytest.mark.parametrize(
    ("sort", "found"), [("resistance_ohm", "abc"), ("-resistance_ohm", "bac"), ("-run", "cba"), ("tags", "abc")]
)
def test_runs_without_a_value_come_last_in_its_order(folder: Path, sort: str, found: str) -> None:
    assert names(folder, RunQuery(sort=sort)) == found


def test_some_of_the_runs_are_counted_with_the_rest(folder: Path) -> None:
    found = find_runs(folder, RunQuery(sort="run", limit=1, skip=1), ["run", "resistance_ohm"])
    assert (found.rows, found.count) == ([("b", 4.4)], 3)


@pytest.mark.parametrize(
    ("condition", "message"),
    [
        ("resistance", "expected COLUMN=VALUE"),
        ("r_s>1", "no such column; did you mean 'resistance_ohm'"),
        ("resistence_ohm>1", "no such column; did you mean 'resistance_ohm'"),
        ("resistance_ohm>much", "expected a number, got 'much'"),
    ],
)
def test_a_condition_that_is_none_is_one_line(condition: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Condition.parse(condition)


def test_an_order_by_no_column_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="no such column"):
        find_runs(folder, RunQuery(sort="run; DROP TABLE runs"))
