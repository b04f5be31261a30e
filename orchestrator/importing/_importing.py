"""`fluxbench import`: measurement files and a mapping into a recording, whole or not at all."""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from orchestrator.config.time_constants import recording_notes
from orchestrator.importing._angles import check_fixed_angles
from orchestrator.importing._beside import Beside, open_joined, paired
from orchestrator.importing._findings import Finding, Findings
from orchestrator.importing._loading import MappingFile, read_mapping
from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._opening import check_file
from orchestrator.importing._placing import Placing
from orchestrator.importing._pwm import settings_of
from orchestrator.importing._segments import segment_of
from orchestrator.importing._source import Source
from orchestrator.importing._splitting import RawSegment, Splitter
from orchestrator.importing._timing import Clock
from orchestrator.importing._waveform_checks import WaveformChecks
from orchestrator.recording import SegmentWriter, open_recording, write_manifest
from orchestrator.recording._recording_checks import SoundRecording
from protocols import DriveRecord, InputError, Manifest, Motor, Segment, SegmentStage, StorageError, Strict


class ImportReport(Strict):
    """What `fluxbench import --json` prints."""

    recording: str
    """The recording's directory."""
    name: str
    segments: int
    samples: int
    sampling_frequency_hz: float
    rows: int
    """Total number of rows in the files."""
    dropped_rows: dict[str, int]
    """Number of rows that belong to no segment, by reason."""
    notes: tuple[str, ...]
    """Findings that do not prevent the import, one line each."""


def import_files(mapping: Path, files: Sequence[Path], out: Path) -> ImportReport:
    """Turn measurement files into a recording at `out`.

    One segment is in memory at a time where the file's format allows (CSV, Parquet, MATLAB 7.3). The recording
    appears at `out` when it is complete, and not before.

    Parameters
    ----------
    mapping : Path
        The mapping file, an `ImportMapping` in YAML.
    files : sequence of Path
        CSV, Parquet, MATLAB (.mat) or ASAM MDF (.mf4) files, in the order in which they were measured.
    out : Path
        A directory that is empty or not there.

    Raises
    ------
    InputError
        Where the mapping, a file or its content is invalid: one line that names file, column or key, and row.
    StorageError
        Where the recording cannot be written.
    """
    mappings = read_mapping(mapping)
    findings = Findings(mappings.common.accept)
    for one in (mappings.common, *(one for _, one in mappings.rules)):
        check_fixed_angles(one, mapping, findings)
    _check_files(files)
    mappings.check_all_used(mapping, files)
    pairs = paired(mappings, files)
    with appearing_whole(out) as partial:
        importer = _Import(mappings, findings, partial)
        for path, beside in pairs.items():
            importer.take(path, beside)
        manifest = importer.finish(mapping)
        check_readable(mapping, partial)
    return ImportReport(
        recording=str(out),
        name=manifest.name,
        segments=len(manifest.segments),
        samples=sum(segment.samples for segment in manifest.segments),
        sampling_frequency_hz=manifest.drive.sampling_frequency_hz,
        rows=importer.rows,
        dropped_rows={why: rows for why, rows in findings.dropped_rows.items() if rows},
        notes=(*mappings.readings, *findings.notes(), *recording_notes(manifest)),
    )


