"""Sees to it that a run has a whole ``view.rrd``: as it is, or made anew from the recording and its results."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.estimation import staging_folder
from orchestrator.operating_system.locks import LOCK_NAME, is_locked
from orchestrator.runs import is_run
from plugins.streams.rerun._stream import RerunOptions, RerunStream
from plugins.streams.rerun._tape import FILE_NAME, is_whole, refuse_foreign
from protocols import RecordingError, StorageError, StreamSetup

if TYPE_CHECKING:
    from protocols.fleet_report import FleetReport


@dataclass(frozen=True)
class Found:
    """A file to look at, and what there is to say about it."""

    file: Path
    remark: str = ""
    folder: Path | None = None
    """Made for this file alone, where it could not go into the run: whoever looked at it removes it."""

    def remove(self) -> None:
        """Leave nothing behind."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


def is_viewable(path: Path) -> bool:
    """Whether a directory is a run or a recording."""
    return is_run(path) or (path / "recording.json").is_file() or (path / FILE_NAME).is_file()


def whole_view(directory: Path, tell: Callable[[str], None]) -> Found:
    """The view of a run or recording, made where there is none, half a one, or one that is older than the results.

    Raises
    ------
    RecordingError
        Where there is nothing to make it from.
    StorageError
        Where it cannot be written; what there is of it is removed.
    """
    file = directory / FILE_NAME
    if file.is_file() and is_whole(file) and not is_stale(directory, file):
        return Found(file)
    if file.is_file() and _is_at_work(directory):
        return Found(file, f"{directory} is still under way: what is written so far is shown")
    why = "is missing"
    if file.is_file():
        torn = "is torn (the run was killed, or could not write it)"
        why = "is older than the run's results" if is_whole(file) else torn
    tell(f"{file} {why}: making it from the recording and its results")
    return make_view(directory)


def is_stale(directory: Path, file: Path) -> bool:
    """Whether something was found out after the view was made, and there is what to make it of."""
    if not any((directory / name).is_file() for name in ("run.json", "recording.json")):
        return False
    times = (result.stat().st_mtime for result in (directory / "results").glob("*"))
    return max(times, default=0.0) > file.stat().st_mtime + 1.0


def make_view(directory: Path) -> Found:
    """Replay a run or recording into a view; into the run itself, or elsewhere where it is not ours to write to."""
    try:
        if is_run(directory) and os.access(directory, os.W_OK):
            with staging_folder(directory, ".view-") as folder:
                view = _replayed(directory, folder)
                return Found(view.replace(directory / FILE_NAME))
        with _new_folder(directory.resolve().name) as folder:
            return Found(_replayed(directory, folder), f"kept in {folder}: the recording is left as it is", folder)
    except OSError as error:
        raise StorageError(f"{directory / FILE_NAME}: cannot be written: {error.strerror or error}") from error


def comparison_view(directories: Sequence[Path]) -> Found:
    """Several runs side by side, in a folder of its own; raises as `make_view`."""
    # A run that is measured needs nothing of what compares runs.
    from plugins.streams.rerun._comparison import write_comparison

    with _new_folder("comparison") as folder:
        file = folder / "comparison.rrd"
        write_comparison(directories, file)
        return Found(file, f"kept in {folder}", folder)


def make_fleet_view(report: FleetReport, file: Path) -> None:
    """A fleet's report as a file for the viewer; raises `StorageError` where it cannot be written."""
    from plugins.streams.rerun._fleet import write_fleet_view

    write_fleet_view(report, file)


@contextmanager
def _new_folder(name: str) -> Iterator[Path]:
    """A folder for temporary files, which stays unless the block raises."""
    folder = Path(tempfile.mkdtemp(prefix=f"{name}-"))
    try:
        yield folder
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def refuse_unreadable(file: Path) -> None:
    """Raise `RecordingError` where a file that was named is none of rerun's, or torn and nobody is at work on it."""
    refuse_foreign(file)
    if not is_whole(file) and not _is_at_work(file.parent):
        raise RecordingError(str(file), "", "torn: its end is missing; `fluxbench view` of the run makes it anew")


def _replayed(directory: Path, folder: Path) -> Path:
    # A run that is measured needs nothing of what reads one back.
    from plugins.streams.rerun._replay import replay

    messages = replay(directory)
    first = next(messages)  # an unreadable run raises before anything is made
    # What is in the file is a matter of the run, and not of how fast it is replayed: the clock stands still.
    setup, name = StreamSetup(run=folder, options=RerunOptions()), directory.resolve().name
    stream = RerunStream(setup, name=name, ripple_every_s=0.0, wall_s=lambda: 0.0)
    try:
        stream.receive(first)
        for message in messages:
            stream.receive(message)
    finally:
        stream.close()
    return folder / FILE_NAME


def _is_at_work(directory: Path) -> bool:
    """Whether a process holds the run."""
    return is_locked(directory / LOCK_NAME)
