"""Files that are either complete or absent, also after a power cut, whatever their content."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path

from orchestrator.operating_system.files import replace, sync_folder
from protocols import StorageError

PARTIAL_SUFFIX = ".partial"


def capture_path(directory: Path, segment_id: str) -> Path:
    """The file of a segment's waveforms in a recording."""
    return directory / "captures" / f"{segment_id}.parquet"


def replace_file(path: Path, content: bytes) -> None:
    """Write `content` to `path` so that a reader sees the old file or the new one, never a part.

    Several processes may replace one file at once: the last one's stays. Raises `StorageError` where the disk is full
    or the folder gone; the old file is then untouched.
    """
    partial = path.with_name(f".{path.name}.{threading.get_native_id()}{PARTIAL_SUFFIX}")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        replace(partial, path)
        sync_folder(path.parent)
    except OSError as error:
        with suppress(OSError):  # where nothing can be written, nothing can be removed either
            partial.unlink(missing_ok=True)
        raise storage_error(path, error) from error


def remove_partial_files(folder: Path) -> None:
    """Remove half-written files of a killed process from `folder`; only the folder's owner may call it.

    Raises `StorageError` where it cannot be removed.
    """
    for leftover in folder.glob(f".*{PARTIAL_SUFFIX}"):
        try:
            leftover.unlink(missing_ok=True)
        except OSError as error:
            raise storage_error(leftover, error) from error


def partial_path(path: Path) -> Path:
    """The hidden temporary name beside `path`."""
    return path.with_name(f".{path.name}{PARTIAL_SUFFIX}")


def storage_error(path: Path, error: OSError) -> StorageError:
    """The project's error for a write that the operating system refused."""
    return StorageError(f"{path}: cannot be written: {error.strerror or error}")
