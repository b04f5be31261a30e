"""Recordings below folders and URLs: where they are, and by what they would be known again. Opens none of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import PurePosixPath
from typing import Any

from orchestrator.recording import MANIFEST_NAME
from protocols import InputError, Strict

RUN_FILES = (MANIFEST_NAME, "run.json", "journal.jsonl")
"""Of a recording or run, beside what is in its folder of captures."""
CAPTURES = "captures"
BESIDE = {".cfg": ".dat"}
"""What a measurement file is nothing without, by its ending: COMTRADE's values lie beside their description."""


class Source(Strict):
    """One recording, or one measurement file that is to become one."""

    url: str
    """A path, or ``protocol://...``."""
    fingerprint: str
    """Of names, sizes and times in the listing."""
    batch: str | None = None
    """The folder that it lies in, where that is not what was asked for itself."""


def filesystem_of(url: str) -> tuple[Any, str]:
    """The file system that a path or URL is on, and the path there; raises `InputError`."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        problem = f"is read by fsspec: pip install 'fluxbench[fleet]' ({error})"
        raise InputError(url, "", problem) from None
    try:
        fs, path = url_to_fs(url, use_listings_cache=False)
    except (ImportError, ValueError) as error:
        raise InputError(url, "", f"cannot be opened: {error}") from None
    return fs, str(path)


def sources_below(url: str, *, files: bool = False) -> Iterator[Source]:
    """Every recording or run below a folder or URL, that itself included, in order of the names.

    Parameters
    ----------
    files : bool
        Measurement files instead, which an import is to be asked of.

    Raises
    ------
    InputError
        Where there is no such folder, or it cannot be listed.
    """
    fs, root = filesystem_of(url)
    try:
        if not fs.isdir(root):
            raise InputError(url, "", "no such folder")
        yield from _walked(fs, root, files)
    except InputError:
        raise
    except Exception as error:  # each store has errors of its own
        raise InputError(url, "", f"cannot be listed: {type(error).__name__}: {error}") from None


def _walked(fs: Any, root: str, files: bool) -> Iterator[Source]:
    for folder, folders, here in fs.walk(root, detail=True, topdown=True):
        told = sorted(folders)
        found = RUN_FILES[0] in here or RUN_FILES[1] in here
        if files:
            for name in sorted(name for name in here if _is_measured(name)):
                listed = [here[part] for part in parts_of_file(name) if part in here]
                yield _source(fs, root, f"{folder.rstrip('/')}/{name}", listed)
        elif found:
            captures = fs.ls(f"{folder}/{CAPTURES}", detail=True) if CAPTURES in folders else []
            yield _source(fs, root, folder, [*(here[n] for n in RUN_FILES if n in here), *captures])
        kept = {name: folders[name] for name in told if not name.startswith(".") and not (found and not files)}
        # What is below a recording is its own, and what a walk does not keep it does not enter.
        folders.clear()
        folders.update(kept)


def _is_measured(name: str) -> bool:
    from orchestrator.importing import ENDINGS

    return PurePosixPath(name).suffix.lower() in ENDINGS


def parts_of_file(name: str) -> list[str]:
    """A measurement file, and the one that may lie beside it."""
    ending = PurePosixPath(name).suffix
    beside = BESIDE.get(ending.lower())
    if beside is None:
        return [name]
    return [name, name.removesuffix(ending) + (beside.upper() if ending.isupper() else beside)]


def _source(fs: Any, root: str, path: str, listed: Sequence[dict[str, Any]]) -> Source:
    parent = PurePosixPath(path).parent
    batch = None if path == root or parent == PurePosixPath(root) else parent.name
    return Source(url=_url_of(fs, path), fingerprint=_fingerprint(listed), batch=batch)


def _url_of(fs: Any, path: str) -> str:
    return path if is_local(fs) else str(fs.unstrip_protocol(path))


def is_local(fs: Any) -> bool:
    """Whether paths of this file system are this machine's own."""
    return "file" in ((fs.protocol,) if isinstance(fs.protocol, str) else fs.protocol)


def _fingerprint(listed: Iterable[dict[str, Any]]) -> str:
    """Object stores tell an ETag, file systems a time."""
    lines = sorted(
        f"{PurePosixPath(str(info['name'])).name} {info.get('size')} {info.get('ETag') or info.get('mtime') or ''}"
        for info in listed
        if info.get("type") == "file"
    )
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:32]
