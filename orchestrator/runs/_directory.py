"""A run directory: a recording plus run.json and the journal, made once, locked while worked on.

    <run>/run.json, journal.jsonl, recording.json, captures/, results/
    <run>.sealed/   beside it: what no analysis may see

What is measured, and in which order, is the engine's business.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationError

from orchestrator._validation import first_problem
from orchestrator.formatting.sentences import visible
from orchestrator.plain_files import read_bytes
from orchestrator.recording import (
    MANIFEST_NAME,
    capture_path,
    read_manifest,
    remove_partial_files,
    replace_file,
    write_manifest,
)
from orchestrator.registry import PluginInfo, PluginKind, installed
from orchestrator.runs._journal import Journal
from orchestrator.runs._provenance import provenance
from orchestrator.runs._record import RunRecord, hash_of, make_record, sealed_options_of, unsealed
from orchestrator.stages import parse_stages
from protocols import (
    Capabilities,
    Manifest,
    PointDone,
    Procedure,
    RecordingError,
    RunEnded,
    RunStarted,
    Segment,
    StagesAppended,
    StageSufficed,
    StorageError,
)

_RECORD, _JOURNAL, _LOCK, _CAPTURES, _OPTIONS = "run.json", "journal.jsonl", ".lock", "captures", "options.json"


def private_directory(path: Path) -> Path:
    """Where a run keeps what no analysis may see: a sibling of the run directory."""
    return path.with_name(f"{path.name}.sealed")


def is_run(path: Path) -> bool:
    """Whether a directory is a run's, and not only a recording."""
    return (path / _RECORD).is_file()


class RunDirectory:
    """One run on disk.

    Attributes
    ----------
    path : Path
        The directory; a recording as well.
    record : RunRecord
        What `run.json` holds.
    journal : Journal
        Readable always; appended to while the run is locked.
    private_directory : Path
        Sibling ``<name>.sealed``.
    """

    def __init__(self, path: Path, record: RunRecord) -> None:
        self.path = path
        self.record = record
        self.journal = Journal(path / _JOURNAL)
        self.private_directory = private_directory(path)

    @classmethod
    def create(
        cls, path: Path, procedure: Procedure, capabilities: Capabilities, *, sealed: Iterable[str] = ()
    ) -> Self:
        """Make a new run directory.

        Parameters
        ----------
        path : Path
            Must not exist, or be empty.
        procedure : Procedure
            As it is run.
        capabilities : Capabilities
            What the connected drive said of itself.
        sealed : iterable of str
            Names of the drive options that no analysis may see: `run.json` has their hashes, the
            private directory has them in clear, so that the run can be resumed.

        Raises
        ------
        RecordingError
            Where something is at `path` already.
        StorageError
            Where it cannot be made.
        """
        _refuse_non_empty(path)
        hidden = sealed_options_of(procedure, sealed)
        record = make_record(procedure, capabilities, provenance(_plugins_of(procedure)), hidden)
        run = cls(path.resolve(), record)
        secrets = run.private_directory / _OPTIONS
        try:
            _set_aside(run.private_directory)
            (run.path / _CAPTURES).mkdir(parents=True, exist_ok=True)
            run.private_directory.mkdir(exist_ok=True)
            run.private_directory.chmod(0o700)
        except OSError as error:
            raise StorageError(f"{run.path}: cannot be made: {error.strerror or error}") from error
        replace_file(secrets, (json.dumps(hidden, indent=1) + "\n").encode())
        replace_file(run.path / _RECORD, (visible(record.model_dump_json(indent=1)) + "\n").encode())
        return run

    @staticmethod
    def refuse_occupied(path: Path) -> None:
        """Raise `RecordingError` where a new run cannot go to `path`: nothing is ever overwritten."""
        _refuse_non_empty(path)

    @staticmethod
    @contextmanager
    def claim(path: Path) -> Iterator[None]:
        """Make the directory for a new run and hold it for this process; nothing is ever overwritten.

        Raises
        ------
        RecordingError
            Where it cannot be made, is not empty, or another process holds it.
        StorageError
            Where it cannot be held; it is gone again then, if it was not there before.
        """
        if (path / _LOCK).exists():  # a run's, perhaps one at work: its lock tells
            with _flock(path):
                RunDirectory.refuse_occupied(path)
        RunDirectory.refuse_occupied(path)  # before anything is put into somebody else's folder
        is_new = not path.exists()
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(str(path), "", f"cannot be made: {error.strerror or error}") from None
        with ExitStack() as held:
            try:
                held.enter_context(_flock(path))
            except StorageError:
                if is_new:
                    with suppress(OSError):
                        path.rmdir()
                raise
            RunDirectory.refuse_occupied(path)
            yield

    @staticmethod
    def has_captures(path: Path) -> bool:
        """Whether something was measured into the directory, whatever its journal says."""
        return next((path / _CAPTURES).glob("*.parquet"), None) is not None

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open an existing run; raises `RecordingError` where there is none or `run.json` is damaged."""
        file = path / _RECORD
        if not file.is_file():
            raise RecordingError(str(path), _RECORD, "missing: not a run directory")
        raw = _read_json(file)
        try:
            record = RunRecord.model_validate(raw)
        except ValidationError as error:
            problem = first_problem(error, RunRecord, raw)
            raise RecordingError(str(file), problem.field, problem.text) from None
        if hash_of(raw["procedure"]) != record.procedure_sha256:
            raise RecordingError(str(file), "procedure_sha256", "the procedure was changed after the run was made")
        return cls(path.resolve(), record)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold an existing run for this process and be `at_work`; `RecordingError` where another process holds it.

        The lock goes with the process, however that ends.
        """
        with _flock(self.path), self.at_work():
            yield

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Open the journal for appending and remove what a killed process left half written; for who holds the run."""
        with self.journal:
            for folder in (self.path, self.path / _CAPTURES, self.private_directory):
                remove_partial_files(folder)
            yield

    def refuse_lost_journal(self) -> None:
        """Raise `RecordingError` where captures were measured that the journal knows nothing of."""
        listed: set[str] = set()
        if (self.path / MANIFEST_NAME).is_file():
            listed = {segment.id for segment in read_manifest(self.path / MANIFEST_NAME).segments}
        lost = listed - self.completed().keys()
        captures = sum(1 for _ in (self.path / _CAPTURES).glob("*.parquet"))
        if lost or (captures and not self.journal.read()):
            problem = f"missing or cut: it does not know of {max(len(lost), captures)} captures that are there"
            raise RecordingError(str(self.journal.path), "", problem)

    def procedure(self) -> Procedure:
        """The procedure as it was run, sealed options included; raises `RecordingError` where they are gone."""
        if not self.record.sealed:
            return self.record.procedure
        file = self.private_directory / _OPTIONS
        options = _read_json(file)
        if not isinstance(options, dict):
            raise RecordingError(str(file), "", "expected a JSON object")
        return unsealed(self.record, options, str(file))

    def completed(self) -> dict[str, Segment]:
        """The segments of the points that are done, by point id, in order of the journal."""
        done = (entry.message for entry in self.journal.read())
        return {message.id: message.segment for message in done if isinstance(message, PointDone)}

    def appended(self) -> tuple[StagesAppended, ...]:
        """What was appended to the procedure's stages, in order of the journal."""
        told = (entry.message for entry in self.journal.read())
        return tuple(message for message in told if isinstance(message, StagesAppended))

    def sufficed(self) -> set[int]:
        """Places of the stages that need not measure the rest of their plan."""
        return {entry.message.index for entry in self.journal.read() if isinstance(entry.message, StageSufficed)}

    def ended(self) -> RunEnded | None:
        """How the run ended; None while there is something left of it, and after a kill."""
        last: RunEnded | None = None
        for entry in self.journal.read():
            if isinstance(entry.message, RunEnded):
                last = entry.message
            elif isinstance(entry.message, RunStarted | StagesAppended):
                last = None
        return last

    def end_s(self) -> float:
        """Where the experiment's clock stands: the end of what was captured last [s]; 0 before anything was."""
        segments = self.completed().values()
        rate = self.record.capabilities.sampling_frequency_hz
        return max((segment.start_s + segment.samples / rate for segment in segments), default=0.0)

    def manifest(self) -> Manifest:
        """The manifest as the journal has it: what it calls done is in it, and nothing else.

        Raises `RecordingError` where a capture that the journal calls done is gone.
        """
        segments = tuple(self.completed().values())
        for segment in segments:
            file = capture_path(self.path, segment.id)
            if not file.is_file():
                raise RecordingError(str(file), "", f"missing, though {_JOURNAL} calls it done")
        return Manifest(
            format="fluxbench-recording",
            version=1,
            name=self.record.name,
            created=self.record.created,
            motor=self.record.procedure.motor,
            drive=self.record.drive,
            segments=segments,
        )

    def write_manifest(self) -> Manifest:
        """Write `recording.json`; raises `StorageError` where it cannot be, and what `manifest` raises."""
        manifest = self.manifest()
        write_manifest(self.path, manifest)
        return manifest


