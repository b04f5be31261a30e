"""The journal: one JSON line per event, appended and never changed; an incomplete last line is dropped.

It is the source of truth for resuming a run. It does not interpret the messages.

After a failed sync the content of the disk is unknown, and a later successful sync proves nothing (Rebello et al., Can
applications recover from fsync failures?, ACM Trans. Storage 17, 2021, doi:10.1145/3450338). The journal then ends with
the last good sync, and accepts no record until it is opened again.
"""

from __future__ import annotations

import os
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from orchestrator.formatting.sentences import visible
from orchestrator.operating_system.files import BINARY, sync_content, sync_folder
from orchestrator.recording import storage_error
from orchestrator.validation.json_text import parse_json
from orchestrator.validation.messages import first_problem
from orchestrator.validation.plain_files import read_bytes
from protocols import JournalledMessage, RecordingError, StorageError


class JournalRecord(BaseModel):
    """One line of the journal."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    t: str
    """Wall-clock time, ISO 8601 in UTC."""
    n: Annotated[int, Field(ge=0)]
    """Number of the record, without gaps."""
    message: JournalledMessage


class Journal:
    """``journal.jsonl`` of a run.

    Made for reading; opened for appending as a context manager, by one process at a time (the
    run's lock sees to that).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor: int | None = None
        self._next = 0
        self._size = 0
        self._synced = 0
        self._failure: StorageError | None = None

    def read(self) -> list[JournalRecord]:
        """All complete records in order; an incomplete last line is skipped.

        Raises
        ------
        RecordingError
            Where a line before the last one is incomplete, unknown, or out of order.
        """
        return self._read()[0]

    def __enter__(self) -> Self:
        records, self._size = self._read()
        self._next, self._synced, self._failure = len(records), self._size, None
        try:
            self._descriptor = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | BINARY, 0o644)
            os.ftruncate(self._descriptor, self._size)
            os.fsync(self._descriptor)
            sync_folder(self.path.parent)
        except OSError as error:
            self._close()
            raise storage_error(self.path, error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def append(self, message: JournalledMessage, durable: bool = False) -> None:
        """Add a record; with `durable` it is on the disk when this returns.

        Raises `StorageError` where it cannot be written, and at every call after a failed sync. Unwritten and unsynced
        parts are cut off again; where even that fails, the line is the last one, complete or not.
        """
        if self._descriptor is None:
            raise ValueError("the journal is not open for appending")
        if self._failure is not None:
            raise self._failure
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = f'{{"t":"{now}","n":{self._next},"message":{visible(message.model_dump_json())}}}\n'.encode()
        try:
            self._write(self._descriptor, line)
        except OSError as error:
            raise self._cut(self._descriptor, error) from error
        self._next += 1
        self._size += len(line)
        if durable:
            self._sync(self._descriptor)

    def _write(self, descriptor: int, line: bytes) -> None:
        written = 0
        while written < len(line):
            written += os.write(descriptor, line[written:])

    def _sync(self, descriptor: int) -> None:
        try:
            sync_content(descriptor)
        except OSError as error:
            self._size = self._synced
            self._failure = self._cut(descriptor, error)
            raise self._failure from error
        self._synced = self._size

    def _cut(self, descriptor: int, why: OSError) -> StorageError:
        """End the file at its last good record; where that fails, no record may follow."""
        failure = storage_error(self.path, why)
        try:
            os.ftruncate(descriptor, self._size)
        except OSError:
            self._failure = failure
        return failure

    def _close(self) -> None:
        """Close the file; errors of closing concern records that were written or failed before."""
        if self._descriptor is not None:
            with suppress(OSError):
                os.close(self._descriptor)
            self._descriptor = None

    def _read(self) -> tuple[list[JournalRecord], int]:
        try:
            content = read_bytes(self.path)
        except FileNotFoundError:
            return [], 0
        except OSError as error:
            raise RecordingError(str(self.path), "", f"cannot be read: {error.strerror or error}") from None
        whole = content.rfind(b"\n") + 1
        lines = content[:whole].splitlines()
        return [self._parse(number, line) for number, line in enumerate(lines)], whole

    def _parse(self, number: int, line: bytes) -> JournalRecord:
        where = f"{self.path}:{number + 1}"
        try:
            raw: Any = parse_json(line)
        except (ValueError, RecursionError):
            raise RecordingError(where, "", "not a JSON object: the journal was damaged in its middle") from None
        try:
            record = JournalRecord.model_validate(raw)
        except ValidationError as error:
            problem = first_problem(error, JournalRecord, raw)
            raise RecordingError(where, problem.field, problem.text) from None
        if record.n != number:
            raise RecordingError(where, "n", f"expected record {number}, got {record.n}: lines are missing or doubled")
        return record
