"""The journal: one JSON line an event, appended and never changed; what the last instant tore off is dropped.

It is the source of truth for resuming a run. What the messages mean is not known here.
"""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from orchestrator._validation import first_problem
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

    def read(self) -> list[JournalRecord]:
        """All whole records in order; a torn last line is passed over.

        Raises
        ------
        RecordingError
            Where a line that is not the last one is torn, unknown, or out of order.
        """
        return self._read()[0]

    def __enter__(self) -> Self:
        records, self._size = self._read()
        self._next = len(records)
        try:
            self._descriptor = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
            os.ftruncate(self._descriptor, self._size)
            os.fsync(self._descriptor)
        except OSError as error:
            raise self._storage_error(error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def append(self, message: JournalledMessage, durable: bool = False) -> None:
        """Add a record; with `durable` it is on the disk when this returns.

        Raises `StorageError` where it cannot be written; the journal then ends with the last whole record.
        """
        if self._descriptor is None:
            raise ValueError("the journal is not open for appending")
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = f'{{"t":"{now}","n":{self._next},"message":{message.model_dump_json()}}}\n'.encode()
        try:
            self._write(self._descriptor, line)
            if durable:
                os.fdatasync(self._descriptor)
        except OSError as error:
            raise self._storage_error(error) from error
        self._next += 1
        self._size += len(line)

    def _write(self, descriptor: int, line: bytes) -> None:
        written = 0
        try:
            while written < len(line):
                written += os.write(descriptor, line[written:])
        except OSError:
            os.ftruncate(descriptor, self._size)
            raise

    def _read(self) -> tuple[list[JournalRecord], int]:
        if self.path.exists() and not self.path.is_file():  # reading a pipe would wait for ever
            raise RecordingError(str(self.path), "", "is not a plain file")
        try:
            content = self.path.read_bytes()
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
            raw: Any = json.loads(line)
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

    def _storage_error(self, error: OSError) -> StorageError:
        return StorageError(f"{self.path}: cannot be written: {error.strerror or error}")
