"""What is drawn, as entries, and the file that takes them; knows nothing of runs or messages."""

from __future__ import annotations

import subprocess
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings
from rerun.chunk import RrdReader

from orchestrator.formatting.sentences import shown
from plugins.streams.rerun._spool import DirectFile, Spool, spool_of
from protocols import PluginError, RealArray, RecordingError

APPLICATION = "fluxbench"
FILE_NAME = "view.rrd"
EXPERIMENT = "experiment"
"""Timeline: the drive's clock since the start of the experiment."""
EFFECT_ADDED = "effect_added"
"""Timeline: one step for each effect that the model took up."""

_BEFORE = ".view-before.rrd"
_MAGIC, _FOOTER, _TAIL = b"RRF", b"RRF2FOOT", 16


@dataclass(frozen=True)
class When:
    """A place on the timelines; nothing at all is for ever (static)."""

    experiment_s: float | None = None
    step: int | None = None

    @property
    def is_static(self) -> bool:
        return self.experiment_s is None and self.step is None


ALWAYS = When()


@dataclass(frozen=True)
class Entry:
    """One thing to be written, to any stream, any number of times."""

    path: str
    write: Callable[[rr.RecordingStream], None]
    array_bytes: int = 0
    is_static: bool = False

    @property
    def size(self) -> int:
        """Bytes that it takes, roughly: those of its arrays, and what comes with every entry."""
        return 600 + self.array_bytes


def entry(path: str, when: When, *archetypes: Any, array_bytes: int = 0) -> Entry:
    """Archetypes at one instant."""

    def write(stream: rr.RecordingStream) -> None:
        stream.reset_time()
        if when.experiment_s is not None:
            stream.set_time(EXPERIMENT, duration=when.experiment_s)
        if when.step is not None:
            stream.set_time(EFFECT_ADDED, sequence=when.step)
        stream.log(path, *archetypes, static=when.is_static)

    return Entry(path, write, array_bytes, when.is_static)


def scalars(path: str, times_s: RealArray, values: RealArray) -> Entry:
    """Rows of values, shape (n, m), at times of the experiment, shape (n,)."""
    rows, width = values.shape

    def write(stream: rr.RecordingStream) -> None:
        columns = rr.Scalars.columns(scalars=values.ravel()).partition([width] * rows)
        stream.send_columns(path, indexes=[rr.TimeColumn(EXPERIMENT, duration=times_s)], columns=columns)

    return Entry(path, write, values.nbytes + times_s.nbytes)


def properties(name: str, values: Mapping[str, Any]) -> Entry:
    """Facts about the whole run; columns of the catalogue."""
    facts = rr.AnyValues(**{key: value for key, value in values.items() if value is not None})
    return Entry(f"__properties/{name}", lambda stream: stream.send_property(name, facts), is_static=True)


def titled(title: str) -> Entry:
    """The name that the viewer lists the run under."""
    return Entry("__properties", lambda stream: stream.send_recording_name(shown(title)), is_static=True)


def blueprint(job: str, layout: rrb.Blueprint) -> Entry:
    """A layout, active from now on."""

    def write(stream: rr.RecordingStream) -> None:
        stream.send_blueprint(layout, make_active=True, make_default=True)

    return Entry(f"__blueprint/{job}", write, 20_000, is_static=True)


def new_stream(recording_id: str, low_latency: bool = False) -> rr.RecordingStream:
    """A stream of its own, neither global nor anybody's default."""
    batching = rr.ChunkBatcherConfig.LOW_LATENCY() if low_latency else rr.ChunkBatcherConfig.DEFAULT()
    stream = rr.RecordingStream(APPLICATION, recording_id=recording_id, batcher_config=batching)
    stream.set_log_tick_enabled(False)
    return stream


@dataclass
class Tape:
    """``view.rrd``, from the first entry to the last; what an earlier stretch of the same run left is taken over.

    `listener` gets every entry as well.
    """

    file: Path
    listener: Callable[[Entry], None] | None = None
    name: str = ""
    """Of the recording; by default that of the file's folder."""
    recording_id: str = field(init=False)
    _stream: rr.RecordingStream = field(init=False)
    _spool: Spool | DirectFile = field(init=False)

    def __post_init__(self) -> None:
        self.recording_id = f"{self.name or self.file.resolve().parent.name}-{uuid.uuid4().hex[:8]}"
        before = self.file.with_name(_BEFORE)
        if self.file.is_file():
            self.file.replace(before)
        self._stream = new_stream(self.recording_id)
        self._spool = spool_of(self.file)
        self._stream.save(self._spool.entrance)
        self._spool.opened()
        if before.is_file():
            take_over(before, self._stream)
            before.unlink(missing_ok=True)

    def put(self, entries: Iterable[Entry]) -> None:
        """Write them, in order."""
        for item in entries:
            item.write(self._stream)
            if self.listener is not None:
                self.listener(item)

    def keep(self, item: Entry) -> None:
        """Write an entry into the file only."""
        item.write(self._stream)

    def close(self) -> None:
        """Finish the file; raises `StorageError` where it cannot be written."""
        self._stream.flush()
        self._stream.disconnect()
        del self._stream
        # The library keeps an unreferenced stream, and two threads, until it is disconnected (rerun-io/rerun 2116).
        rerun_bindings.flush_and_cleanup_orphaned_recordings()
        self._spool.close()


def executable() -> str:
    """The viewer's own program, as the package brings it.

    Raises
    ------
    PluginError
        Where it is not there.
    """
    spec = find_spec("rerun_cli")
    folder = Path(spec.origin).parent if spec is not None and spec.origin else Path()
    for place in (folder / "Rerun.app" / "Contents" / "MacOS" / "Rerun", folder / "rerun", folder / "rerun.exe"):
        if place.is_file():
            return str(place)
    raise PluginError("stream rerun", "viewer", "rerun-sdk is installed without its viewer")


def write_file(file: Path, name: str, entries: Iterable[Entry]) -> None:
    """Write entries into a file of their own; raises `StorageError` where it cannot be written."""
    tape = Tape(file, name=name)
    try:
        tape.put(entries)
    finally:
        tape.close()


def take_over(file: Path, stream: rr.RecordingStream) -> None:
    """Send what a file holds to a stream, its layouts left behind; a torn file is mended first."""
    source = file
    if not is_whole(file):
        source = file.with_suffix(".mended.rrd")
        mend = [executable(), "rrd", "optimize", str(file), "-o", str(source)]
        if subprocess.run(mend, stdin=subprocess.DEVNULL, capture_output=True, check=False).returncode:
            source.unlink(missing_ok=True)
            return  # killed before anything was written: nothing to take over
    try:
        stream.send_chunks(RrdReader(source).stream())
    finally:
        if source != file:
            source.unlink(missing_ok=True)


def refuse_foreign(file: Path) -> None:
    """Raise `RecordingError` where a file cannot be read, or is none of rerun's."""
    try:
        with file.open("rb") as stream:
            begins = stream.read(len(_MAGIC))
    except OSError as error:
        raise RecordingError(str(file), "", f"cannot be read: {error.strerror or error}") from None
    if begins != _MAGIC:
        raise RecordingError(str(file), "", "not a rerun file")


def is_whole(file: Path) -> bool:
    """Whether a file has come to its end; that of a killed run has no footer."""
    with file.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - _TAIL))
        return _FOOTER in stream.read(_TAIL)
