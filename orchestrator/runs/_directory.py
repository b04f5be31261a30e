"""A run directory: a recording plus run.json and the journal, created once, locked during work.

    <run>/run.json, journal.jsonl, recording.json, captures/, results/
    <run>.sealed/   beside it: data that no analysis may see

The engine decides what is measured, and in which order.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationError

from orchestrator.operating_system.locks import LOCK_NAME, locked_file
from orchestrator.recording import (
    MANIFEST_NAME,
    capture_path,
    read_manifest,
    remove_partial_files,
    replace_file,
    require_recording,
    write_json,
    write_manifest,
)
from orchestrator.registry.plugins import PluginInfo, PluginKind, installed
from orchestrator.runs._journal import Journal, JournalRecord
from orchestrator.runs._provenance import provenance
from orchestrator.runs._record import RunRecord, hash_of, make_record, unsealed
from orchestrator.runs._staging import remove_stale_staging
from orchestrator.stages import parse_stages
from orchestrator.validation.json_text import parse_json
from orchestrator.validation.messages import first_problem
from orchestrator.validation.plain_files import read_bytes
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

_RECORD, _JOURNAL, _CAPTURES, _OPTIONS = "run.json", "journal.jsonl", "captures", "options.json"


def private_directory(path: Path) -> Path:
    """The folder for data that no analysis may see: a sibling of the run directory."""
    return path.with_name(f"{path.name}.sealed")


def is_private(path: Path) -> bool:
    """Whether a path is a `private_directory`, of a run that may be deleted by now, and no run itself."""
    return re.search(r"\.sealed(\.\d+)?$", path.name) is not None and path.is_dir() and not is_run(path)


def is_run(path: Path) -> bool:
    """Whether a directory is a run, and not only a recording."""
    return (path / _RECORD).is_file()


def _not_created(error: OSError) -> str:
    return f"cannot be created: {error.strerror or error}; choose another place with --out"


class RunDirectory:
    """One run on disk.

    Attributes
    ----------
    path : Path
        The directory, which is a recording as well.
    record : RunRecord
        Content of `run.json`.
    journal : Journal
        Always readable; appended to while the run is locked.
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
        """Create a new run directory.

        Parameters
        ----------
        path : Path
            Must not exist, or be empty.
        procedure : Procedure
            The procedure of the run.
        capabilities : Capabilities
            Capabilities of the connected drive.
        sealed : iterable of str
            Names of the drive options that no analysis may see: `run.json` has their hashes, the
            private directory has them in clear, so that the run can be resumed.

        Raises
        ------
        RecordingError
            Where `path` exists and is not empty.
        StorageError
            Where it cannot be created.
        """
        cls.refuse_occupied(path)
        options = procedure.drive.options
        hidden = {name: options[name] for name in options if name in set(sealed)}
        record = make_record(procedure, capabilities, provenance(_plugins_of(procedure)), hidden)
        run = cls(path.resolve(), record)
        secrets = run.private_directory / _OPTIONS
        try:
            _rename_leftover(run.private_directory)
            (run.path / _CAPTURES).mkdir(parents=True, exist_ok=True)
            run.private_directory.mkdir(exist_ok=True)
            run.private_directory.chmod(0o700)
        except OSError as error:
            raise StorageError(f"{run.path}: {_not_created(error)}") from error
        replace_file(secrets, (json.dumps(hidden, indent=1) + "\n").encode())
        write_json(run.path / _RECORD, record)
        return run

    @staticmethod
    def refuse_occupied(path: Path) -> None:
        """Raise `RecordingError` unless `path` is missing, or empty except for its lock: nothing is overwritten."""
        if path.exists() and (not path.is_dir() or any(file.name != LOCK_NAME for file in path.iterdir())):
            raise RecordingError(str(path), "", "exists and is not empty; nothing is overwritten: choose another")

    @staticmethod
    @contextmanager
    def claim(path: Path) -> Iterator[None]:
        """Create the directory for a new run and lock it for this process; nothing is ever overwritten.

        Raises
        ------
        RecordingError
            Where it cannot be created, is not empty, or another process has locked it.
        StorageError
            Where it cannot be locked; a newly created directory is then removed again.
        """
        if (path / LOCK_NAME).exists():  # possibly a running one: its lock decides
            with _flock(path):
                RunDirectory.refuse_occupied(path)
        RunDirectory.refuse_occupied(path)  # before writing into a foreign folder
        is_new = not path.exists()
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(str(path), "", _not_created(error)) from None
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
        """Whether the directory has captures, regardless of its journal."""
        return next((path / _CAPTURES).glob("*.parquet"), None) is not None

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open an existing run; raises `RecordingError` where there is none or `run.json` is damaged."""
        file = path / _RECORD
        if not file.is_file():
            require_recording(path)
            raise RecordingError(str(path), "", f"is a recording, not a run: it has no {_RECORD}; name a run")
        raw = _read_json(file)
        try:
            record = RunRecord.model_validate(raw)
        except ValidationError as error:
            problem = first_problem(error, RunRecord, raw)
            raise RecordingError(str(file), problem.field, problem.text) from None
        if hash_of(raw["procedure"]) != record.procedure_sha256:
            raise RecordingError(str(file), "procedure_sha256", "the procedure was changed after the run was created")
        return cls(path.resolve(), record)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock an existing run for this process, and be `at_work`; `RecordingError` where another process has it.

        The lock ends with the process, however that ends.
        """
        with _flock(self.path), self.at_work():
            yield

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Open the journal for appending and remove half-written files of a killed process; requires the lock."""
        with self.journal:
            for folder in (self.path, self.path / _CAPTURES, self.private_directory):
                remove_partial_files(folder)
            for folder in (self.path, self.path / "results"):
                remove_stale_staging(folder)
            yield

    def refuse_lost_journal(self) -> None:
        """Raise `RecordingError` where the journal lacks captures that were measured."""
        listed: set[str] = set()
        if (self.path / MANIFEST_NAME).is_file():
            listed = {segment.id for segment in read_manifest(self.path / MANIFEST_NAME).segments}
        lost = listed - self.completed().keys()
        captures = sum(1 for _ in (self.path / _CAPTURES).glob("*.parquet"))
        if lost or (captures and not self.journal.read()):
            problem = f"missing or cut: it lacks {max(len(lost), captures)} existing captures"
            raise RecordingError(str(self.journal.path), "", problem)

    def procedure(self) -> Procedure:
        """The procedure of the run, sealed options included; raises `RecordingError` where they are missing."""
        if not self.record.sealed:
            return self.record.procedure
        file = self.private_directory / _OPTIONS
        options = _read_json(file)
        if not isinstance(options, dict):
            raise RecordingError(str(file), "", "expected a JSON object")
        return unsealed(self.record, options, str(file))

    def completed(self) -> dict[str, Segment]:
        """The segments of the measured points, by point id, in order of the journal."""
        done = (entry.message for entry in self.journal.read())
        return {message.id: message.segment for message in done if isinstance(message, PointDone)}

    def appended(self) -> tuple[StagesAppended, ...]:
        """The stages appended to the procedure's, in order of the journal."""
        messages = (entry.message for entry in self.journal.read())
        return tuple(message for message in messages if isinstance(message, StagesAppended))

    def sufficed(self) -> set[int]:
        """Indices of the stages that need not measure the rest of their plan."""
        return {entry.message.index for entry in self.journal.read() if isinstance(entry.message, StageSufficed)}

    def ended(self) -> RunEnded | None:
        """The end of the run; None for an unfinished run, and after a kill."""
        return last_end(self.journal.read())

    def end_s(self) -> float:
        """Time of the experiment's clock: the end of the last capture [s]; 0 before the first one."""
        segments = self.completed().values()
        rate = self.record.capabilities.sampling_frequency_hz
        return max((segment.start_s + segment.samples / rate for segment in segments), default=0.0)

    def manifest(self) -> Manifest:
        """The manifest by the journal: the segments that it records as done, and nothing else.

        Raises `RecordingError` where a capture that the journal records as done is missing.
        """
        segments = tuple(self.completed().values())
        for segment in segments:
            file = capture_path(self.path, segment.id)
            if not file.is_file():
                raise RecordingError(str(file), "", f"missing, though {_JOURNAL} records it as done")
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
        """Write `recording.json`; raises `StorageError`, and the errors of `manifest`."""
        manifest = self.manifest()
        write_manifest(self.path, manifest)
        return manifest


