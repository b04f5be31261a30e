"""The emulator's log: one JSON object per line, flushed at once."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any, Protocol

from protocols import StorageError


class Log(Protocol):
    """Receiver of events."""

    def __call__(self, event: str, **details: Any) -> None: ...


def no_log(event: str, **details: Any) -> None:
    """Discard an event."""


class JsonLines:
    """Appends events to a file: ``time_s`` is the machine's monotonic clock, ``unix_s`` the time of day."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("a", buffering=1, encoding="utf-8")
        except OSError as error:
            raise StorageError(f"{path}: cannot be written: {error.strerror}") from None

    def __call__(self, event: str, **details: Any) -> None:
        line = {"time_s": round(time.monotonic(), 6), "unix_s": round(time.time(), 6), "event": event, **details}
        try:
            self._file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise StorageError(f"{self._path}: cannot be written: {error.strerror}") from None

    def close(self) -> None:
        self._file.close()
