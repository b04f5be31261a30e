"""Recordings below folders and URLs: their places and fingerprints. Opens none of them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import PurePosixPath
from typing import Any

from orchestrator.recording import MANIFEST_NAME
from protocols import InputError, Strict

RUN_FILES = (MANIFEST_NAME, "run.json", "journal.jsonl")
"""Files of a recording or run, besides its folder of captures."""
CAPTURES = "captures"
COMPANIONS = {".cfg": ".dat"}
"""Second file of a measurement by the ending of the first: COMTRADE has its values beside their description."""


class Source(Strict):
    """One recording, or one measurement file to import."""

    url: str
    """A path, or ``protocol://...``."""
    fingerprint: str
    """Hash of names, sizes and times in the listing."""
    batch: str | None = None
    """Name of its folder, unless that is the searched folder itself."""


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
    """Every recording or run in or below a folder or URL, in order of the names.

    Parameters
    ----------
    files : bool
        Measurement files to import instead.

    Raises
    ------
    InputError
        Where there is no such folder, or it or a folder in it cannot be listed.
    """
    fs, root = filesystem_of(url)
    try:
        if not fs.isdir(root):
            raise InputError(url, "", "no such folder")
        yield from _walk(fs, root, files)
    except InputError:
        raise
    except Exception as error:  # each store has errors of its own
        raise InputError(url, "", f"cannot be listed: {type(error).__name__}: {error}") from None


def _walk(fs: Any, root: str, files: bool) -> Iterator[Source]:
    from orchestrator.importing import ENDINGS

    waiting = [root]
    while waiting:  # fsspec's own walk passes over folders that cannot be listed
        folder = waiting.pop()
        listed = [info for info in fs.ls(folder, detail=True) if str(info["name"]).rstrip("/") != folder]
        folders, here = ({PurePosixPath(str(i["name"])).name: i for i in one} for one in _split(listed))
        is_recording = RUN_FILES[0] in here or RUN_FILES[1] in here
        if files:
            for name in sorted(name for name in here if PurePosixPath(name).suffix.lower() in ENDINGS):
                parts = [here[part] for part in parts_of_file(name) if part in here]
                yield _source(fs, root, f"{folder.rstrip('/')}/{name}", parts)
        elif is_recording:
            captures = fs.ls(f"{folder}/{CAPTURES}", detail=True) if CAPTURES in folders else []
            yield _source(fs, root, folder, [*(here[n] for n in RUN_FILES if n in here), *captures])
        if files or not is_recording:  # the folders of a recording are its own
            inner = sorted((name for name in folders if not name.startswith(".")), reverse=True)
            waiting += [str(folders[name]["name"]).rstrip("/") for name in inner]


def _split(listed: Sequence[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Folders, and everything else."""
    folders = [info for info in listed if info["type"] == "directory"]
    return folders, [info for info in listed if info["type"] != "directory"]


def parts_of_file(name: str) -> list[str]:
    """A measurement file, and its possible companion."""
    ending = PurePosixPath(name).suffix
    companion = COMPANIONS.get(ending.lower())
    if companion is None:
        return [name]
    return [name, name.removesuffix(ending) + (companion.upper() if ending.isupper() else companion)]


def _source(fs: Any, root: str, path: str, listed: Sequence[dict[str, Any]]) -> Source:
    parent = PurePosixPath(path).parent
    batch = None if path == root or parent == PurePosixPath(root) else parent.name
    url = path if is_local(fs) else str(fs.unstrip_protocol(path))
    return Source(url=url, fingerprint=_fingerprint(listed), batch=batch)


def is_local(fs: Any) -> bool:
    """Whether a file system is local."""
    return "file" in ((fs.protocol,) if isinstance(fs.protocol, str) else fs.protocol)


def _fingerprint(listed: Iterable[dict[str, Any]]) -> str:
    """Hash of names, sizes and ETags (object stores) or times (file systems)."""
    lines = sorted(
        f"{PurePosixPath(str(info['name'])).name} {info.get('size')} {info.get('ETag') or info.get('mtime') or ''}"
        for info in listed
        if info.get("type") == "file"
    )
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:32]
