"""A source's files, fetched to this machine where they are remote, and the hash of their content."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from orchestrator.fleet._sources import CAPTURES, RUN_FILES, Source, filesystem_of, is_local, parts_of_file
from protocols import RecordingError

HASH_BLOCK_BYTES = 1 << 20
"""Bytes that are hashed at a time."""


@contextmanager
def local_copy(source: Source, *, keep: bool) -> Iterator[Path]:
    """The source as a path of this machine.

    Parameters
    ----------
    keep : bool
        Whether a fetched copy stays with this worker for the next task.

    Raises
    ------
    RecordingError
        Where it cannot be fetched.
    """
    fs, path = filesystem_of(source.url)
    if is_local(fs):
        yield Path(path)
        return
    folder_of_worker = _worker_folder()
    if folder_of_worker is None:
        with tempfile.TemporaryDirectory(prefix="fluxbench-fleet-") as folder:
            yield _fetch(fs, path, source, Path(folder))
        return
    place = folder_of_worker / source.fingerprint
    try:
        yield _fetch(fs, path, source, place)
    finally:
        if not keep:
            shutil.rmtree(place, ignore_errors=True)


def _worker_folder() -> Path | None:
    """A folder of this worker, which it removes when it ends; None outside a worker."""
    from distributed import get_worker

    try:
        return Path(get_worker().local_directory) / "recordings"
    except ValueError:
        return None


def _fetch(fs: Any, path: str, source: Source, place: Path) -> Path:
    """The copy below `place`, under the source's own name; an existing one is complete, since renaming comes last."""
    target = place / PurePosixPath(path).name
    if target.exists():
        return target
    partial = place / ".partial"
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        if fs.isdir(path):
            for name in _wanted(fs, path):
                (partial / name).parent.mkdir(exist_ok=True)
                fs.get_file(f"{path}/{name}", str(partial / name))
            partial.rename(target)
        else:
            # The named file marks all parts as complete, and comes last.
            for part in [*(part for part in parts_of_file(path)[1:] if fs.exists(part)), path]:
                name = PurePosixPath(part).name
                fs.get_file(part, str(partial / name))
                (partial / name).rename(place / name)
    except Exception as error:  # each store has errors of its own
        raise RecordingError(source.url, "", f"cannot be fetched: {type(error).__name__}: {error}") from None
    return target


def _wanted(fs: Any, path: str) -> list[str]:
    here = {PurePosixPath(str(info["name"])).name: info for info in fs.ls(path, detail=True)}
    names = [name for name in RUN_FILES if name in here]
    if CAPTURES in here:
        files = (info for info in fs.ls(f"{path}/{CAPTURES}", detail=True) if info["type"] == "file")
        names += [f"{CAPTURES}/{PurePosixPath(str(info['name'])).name}" for info in files]
    return names


def content_sha256(path: Path) -> str:
    """Hash of the names and bytes of a recording's files, or of one measurement file.

    Raises
    ------
    RecordingError
        Where a file cannot be read.
    """
    whole = hashlib.sha256()
    try:
        if path.is_file():
            parts = [path.with_name(name) for name in parts_of_file(path.name)]
        else:
            captures = sorted((path / CAPTURES).iterdir()) if (path / CAPTURES).is_dir() else []
            parts = [*(path / name for name in RUN_FILES), *captures]
        for file in (part for part in parts if part.is_file()):
            whole.update(f"{file.name}\n{file.stat().st_size}\n".encode())
            with file.open("rb") as content:
                while block := content.read(HASH_BLOCK_BYTES):
                    whole.update(block)
    except OSError as error:
        raise RecordingError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    return whole.hexdigest()