def last_end(journal: Sequence[JournalRecord]) -> RunEnded | None:
    """The end of a run by its journal; None for an unfinished run, and after a kill."""
    for record in reversed(journal):
        if isinstance(record.message, RunEnded):
            return record.message
        if isinstance(record.message, RunStarted | StagesAppended):
            return None
    return None


@contextmanager
def _flock(path: Path) -> Iterator[None]:
    file = path / LOCK_NAME
    with ExitStack() as lock:
        try:
            descriptor = lock.enter_context(locked_file(file))
        except BlockingIOError:
            holder = file.read_text(encoding="ascii", errors="replace")[:32].strip()
            raise RecordingError(
                str(path), "", f"another fluxbench process ({holder}) is at work on this run"
            ) from None
        except OSError as error:
            raise StorageError(f"{file}: cannot be opened: {error.strerror or error}") from error
        with suppress(OSError):  # the holder's number is only information
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"pid {os.getpid()}\n".encode())
        yield


def _rename_leftover(private: Path) -> None:
    """Rename the private folder of a deleted run of this name; nothing is ever overwritten."""
    if not (private / _OPTIONS).exists():
        return
    numbered = (private.with_name(f"{private.name}.{k}") for k in count(1))
    private.rename(next(place for place in numbered if not place.exists()))


def _plugins_of(procedure: Procedure) -> list[PluginInfo]:
    used: set[tuple[str, str | None]] = {(PluginKind.DRIVES, procedure.drive.name)}
    for stage in parse_stages(procedure):
        used |= {(PluginKind.STAGES, stage.name), *((use.kind, use.name) for use in stage.uses())}
    return [info for kind in PluginKind for info in installed(kind) if {(kind, None), (kind, info.name)} & used]


def _read_json(file: Path) -> Any:
    try:
        return parse_json(read_bytes(file))
    except OSError as error:
        raise RecordingError(str(file), "", f"cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise RecordingError(str(file), "", f"broken JSON: {error}") from None