@contextmanager
def _flock(path: Path) -> Iterator[None]:
    try:
        descriptor = os.open(path / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise StorageError(f"{path / _LOCK}: cannot be opened: {error.strerror or error}") from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(descriptor, 32, 0).decode(errors="replace").strip()
            raise RecordingError(
                str(path), "", f"another fluxbench process ({holder}) is at work on this run"
            ) from None
        with suppress(OSError):  # who holds it is a courtesy: the lock counts
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, f"pid {os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(descriptor)


def _set_aside(private: Path) -> None:
    """Rename what a run of this name that was deleted has left beside it; nothing is ever overwritten."""
    if not (private / _OPTIONS).exists():
        return
    numbered = (private.with_name(f"{private.name}.{k}") for k in count(1))
    private.rename(next(place for place in numbered if not place.exists()))


def _refuse_non_empty(folder: Path) -> None:
    """Raise `RecordingError` unless `folder` is not there, or empty but for its lock."""
    if folder.exists() and (not folder.is_dir() or any(file.name != _LOCK for file in folder.iterdir())):
        raise RecordingError(str(folder), "", "exists and is not empty; nothing is overwritten: choose another")


def _plugins_of(procedure: Procedure) -> list[PluginInfo]:
    named = {(PluginKind.DRIVES.value, procedure.drive.name)}
    every: set[str] = set()
    for stage in parse_stages(procedure):
        named.add((PluginKind.STAGES.value, stage.name))
        for use in stage.uses():
            every |= {use.kind} if use.name is None else set()
            named |= {(use.kind, use.name)} if use.name is not None else set()
    return [info for kind in PluginKind for info in installed(kind) if kind in every or (kind, info.name) in named]


def _read_json(file: Path) -> Any:
    try:
        return json.loads(read_bytes(file))
    except OSError as error:
        raise RecordingError(str(file), "", f"cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise RecordingError(str(file), "", f"broken JSON: {error}") from None
