"""Reading of recordings: all files are checked on opening; waveforms are read by segment, completely or not at all."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from orchestrator.recording._columns import (
    BUS,
    CURRENT,
    PHASE_CURRENT,
    REQUIRED,
    TEMPERATURE,
    THETA,
    VOLTAGE,
    first_non_finite,
)
from orchestrator.recording._files import capture_path
from orchestrator.recording._json import MANIFEST_NAME, read_manifest
from orchestrator.recording._places import require_recording
from orchestrator.validation.memory import require_memory
from protocols import Capture, Manifest, RealArray, RecordingError, Segment, SegmentStage


class Recording:
    """A recording on disk (a `protocols.RecordingReader`).

    Attributes
    ----------
    path : Path
        The directory.
    manifest : Manifest
        The validated manifest.
    """

    def __init__(self, path: Path, manifest: Manifest) -> None:
        self.path = path
        self._manifest = manifest
        self._in_order_of_time = tuple(sorted(manifest.segments, key=lambda segment: segment.start_s))

    @property
    def manifest(self) -> Manifest:
        return self._manifest

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        """The segments of these stages (of all without arguments), in order of time."""
        if not stages:
            return self._in_order_of_time
        return tuple(segment for segment in self._in_order_of_time if segment.stage in stages)

    def limited_to(self, ids: Collection[str]) -> Self:
        """The same recording with these segments alone; raises `RecordingError` where it has no such segment."""
        known = {segment.id for segment in self.segments()}
        unknown = sorted(set(ids) - known)
        if unknown:
            raise RecordingError(str(self.path), unknown[0], "no such segment")
        kept = tuple(segment for segment in self.manifest.segments if segment.id in set(ids))
        return type(self)(self.path, self.manifest.model_copy(update={"segments": kept}))

    def load(self, segment: Segment) -> Capture:
        """The segment's waveforms.

        The file is read once: the checksum covers the decoded bytes.

        Raises
        ------
        RecordingError
            Where the file is missing or truncated, or its checksum, columns, types, row count or
            a sample are not what they should be.
        """
        path = capture_path(self.path, segment.id)
        columns = _decode(path, _read(path, segment), segment)
        # Columns are released as they become vectors: that halves the memory of long segments.
        phases = [columns.pop(name) for name in PHASE_CURRENT if name in columns]
        return Capture(
            start_s=segment.start_s,
            sampling_frequency_hz=self._manifest.drive.sampling_frequency_hz,
            i_ab=_stacked_columns([columns.pop(name) for name in CURRENT]),
            v_ab=_stacked_columns([columns.pop(name) for name in VOLTAGE]),
            v_dc=columns[BUS],
            i_abc=_stacked_columns(phases) if len(phases) == len(PHASE_CURRENT) else None,
            temperature_c=columns.get(TEMPERATURE),
            theta_rad=columns.get(THETA),
        )


_CHANGED = "the file was changed since it was measured; restore it from a copy, or measure again"


def _read(path: Path, segment: Segment) -> bytes:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RecordingError(str(path), "", f"cannot be read: {error.strerror or error}") from None
    if segment.sha256 is not None and hashlib.sha256(content).hexdigest() != segment.sha256:
        raise RecordingError(str(path), "sha256", f"differs from the one in {MANIFEST_NAME}: {_CHANGED}")
    return content


def open_recording(path: Path, *, make_manifest: Callable[[Path], object] | None = None) -> Recording:
    """Open the recording in the directory `path` (its `recording.json` may be named instead).

    Parameters
    ----------
    make_manifest : callable, optional
        Called with the directory where it is a run that was cut short, so that a journal but no
        manifest is there; it writes the manifest.

    Raises
    ------
    RecordingError
        Where the manifest is missing or wrong, or a capture file is missing, cannot be read, or
        does not have the columns and rows that it should.
    """
    directory = path.parent if path.name == MANIFEST_NAME else path
    require_recording(directory)
    is_run = all((directory / name).is_file() for name in ("journal.jsonl", "run.json"))
    if is_run and not (directory / MANIFEST_NAME).exists():
        if make_manifest is None:
            raise RecordingError(
                str(directory),
                MANIFEST_NAME,
                "not written yet, the run was cut short: `fluxbench resume` or `fluxbench estimate` makes it",
            )
        make_manifest(directory)
    manifest = read_manifest(directory / MANIFEST_NAME)
    for segment in manifest.segments:
        _check_file(capture_path(directory, segment.id), segment)
    return Recording(directory, manifest)


def _check_file(path: Path, segment: Segment) -> None:
    if not path.is_file():
        raise RecordingError(str(path), "", f"missing, though {MANIFEST_NAME} lists segment {segment.id!r}")
    with _Parquet(path, str(path)) as parquet:
        names = _check_shape(path, parquet.schema_arrow, parquet.metadata.num_rows, segment)
        row_bytes = sum(parquet.schema_arrow.field(name).type.bit_width // 8 for name in names)
    require_memory(path, max(segment.samples * row_bytes, path.stat().st_size), f"{segment.samples} rows")


def _decode(path: Path, content: bytes, segment: Segment) -> dict[str, RealArray]:
    import pyarrow as pa

    with _Parquet(path, pa.BufferReader(content)) as parquet:
        names = _check_shape(path, parquet.schema_arrow, parquet.metadata.num_rows, segment)
        # Two threads gain nothing at these sizes.
        table = parquet.read(columns=names, use_threads=False)
        if table.num_rows != segment.samples:
            raise RecordingError(str(path), "rows", f"{table.num_rows} can be read, {segment.samples} are expected")
        return {name: _column(path, name, table.column(name)) for name in names}


class _Parquet:
    """A Parquet file, open for a with-block; errors of pyarrow in it become a `RecordingError`."""

    def __init__(self, path: Path, source: Any) -> None:
        self._path, self._source = path, source
        self._file: Any = None

    def __enter__(self) -> Any:
        import pyarrow.parquet as pq

        try:
            self._file = pq.ParquetFile(self._source)
        except Exception as error:
            raise self._error_for(error) from None
        return self._file

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._file.close()
        if isinstance(error, Exception) and not isinstance(error, RecordingError):
            raise self._error_for(error) from None

    def _error_for(self, error: Exception) -> RecordingError:
        if isinstance(error, OSError) and error.errno:
            return RecordingError(str(self._path), "", f"cannot be read: {os.strerror(error.errno)}")
        # pyarrow has no common base for errors of a damaged file (ArrowException, OSError, ValueError, ...).
        reason = str(error).partition("\n")[0] or type(error).__name__
        return RecordingError(
            str(self._path),
            "",
            f"not a readable Parquet file: {reason}; was it cut while copying? Copy the recording again",
        )


def _check_shape(path: Path, schema: Any, rows: int, segment: Segment) -> list[str]:
    import pyarrow as pa

    names: list[str] = schema.names
    for name in REQUIRED:
        if name not in names:
            raise RecordingError(str(path), name, f"column missing; the file has {', '.join(names)}"[:200])
    wanted = [*REQUIRED, *(name for name in (*PHASE_CURRENT, TEMPERATURE, THETA) if name in names)]
    for name in wanted:
        if names.count(name) > 1:
            raise RecordingError(str(path), name, "two columns have this name")
        if schema.field(name).type not in (pa.float32(), pa.float64()):
            raise RecordingError(str(path), name, f"expected float32 or float64, got {schema.field(name).type}")
    if rows != segment.samples:
        raise RecordingError(str(path), "rows", f"the file has {rows}, {MANIFEST_NAME} says {segment.samples} samples")
    return wanted


def _column(path: Path, name: str, chunked: Any) -> RealArray:
    if chunked.null_count:
        raise RecordingError(str(path), name, f"{chunked.null_count} samples are null")
    column = _values(chunked)
    bad = first_non_finite(column)
    if bad is not None:
        raise RecordingError(str(path), name, f"sample {bad} is {column[bad]}")
    return column


def _values(chunked: Any) -> RealArray:
    """The samples without a copy; pyarrow's own conversion imports pandas first."""
    kind = np.dtype(chunked.type.to_pandas_dtype())
    chunks = [
        np.frombuffer(c.buffers()[1], dtype=kind, count=len(c), offset=c.offset * kind.itemsize) for c in chunked.chunks
    ]
    return chunks[0] if len(chunks) == 1 else np.concatenate(chunks)


def _stacked_columns(columns: Sequence[RealArray]) -> RealArray:
    out = np.empty((columns[0].size, len(columns)), dtype=np.result_type(*columns))
    for axis, column in enumerate(columns):
        out[:, axis] = column
    return out
