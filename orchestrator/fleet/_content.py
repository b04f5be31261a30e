"""A source's files, brought to this machine where they are elsewhere, and the hash of what is in them."""

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

BLOCK = 1 << 20
"""Bytes that are hashed at a time."""


@contextmanager
def at_hand(source: Source, *, stays: bool) -> Iterator[Path]:
    """The source as a path of this machine.

    Parameters
    ----------
    stays : bool
        Whether what was fetched is kept beside this worker, for whoever asks next.

    Raises
    ------
    RecordingError
        Where it cannot be fetched.
    """
    fs, path = filesystem_of(source.url)
    if is_local(fs):
        yield Path(path)
        return
    shelf = _shelf()
    if shelf is None:
        with tempfile.TemporaryDirectory(prefix="fluxbench-fleet-") as folder:
            yield _fetched(fs, path, source, Path(folder))
        return
    place = shelf / source.fingerprint
    try:
        yield _fetched(fs, path, source, place)
    finally:
        if not stays:
            shutil.rmtree(place, ignore_errors=True)


def _shelf() -> Path | None:
    """A folder of the worker that this runs on, which it removes when it ends; None elsewhere."""
    from distributed import get_worker

    try:
        return Path(get_worker().local_directory) / "recordings"
    except ValueError:
        return None


def _fetched(fs: Any, path: str, source: Source, place: Path) -> Path:
    """Below `place`, under the source's own name; what is there already is whole, for it is renamed in the end."""
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
            # The file that is asked for stands for all, and comes last.
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
    """Of all that a recording consists of, or of one file: names and bytes.

    Raises
    ------
    RecordingError
        Where something cannot be read.
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
                while block := content.read(BLOCK):
                    whole.update(block)
    except OSError as error:
        raise RecordingError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    return whole.hexdigest()