class _Import:
    """One import in progress: writes the segments of each file, and the manifest at the end."""

    def __init__(self, mappings: MappingFile, findings: Findings, directory: Path) -> None:
        self._mappings, self._findings, self._directory = mappings, findings, directory
        self._mapping = mapping = mappings.common
        self._splitter = Splitter(mapping)
        self._clock = Clock(mapping, findings)
        self._checks = WaveformChecks(mapping, findings)
        self._placing = Placing(mapping, findings)
        self._segments: list[Segment] = []

    def take(self, path: Path, beside: Sequence[Beside]) -> None:
        """Write the segments of one file and the files joined to it."""
        rule, mapping = self._mappings.of(path)
        source = open_joined(path, rule, mapping, beside, self._findings)
        self._check_units(path, mapping, source)
        self._placing.next_file()
        before = len(self._segments)
        for raw in self._splitter.raw_segments(path, mapping, iter(source.blocks)):
            self._take_segment(raw)
        if len(self._segments) == before:
            raise InputError(str(path), "", f"no segment in it; {self._left_over() or 'it holds no complete row'}")

    def finish(self, mapping_path: Path) -> Manifest:
        """Run the checks of the whole recording and write the manifest."""
        self._splitter.check_all_used(str(mapping_path))
        self._checks.conclude(str(mapping_path))
        if self._splitter.leftover.rows:
            self._findings.note("leftover", self._left_over())
            self._findings.dropped_rows["fits no entry of segments"] = self._splitter.leftover.rows
        common, without = (
            self._mappings.common,
            [rule for rule in self._mappings.common.segments if not rule.rotor_angle],
        )
        is_given = "rotor_angle" in common.model_fields_set or bool(self._mappings.rules)
        if not is_given and any(rule.stage is not SegmentStage.GATES_OFF for rule in without):
            self._findings.note("rotor_angle", "no rotor_angle in the mapping: 0 is assumed")
        earliest_s = min(0.0, *(segment.start_s for segment in self._segments)) if self._splitter.since_epoch else 0.0
        drive = self._mapping.drive
        manifest = Manifest(
            format="fluxbench-recording",
            version=1,
            name=self._mapping.name,
            created=self._mapping.created or datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            motor=Motor.model_validate(self._mapping.motor.model_dump()),
            drive=DriveRecord(sampling_frequency_hz=self._clock.rate_hz, **drive.model_dump()),
            segments=tuple(s.model_copy(update={"start_s": s.start_s - earliest_s}) for s in self._segments),
        )
        write_manifest(self._directory, manifest)
        return manifest

    @property
    def rows(self) -> int:
        """Number of rows in all files so far."""
        return self._splitter.rows

    def _take_segment(self, raw: RawSegment) -> None:
        for stretch in self._clock.stretches(raw):
            rate, parts = self._clock.rate_hz, stretch.parts()
            segment = segment_of(raw, parts[0], rate, self._findings)
            self._checks.judge(segment.waveforms)
            samples = len(segment.capture) if len(parts) == 1 else len(stretch.rows)
            segment_id, start_s = self._placing.place(raw, stretch, samples, rate)
            with SegmentWriter(self._directory, segment_id) as writer:
                writer.append(segment.capture.model_copy(update={"start_s": start_s}))
                rotor_angle_rad, written_rows = segment.rotor_angle_rad, len(segment.capture)
                for part in parts[1:]:
                    segment = segment_of(raw, part, rate, self._findings)
                    self._checks.judge(segment.waveforms)
                    writer.append(segment.capture.model_copy(update={"start_s": start_s + written_rows / rate}))
                    written_rows += len(segment.capture)
                written = writer.finish()
            rule = self._mapping.segments[raw.rule]
            self._segments.append(
                Segment(
                    id=segment_id,
                    stage=rule.stage,
                    start_s=written.start_s,
                    samples=written.samples,
                    rotor_angle_rad=rotor_angle_rad,
                    settings=settings_of(raw, rate),
                    sha256=written.sha256,
                )
            )

    def _check_units(self, path: Path, mapping: ImportMapping, source: Source) -> None:
        for column, labelled in mapping.units().items():
            stated = source.units.get(column) or labelled
            if stated != labelled:
                self._findings.doubt(
                    Finding.UNIT_IN_FILE, str(path), column, f"is in {stated} by the file, in {labelled} by the mapping"
                )

    def _left_over(self) -> str:
        left = self._splitter.leftover
        return f"{left.rows} rows fit no entry of segments and were left out (first: {left.first})" if left.rows else ""


@contextmanager
def appearing_whole(out: Path) -> Iterator[Path]:
    """A temporary directory that is renamed to `out` at the end, or removed after an exception."""
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(str(out), "", "exists already and is not an empty directory")
        partial = out.parent / f".{out.name}.{secrets.token_hex(4)}.partial"
        partial.mkdir(parents=True)
    except (OSError, ValueError) as error:
        raise _cannot_write(out, error) from None
    try:
        yield partial
        try:
            partial.replace(out)
        except OSError as error:
            raise _cannot_write(out, error) from None
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def check_readable(mapping: Path, directory: Path) -> None:
    """Raise `InputError` where the other commands could not read the recording."""
    try:
        SoundRecording(open_recording(directory)).read_through()
    except InputError as error:
        raise InputError(str(mapping), error.field, f"no command would read the recording: {error.problem}") from None


def _check_files(files: Sequence[Path]) -> None:
    if not files:
        raise InputError("", "", "no file to import")
    for index, path in enumerate(files):
        check_file(path)
        if path in files[:index]:
            raise InputError(str(path), "", "given twice")


def _cannot_write(out: Path, error: Exception) -> StorageError:
    return StorageError(f"{out}: cannot be written: {getattr(error, 'strerror', None) or error}")
