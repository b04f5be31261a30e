"""Instruments for a stream: time limits on its calls, files it opens, arrays it receives."""

from __future__ import annotations

import hashlib
import os
import queue
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from protocols import Message

_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


class Worker:
    """The one thread that a stream's methods are called from, as in a run; a call that does not return is given up."""

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[Callable[[], Any] | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[tuple[Any, BaseException | None]] = queue.SimpleQueue()
        self.thread = threading.Thread(target=self._work, name="stream under test", daemon=True)
        self.thread.start()

    def call(self, function: Callable[[], Any], seconds: float) -> Any:
        """The function's result or exception; raises `TimeoutError` where neither comes in time."""
        self._calls.put(function)
        try:
            result, error = self._answers.get(timeout=seconds)
        except queue.Empty:
            raise TimeoutError from None
        if error is not None:
            raise error
        return result

    def end(self) -> None:
        self._calls.put(None)

    def _work(self) -> None:
        while (function := self._calls.get()) is not None:
            try:
                self._answers.put((function(), None))
            except BaseException as error:  # raised again where the call was made
                self._answers.put((None, error))


class _OpenedFiles:
    """Python's audit hook cannot be taken away again: it is installed once, and inactive outside `watched`."""

    def __init__(self) -> None:
        self._installed = False
        self._into: set[str] | None = None

    @contextmanager
    def watched(self) -> Iterator[set[str]]:
        """The files that are opened to be written, and directories made, meanwhile."""
        if not self._installed:
            sys.addaudithook(self._hear)
            self._installed = True
        paths: set[str] = set()
        self._into = paths
        try:
            yield paths
        finally:
            self._into = None

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self._into is None or event not in ("open", "os.mkdir"):
            return
        path, mode, flags = (*arguments, None, None)[:3]
        written = (
            event == "os.mkdir" or (isinstance(flags, int) and flags & _WRITES) or set(str(mode or "")) & set("wax+")
        )
        if written and isinstance(path, str | bytes | os.PathLike):
            self._into.add(str(Path(os.fsdecode(path)).absolute()))


OPENED_FILES = _OpenedFiles()


def left_elsewhere(opened: set[str], run: Path) -> list[str]:
    """What was written beside the run directory and is still there; caches of libraries, which are hidden, may be."""
    places = [Path(name) for name in opened]
    return sorted(
        str(place)
        for place in places
        if place.exists()
        and not place.is_relative_to(run)
        and not place.is_relative_to("/dev")
        and not any(part.startswith(".") or part == "__pycache__" for part in place.parts)
    )


def digest(messages: list[Message]) -> str:
    """Of every array in the messages."""
    sha = hashlib.sha256()
    for array in _arrays(messages):
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def _arrays(value: object) -> Iterator[np.ndarray[Any, Any]]:
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, BaseModel):
        yield from _arrays([item for _, item in value])
    elif isinstance(value, dict):
        yield from _arrays(list(value.values()))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _arrays(item)
