"""The fleet's table: a folder of Parquet files that one process writes, each complete or absent.

Each key has one row. A kill loses the rows since the last file, which the next job computes again.
"""

from __future__ import annotations

import hashlib
import io
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from orchestrator.operating_system.locks import LOCK_NAME, locked_file
from orchestrator.recording import remove_partial_files, replace_file
from protocols import InputError, StorageError, Strict
from protocols.fleet import FleetRow, arrow_schema

PART = "part-*.parquet"


class TableSettings(Strict):
    """Limits of rows and time after which a file is written."""

    batch_rows: int = Field(default=500, ge=1)
    batch_s: float = Field(default=15.0, ge=0)


class FleetTable:
    """The stored and the pending rows; create it by `opened`.

    Attributes
    ----------
    keys : set of str
        Keys of all rows, stored or pending.
    """

    def __init__(self, folder: Path, settings: TableSettings) -> None:
        self._folder, self._settings = folder, settings
        self._pending: list[dict[str, Any]] = []
        self._next_part, self._written_at = 0, time.monotonic()
        self.keys: set[str] = set()
        self._visits: dict[bytes, bool] = {}
        for part in parts_of(folder):
            self._next_part = max(self._next_part, int(part.stem.partition("-")[2]) + 1)
            for row in _columns(part, ("key", "source", "fingerprint", "asked", "versions", "failed")):
                self._remember(row)

    @classmethod
    @contextmanager
    def opened(
        cls, folder: Path, settings: TableSettings | None = None, *, forget_failed: bool = False
    ) -> Iterator[FleetTable]:
        """The table in a folder, created if missing, locked for this process; flushed at the end.

        Parameters
        ----------
        forget_failed : bool
            Remove the rows of failed sources, so that they are computed again.

        Raises
        ------
        InputError
            Where the folder contains other files, or another process writes the table.
        StorageError
            Where it cannot be written.
        """
        with _lock(folder):
            if forget_failed:
                _forget_failed(folder)
            table = cls(folder, settings or TableSettings())
            try:
                yield table
            finally:
                table.flush()

    def visit(
        self, source: str, fingerprint: str, steps: Sequence[str], version: str
    ) -> Literal["done", "failed"] | None:
        """The outcome of a source with the same listing, steps and version; None without one."""
        failed = self._visits.get(_visit(source, fingerprint, steps, version))
        return None if failed is None else "failed" if failed else "done"

    def add(self, row: dict[str, Any]) -> None:
        """Add a row, to be written with the next batch; raises `ValueError` for an existing key."""
        if row["key"] in self.keys:
            raise ValueError(f"{row['key']}: the table has this row already")
        self._remember(row)
        self._pending.append(row)
        aged = time.monotonic() - self._written_at >= self._settings.batch_s
        if aged or len(self._pending) >= self._settings.batch_rows:
            self.flush()

    def flush(self) -> None:
        """Write the pending rows as one more file; raises `StorageError`."""
        if self._pending:
            _write(self._folder / f"part-{self._next_part:06d}.parquet", self._pending)
            self._next_part += 1
            self._pending = []
        self._written_at = time.monotonic()

    def _remember(self, row: dict[str, Any]) -> None:
        self.keys.add(row["key"])
        version = (row["versions"] or {}).get("fluxbench", "")
        visit = _visit(row["source"], row["fingerprint"] or "", row["asked"] or (), version)
        self._visits[visit] = row["failed"] is not None


def parts_of(folder: Path) -> list[Path]:
    """The files of a table, in the order in which they were written."""
    return sorted(folder.glob(PART))


def read_table(folder: Path) -> list[FleetRow]:
    """All rows of a table.

    Raises
    ------
    InputError
        Where there is no table, or a file of it is damaged.
    """
    parts = parts_of(folder)
    if not parts:
        raise InputError(str(folder), "", "no table there: expected part-000000.parquet and so on")
    return [FleetRow.model_validate(row) for part in parts for row in _columns(part, None)]


def _columns(part: Path, names: Sequence[str] | None) -> list[dict[str, Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.ParquetFile(part).read(columns=None if names is None else list(names), use_threads=False)
    except (OSError, pa.ArrowException) as error:
        raise InputError(str(part), "", f"not a readable Parquet file: {str(error).partition(chr(10))[0]}") from None
    missing = [name for name in names or ("key", "source") if name not in table.column_names]
    if missing:
        raise InputError(str(part), missing[0], "column missing: not a part of a fleet's table")
    rows: list[dict[str, Any]] = table.to_pylist()
    return rows


def _write(path: Path, rows: list[dict[str, Any]]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    content = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(rows, schema=arrow_schema()), content, compression="zstd")
    replace_file(path, content.getvalue())


def _forget_failed(folder: Path) -> None:
    for part in parts_of(folder):
        rows = _columns(part, None)
        kept = [row for row in rows if row["failed"] is None]
        if not kept:
            part.unlink()
        elif len(kept) < len(rows):
            _write(part, kept)


def _visit(source: str, fingerprint: str, steps: Sequence[str], version: str) -> bytes:
    return hashlib.sha256("\n".join((source, fingerprint, *steps, version)).encode()).digest()[:16]


@contextmanager
def _lock(folder: Path) -> Iterator[None]:
    """Lock a table's folder for this process; the lock ends with the process, however that ends."""
    if folder.exists() and not folder.is_dir():
        raise InputError(str(folder), "", "is not a directory and is not overwritten: name another place")
    present = [file.name for file in folder.iterdir() if not file.name.startswith(".")] if folder.is_dir() else []
    if present and not parts_of(folder):
        raise InputError(str(folder), present[0], "is no part of a table: name a new folder or a table's")
    lock = ExitStack()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.enter_context(locked_file(folder / LOCK_NAME))
    except BlockingIOError:
        raise InputError(str(folder), "", "another fluxbench process writes this table") from None
    except OSError as error:
        raise StorageError(f"{folder}: cannot be created: {error.strerror or error}") from error
    with lock:
        remove_partial_files(folder)
        yield
