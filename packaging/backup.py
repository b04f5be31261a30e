"""Backup of a folder of runs to one archive, and back; a run that is under way is left for the next time.

    python packaging/backup.py save runs runs.tar.gz
    python packaging/backup.py restore runs.tar.gz runs

An archive is complete or absent. Restoring overwrites nothing: a run of a name that is there already is left out. The
exit code is 1 where anything was left out, and 2 where the disk is full or a file cannot be read.
"""

from __future__ import annotations

import os
import sys
import tarfile
import tempfile
from contextlib import suppress
from pathlib import Path

from orchestrator.operating_system.locks import LOCK_NAME, is_locked


def save(folder: Path, archive: Path) -> list[str]:
    """Write the folder's runs to an archive; the names of those that a process works on. Raises `OSError`."""
    partial = archive.with_name(f".{archive.name}.partial")
    left: list[str] = []
    try:
        with partial.open("wb") as file:
            with tarfile.open(fileobj=file, mode="w:gz") as tar:
                for run in sorted(place for place in folder.iterdir() if place.is_dir()):
                    if is_locked(run.with_name(run.name.removesuffix(".sealed")) / LOCK_NAME):
                        left.append(run.name)
                    else:
                        tar.add(run, run.name)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(archive)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
    return left


def restore(archive: Path, folder: Path) -> list[str]:
    """Bring an archive's runs into a folder; the names of those that were there already. Raises `OSError`."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".restoring-", dir=folder) as staging:
        with tarfile.open(archive, "r:gz") as tar:
            tar.extractall(staging, filter="data")
        left: list[str] = []
        for run in sorted(Path(staging).iterdir()):
            if (folder / run.name).exists():
                left.append(run.name)
            else:
                run.replace(folder / run.name)
    return left


def main(words: list[str]) -> int:
    """Exit code of the command."""
    action = {"save": save, "restore": restore}.get(words[0] if len(words) == 3 else "")
    if action is None:
        sys.stderr.write((__doc__ or "").partition("\n\n")[2])
        return 2
    try:
        left = action(Path(words[1]), Path(words[2]))
    except (OSError, EOFError, tarfile.TarError) as error:
        where = getattr(error, "filename", None) or words[1]
        sys.stderr.write(f"{where}: {getattr(error, 'strerror', None) or error}\n")
        return 2
    for name in left:
        sys.stderr.write(f"{name}: left out\n")
    return 1 if left else 0


if __name__ == "__main__":
    with suppress(BrokenPipeError):
        sys.exit(main(sys.argv[1:]))
