"""The index of a folder of runs in SQLite: derived from the runs' own files, and never the truth.

A look at the folder finds the runs that are new, changed or gone, and reads those alone. An index that is damaged, of
another version or cannot be written is replaced by one in memory or in a new file, without a word: only time is lost.
"""

from __future__ import annotations

import os
import re
import sqlite3
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from orchestrator.shelf.facts import COLUMNS, NUMBERS, read_facts
from orchestrator.shelf.labels import LABELS_NAME

INDEX_NAME = ".index.sqlite"
JOURNAL_NAME = "journal.jsonl"
REVISION = 1
"""To be raised where a column's meaning changes."""
LOCK_TIMEOUT_S = 5.0
RACY_NS = 2_000_000_000
"""A file changed so shortly before it was read may change again without another time stamp."""
RUNS_PER_COMMIT = 200

Query = tuple[str, Sequence[str | float]]
"""SQL, and the values of its ``?``."""
Stamp = tuple[int, ...]
"""Times of change of a run's folder, results, labels and journal [ns], and the journal's size [bytes].

0: there is none; or the run has finished, and its journal grows no more before its folder changes too.
"""

_STAMP = ("folder_ns", "results_ns", "labels_ns", "journal_ns", "journal_bytes")
_STAMPS = f"SELECT run, {', '.join(_STAMP)} FROM runs"
_SCHEMA = "CREATE TABLE runs ({} TEXT PRIMARY KEY, {}, {}, words TEXT) WITHOUT ROWID".format(
    COLUMNS[0],
    ", ".join(f"{name} {'REAL' if name in NUMBERS else 'TEXT'}" for name in COLUMNS[1:]),
    ", ".join(f"{name} INTEGER" for name in _STAMP),
)
VERSION = zlib.crc32(f"{REVISION} {_SCHEMA}".encode()) >> 1
"""Of the index, as SQLite keeps it: a positive number of 32 bits."""
_INSERT = f"INSERT OR REPLACE INTO runs VALUES ({', '.join('?' * (len(COLUMNS) + len(_STAMP) + 1))})"
_SEALED = re.compile(r"\.sealed(\.\d+)?$")


def select(
    folder: Path,
    queries: Sequence[Query],
    tell: Callable[[int, int], None] = lambda done, of: None,
    *,
    refreshed: bool = True,
) -> list[list[tuple[Any, ...]]]:
    """Rows of each query on the index of a folder.

    Parameters
    ----------
    folder : Path
        The folder of runs, which are sought in its folders too.
    queries : sequence of Query
        They see the table ``runs`` with the columns of `RunFacts`, and ``words``: its texts in lower case.
    tell : callable
        Called with the number of runs read so far, and of those to be read.
    refreshed : bool
        Whether runs that are new or changed are read first.
    """
    file = folder / INDEX_NAME
    keeps = file.exists() or next(_runs_below(str(folder), "", {}), None) is not None
    for _ in range(2 if keeps else 0):
        try:
            with closing(sqlite3.connect(file, timeout=LOCK_TIMEOUT_S, isolation_level=None)) as connection:
                return _selected(connection, folder, queries, tell if refreshed else None)
        except sqlite3.OperationalError:  # locked for long, or in a folder that cannot be written
            break
        except sqlite3.DatabaseError:  # damaged
            for left in (file.with_name(f"{file.name}-journal"), file):
                with suppress(OSError):
                    left.unlink()
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as connection:
        _copy(file, connection)
        return _selected(connection, folder, queries, tell if refreshed else None)


def count_stale(folder: Path) -> int:
    """Number of runs by which the index of a folder differs from what is there: new, changed and gone ones."""
    known = {row[0]: row[1:] for row in _read(folder / INDEX_NAME, _STAMPS)}
    found = {_encodable(name): stamp for name, stamp in _runs_below(str(folder), "", known)}
    return sum(known.get(name) != found.get(name) for name in known.keys() | found.keys())


def _selected(
    connection: sqlite3.Connection, folder: Path, queries: Sequence[Query], tell: Callable[[int, int], None] | None
) -> list[list[tuple[Any, ...]]]:
    _prepare(connection)
    if tell is not None:
        _refresh(connection, folder, tell)
    return [connection.execute(sql, parameters).fetchall() for sql, parameters in queries]


def _copy(file: Path, to: sqlite3.Connection) -> None:
    """Copy an index that can be read and not written."""
    _prepare(to)
    # `Connection.backup` would wait for ever for an index that another process has locked.
    to.executemany(_INSERT, _read(file, "SELECT * FROM runs"))


