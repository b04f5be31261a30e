"""A file that a library writes and that may fail: the library gets a pipe, which never does.

The writer of rerun's library ends at the first error of the disk, and whoever asks it to flush may then wait for ever,
at the latest when the process ends. So its bytes come out of a pipe and are written here, where an error is an
ordinary one, reported when the file is closed.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

from orchestrator.recording import storage_error

_CHUNK = 1 << 16


class DirectFile:
    """As `Spool` where the system has no paths of pipes (Windows): the library itself writes the file."""

    def __init__(self, file: Path) -> None:
        self.entrance = str(file)

    def opened(self) -> None:
        """As `Spool` has it."""

    def close(self) -> None:
        """As `Spool` has it; an error of the disk is not noticed."""


class Spool:
    """Owner of the thread that writes `file`.

    Parameters
    ----------
    file : Path

    Raises
    ------
    StorageError
        The file cannot be opened.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._failure: OSError | None = None
        try:
            self._target = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        except OSError as error:
            raise storage_error(file, error) from error
        self._source, self._entrance = os.pipe()
        self._thread = threading.Thread(target=self._work, name=f"writes {file.name}", daemon=True)
        self._thread.start()

    @property
    def entrance(self) -> str:
        """The path that the library opens and writes to; to be let go of with `opened`."""
        return f"/dev/fd/{self._entrance}"

    def opened(self) -> None:
        """The library has opened the entrance: when it closes it, the file has come to its end."""
        os.close(self._entrance)

    def close(self) -> None:
        """Wait for the last byte, when the library has closed the entrance; raises `StorageError` where one is lost."""
        self._thread.join()
        if self._failure is not None:
            raise storage_error(self._file, self._failure) from self._failure

    def _work(self) -> None:
        """Write until the library ends; what cannot be written is taken all the same, so that nobody waits."""
        try:
            while chunk := os.read(self._source, _CHUNK):
                if self._failure is None:
                    self._write(chunk)
        finally:
            os.close(self._source)
            self._end()

    def _end(self) -> None:
        try:
            os.close(self._target)
        except OSError as error:
            self._failure = self._failure or error

    def _write(self, chunk: bytes) -> None:
        rest = memoryview(chunk)
        try:
            while rest:
                rest = rest[os.write(self._target, rest) :]
        except OSError as error:
            self._failure = error


def spool_of(file: Path) -> Spool | DirectFile:
    """What brings a library's bytes into a file on this system."""
    return Spool(file) if Path("/dev/fd").is_dir() else DirectFile(file)
