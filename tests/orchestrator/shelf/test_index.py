"""The index follows the runs' folders, and is never missed: damaged, old or unwritable, the answers are the same."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from orchestrator.runs import RunDirectory
from orchestrator.shelf import count_stale, relabel
from orchestrator.shelf.index import INDEX_NAME, RACY_NS, select
from tests.orchestrator.shelf.example_runs import a_run, write_journal
from tests.support.processes import start_fluxbench

ALL = [("SELECT run, outcome, tags, resistance_ohm FROM runs ORDER BY run", ())]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two runs that have not changed for long."""
    a_run(tmp_path / "runs" / "a", about={"tags": ["cold"]})
    a_run(tmp_path / "runs" / "b", r_s=4.5)
    return settled(tmp_path / "runs")


def settled(folder: Path) -> Path:
    """The folder, its files as old as an index needs to be sure of them."""
    for path in [*folder.rglob("*")]:
        aged = path.stat().st_mtime_ns - 2 * RACY_NS
        os.utime(path, ns=(aged, aged))
    return folder


def rows(folder: Path) -> list[tuple[object, ...]]:
    return select(folder, ALL)[0]


def number_read(folder: Path) -> int:
    """How many runs a look at the folder reads."""
    read = [0]
    select(folder, ALL, lambda done, of: read.__setitem__(0, of))
    return read[0]


BOTH = [("a", "finished", "cold", 4.25), ("b", "finished", "", 4.5)]


def test_only_what_is_new_or_changed_is_read(folder: Path) -> None:
    assert count_stale(folder) == 2
    assert rows(folder) == BOTH
    assert count_stale(folder) == number_read(folder) == 0
    a_run(folder / "nested" / "c")
    assert number_read(folder) == 1
    assert [row[0] for row in rows(folder)] == ["a", "b", "nested/c"]


def grown(folder: Path) -> None:
    write_journal(RunDirectory.open(folder / "a"), None)
    (folder / "a" / "recording.json").write_text("{}")


def labelled(folder: Path) -> None:
    relabel(folder / "a", tags=["returned"])


def estimated(folder: Path) -> None:
    (folder / "a" / "results" / "estimates.json").rename(folder / "a" / "results" / "gone.json")


def removed(folder: Path) -> None:
    (folder / "a").rename(folder.parent / "elsewhere")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (grown, ("a", "not ended", "cold", 4.25)),
        (labelled, ("a", "finished", "cold, returned", 4.25)),
        (estimated, ("a", "finished", "cold", None)),
        (removed, None),
    ],
)
def test_a_change_of_a_run_is_seen(
    folder: Path, change: Callable[[Path], None], expected: tuple[object, ...] | None
) -> None:
    rows(folder)
    change(folder)
    assert count_stale(folder) == 1
    assert rows(folder) == ([expected] if expected else []) + BOTH[1:]


def test_a_run_that_goes_on_is_followed(tmp_path: Path) -> None:
    run = a_run(tmp_path / "runs" / "a", outcome=None)
    settled(tmp_path / "runs")
    assert rows(tmp_path / "runs")[0][1] == "not ended"
    write_journal(RunDirectory.open(run), "finished")
    assert rows(tmp_path / "runs")[0][1] == "finished"


def test_labels_changed_by_hand_in_their_place_are_seen(folder: Path) -> None:
    labelled(folder)
    settled(folder)
    rows(folder)
    file = folder / "a" / "labels.json"
    with file.open("r+") as opened:
        text = opened.read()
        opened.seek(0)
        opened.write(text.replace("returned", "accepted"))
    assert rows(folder)[0][2] == "cold, accepted"


def test_a_file_that_changed_just_now_is_read_again(folder: Path) -> None:
    a_run(folder / "c")
    assert number_read(folder) == 3
    assert number_read(folder) == 1


def test_a_run_from_a_far_future_is_listed(folder: Path) -> None:
    far = 13_500_000_000_000_000_000  # in the year 2397, and beyond 64 bits
    os.utime(folder / "a", ns=(far, far))
    assert rows(folder) == BOTH
    assert rows(folder) == BOTH


def test_a_private_folder_beside_a_run_is_no_run(folder: Path) -> None:
    (folder / "a.sealed" / "run.json").write_text("{}")
    assert rows(folder) == BOTH


@pytest.mark.parametrize("content", [b"no database at all" * 100, b"", b"SQLite format 3\0" + b"\1" * 5000])
def test_a_damaged_index_is_made_anew(folder: Path, content: bytes) -> None:
    (folder / INDEX_NAME).write_bytes(content)
    assert rows(folder) == BOTH
    assert number_read(folder) == 0


def test_an_index_with_a_damaged_middle_is_made_anew(folder: Path) -> None:
    for name in "cdefghij":
        a_run(folder / name, verdict=None, r_s=None)
    before = rows(settled(folder))
    file = folder / INDEX_NAME
    size = file.stat().st_size
    with file.open("r+b") as opened:
        opened.seek(size // 2)
        opened.write(b"\xff" * (size - size // 2))
    assert rows(folder) == before
    with sqlite3.connect(file) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]


def test_an_index_of_another_version_is_made_anew(folder: Path) -> None:
    with sqlite3.connect(folder / INDEX_NAME) as connection:
        connection.execute("CREATE TABLE runs (run TEXT, colour TEXT)")
        connection.execute("PRAGMA user_version = 7")
    assert rows(folder) == BOTH
    assert number_read(folder) == 0


def test_a_folder_in_which_no_index_can_be_is_listed_without_one(folder: Path) -> None:
    (folder / INDEX_NAME).mkdir()
    assert rows(folder) == BOTH


def test_an_index_that_another_process_holds_for_long_is_left_alone(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows(folder)
    labelled(folder)
    monkeypatch.setattr("orchestrator.shelf.index.LOCK_TIMEOUT_S", 0.1)
    with sqlite3.connect(folder / INDEX_NAME, isolation_level=None) as holder:
        holder.execute("BEGIN EXCLUSIVE")
        assert rows(folder)[0][2] == "cold, returned"
        holder.execute("ROLLBACK")


def test_a_folder_without_runs_gets_no_index(tmp_path: Path) -> None:
    assert rows(tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_a_run_whose_name_is_no_text_is_listed_with_its_bytes_written_out(folder: Path) -> None:
    (folder / "b").rename(os.fsdecode(os.fsencode(folder) + b"/\xff"))
    assert [row[0] for row in rows(folder)] == ["\\udcff", "a"]
    assert number_read(settled(folder)) == 2
    assert number_read(folder) == 0


def test_processes_that_make_the_index_at_once_agree(folder: Path) -> None:
    for k in range(20):
        a_run(folder / f"more-{k:02d}", verdict=None, r_s=None)
    started = [start_fluxbench("runs", "--folder", folder, "--json") for _ in range(2)]
    assert [len(json.loads(process.communicate()[0])) for process in started] == [22] * 2
    assert len(rows(folder)) == 22