def _read(file: Path, query: str) -> list[tuple[Any, ...]]:
    """Rows of an index as it is; none where it is missing, damaged, locked or of another version."""
    try:
        address = f"{file.resolve().as_uri()}?mode=ro"
        with closing(sqlite3.connect(address, uri=True, timeout=LOCK_TIMEOUT_S)) as connection:
            return connection.execute(query).fetchall() if _version_of(connection) == VERSION else []
    except sqlite3.Error:
        return []


def _prepare(connection: sqlite3.Connection) -> None:
    """Create the table, anew where it is of another version."""
    if _version_of(connection) == VERSION:
        return
    with _transaction(connection):
        if _version_of(connection) != VERSION:  # unless another process was first
            connection.execute("DROP TABLE IF EXISTS runs")
            connection.execute(_SCHEMA)
            connection.execute(f"PRAGMA user_version = {VERSION}")


def _version_of(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


@contextmanager
def _transaction(connection: sqlite3.Connection) -> Iterator[None]:
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
    except BaseException:
        connection.execute("ROLLBACK")
        raise
    connection.execute("COMMIT")


def _refresh(connection: sqlite3.Connection, folder: Path, tell: Callable[[int, int], None]) -> None:
    """Read the runs that are new or changed, and drop those that are gone."""
    known = {row[0]: row[1:] for row in connection.execute(_STAMPS)}
    now_ns = time.time_ns()
    found = {_encodable(name): (name, stamp) for name, stamp in _runs_below(str(folder), "", known)}
    gone = [(name,) for name in known.keys() - found.keys()]
    stale = [(name, stamp) for key, (name, stamp) in found.items() if known.get(key) != stamp]
    if gone:
        with _transaction(connection):
            connection.executemany("DELETE FROM runs WHERE run = ?", gone)
    for begin in range(0, len(stale), RUNS_PER_COMMIT):
        tell(begin, len(stale))
        batch = [_row(folder, name, stamp, now_ns) for name, stamp in stale[begin : begin + RUNS_PER_COMMIT]]
        with _transaction(connection):
            connection.executemany(_INSERT, batch)


def _row(folder: Path, name: str, stamp: Stamp, now_ns: int) -> tuple[object, ...]:
    facts = read_facts(folder / name, name)
    values = [getattr(facts, column) for column in COLUMNS]
    values = [_encodable(value) if isinstance(value, str) else value for value in values]
    words = " ".join(value for value in values if isinstance(value, str)).lower()
    if max(stamp[:-1]) > now_ns - RACY_NS:
        stamp = (0,) * len(stamp)
    elif facts.outcome == "finished":
        stamp = (*stamp[:-2], 0, 0)
    return (*values, *stamp, words)


def _encodable(text: str) -> str:
    """A text that SQLite takes: bytes of a file's name that are no UTF-8 are written out."""
    return text.encode(errors="backslashreplace").decode()


def _runs_below(folder: str, prefix: str, known: Mapping[str, Stamp]) -> Iterator[tuple[str, Stamp]]:
    """Name and stamp of each run below a folder; runs have no runs in them."""
    try:
        with os.scandir(folder) as listing:
            entries = [entry for entry in listing if entry.is_dir(follow_symlinks=False)]
    except OSError:
        return
    names = {entry.name for entry in entries}
    for entry in entries:
        name, path = prefix + entry.name, entry.path
        if ".sealed" in name and _SEALED.sub("", entry.name) in names:
            continue
        before, whole = known.get(_encodable(name)), _status(path)
        if whole is None or (before is None and not Path(path, "run.json").is_file()):
            yield from _runs_below(path, f"{name}/", known)
            continue
        results = _status(f"{path}/results")
        stamp: Stamp = (_changed_ns(whole), _changed_ns(results))
        # Labels where there were none, and a finished run that goes on, change the folder's time too.
        is_same = before is not None and before[:2] == stamp
        for k, file in enumerate((LABELS_NAME, JOURNAL_NAME), 2):
            status = None if is_same and before is not None and before[k] == 0 else _status(f"{path}/{file}")
            stamp += (_changed_ns(status),)
            size = 0 if status is None else status.st_size
        yield name, (*stamp, size)


def _changed_ns(status: os.stat_result | None) -> int:
    """Time of change, as far as SQLite's integers reach (to the year 2262, and then from 1970 on again)."""
    return 0 if status is None else status.st_mtime_ns % (1 << 63)


def _status(path: str) -> os.stat_result | None:
    try:
        return os.stat(path)  # noqa: PTH116  # a `Path` for each of 50,000 files takes longer than the query
    except OSError:
        return None
