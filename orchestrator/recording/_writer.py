"""Writing of one segment during its measurement: validated, encoded, hashed, and durable before it gets its name."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from orchestrator.operating_system.files import replace, sync_folder
from orchestrator.recording._columns import columns_of, first_non_finite
from orchestrator.recording._files import capture_path, partial_path, storage_error
from protocols import Capture, DriveFault, FaultCause, RealArray

ROWS_PER_GROUP = 1 << 16
"""Rows of a row group, the part that a writer keeps in memory."""


@dataclass(frozen=True)
class WrittenSegment:
    """A written segment: the manifest's `start_s`, `samples` and `sha256`."""

    start_s: float
    samples: int
    sha256: str


class SegmentWriter:
    """Writes one segment's captures to ``captures/<segment_id>.parquet``; a context manager.

    The file appears under its name in `finish` and not before; left without `finish`, or by an
    exception, the block leaves nothing behind. A segment of the same id from before is replaced.
    Columns are zstd level 1 over byte-stream-split values without dictionaries: a quarter of the
    time of pyarrow's defaults, and smaller on noisy waveforms.

    Raises
    ------
    StorageError
        Where the disk is full or the folder gone.
    DriveFault
        With cause ``wrong_data`` where the captures are not finite, not contiguous in time, or
        change their sampling frequency or columns underway.
    """

    def __init__(self, directory: Path, segment_id: str) -> None:
        self._id = segment_id
        self._path = capture_path(directory, segment_id)
        self._partial = partial_path(self._path)
        self._file: _HashingFile | None = None
        self._parquet: Any = None
        self._start_s = 0.0
        self._rate = 0.0
        self._samples = 0
        self._pending: dict[str, RealArray] = {}
        self._fill = 0

    @staticmethod
    def warm_up() -> None:
        """Import the encoder: that takes seconds on a busy machine, during which no drive may be energised."""
        import pyarrow.parquet  # noqa: F401 - the import alone is wanted

    def __enter__(self) -> Self:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = _HashingFile(self._partial)
        except OSError as error:
            raise storage_error(self._path, error) from error
        return self

    @property
    def samples(self) -> int:
        """Number of samples so far."""
        return self._samples

    def append(self, capture: Capture) -> None:
        """Add the next captured block; the arrays are copied, the caller may use them again."""
        if self._parquet is None:
            self._begin(capture)
        columns = columns_of(capture)
        self._check_continues(capture, columns)
        done = 0
        while done < len(capture):
            done += self._take(columns, done, len(capture) - done)
            if self._fill == ROWS_PER_GROUP:
                self._flush()

    def finish(self) -> WrittenSegment:
        """Make the file durable and give it its name."""
        if self._file is None or self._samples == 0:
            raise self._wrong_data("no sample arrived")
        self._flush()
        try:
            self._parquet.close()
            self._file.sync()
            self._file.close()
            replace(self._partial, self._path)
            sync_folder(self._path.parent)
        except OSError as error:
            raise storage_error(self._path, error) from error
        return WrittenSegment(self._start_s, self._samples, self._file.hash.hexdigest())

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is None or self._file.closed:
            return
        with suppress(OSError):  # where nothing can be written, nothing can be removed either
            self._file.close()
            self._partial.unlink(missing_ok=True)
        if self._parquet is not None:
            self._parquet.close()

    def _begin(self, capture: Capture) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        if not (math.isfinite(capture.start_s) and 0 < capture.sampling_frequency_hz < math.inf):
            raise self._wrong_data(f"starts at {capture.start_s} s, sampled at {capture.sampling_frequency_hz} Hz")
        self._start_s, self._rate = capture.start_s, capture.sampling_frequency_hz
        self._pending = {
            name: np.empty(ROWS_PER_GROUP, dtype=column.dtype) for name, column in columns_of(capture).items()
        }
        schema = pa.schema([pa.field(name, pa.from_numpy_dtype(c.dtype), False) for name, c in self._pending.items()])
        try:
            self._parquet = pq.ParquetWriter(
                pa.PythonFile(self._file, mode="w"),
                schema,
                compression="zstd",
                compression_level=1,
                use_dictionary=False,
                use_byte_stream_split=True,
                write_statistics=False,
            )
        except OSError as error:
            raise storage_error(self._path, error) from error

    def _check_continues(self, capture: Capture, columns: Mapping[str, RealArray]) -> None:
        if columns.keys() != self._pending.keys():
            raise self._wrong_data(f"columns change from {', '.join(self._pending)} to {', '.join(columns)}")
        if capture.sampling_frequency_hz != self._rate:
            raise self._wrong_data(
                f"sampling frequency changes from {self._rate} to {capture.sampling_frequency_hz} Hz"
            )
        expected = self._start_s + self._samples / self._rate
        if not abs(capture.start_s - expected) <= 0.5 / self._rate:
            raise self._wrong_data(f"a block starts at {capture.start_s:.6f} s, expected at {expected:.6f} s")

    def _take(self, columns: Mapping[str, RealArray], start: int, rows: int) -> int:
        rows = min(rows, ROWS_PER_GROUP - self._fill)
        for name, column in columns.items():
            into = self._pending[name][self._fill : self._fill + rows]
            np.copyto(into, column[start : start + rows], casting="same_kind")
            bad = first_non_finite(into)
            if bad is not None:
                raise self._wrong_data(f"{name} is {into[bad]} at sample {self._samples + bad}")
        self._fill += rows
        self._samples += rows
        return rows

    def _flush(self) -> None:
        import pyarrow as pa

        if self._fill == 0:
            return
        arrays = [pa.array(column[: self._fill]) for column in self._pending.values()]
        try:
            self._parquet.write_batch(pa.record_batch(arrays, schema=self._parquet.schema), ROWS_PER_GROUP)
        except OSError as error:
            raise storage_error(self._path, error) from error
        self._fill = 0

    def _wrong_data(self, detail: str) -> DriveFault:
        return DriveFault(FaultCause.WRONG_DATA, f"segment {self._id}: {detail}")


class _HashingFile:
    """A file that hashes its content, as pyarrow needs it; once closed it ignores data: pyarrow writes a footer."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        self._position = 0
        self.hash = hashlib.sha256()

    @property
    def closed(self) -> bool:
        return self._file.closed

    def write(self, data: Any) -> int:
        rest = memoryview(data)
        if not self.closed:
            self.hash.update(rest)
            while rest.nbytes:
                rest = rest[self._file.write(rest) :]
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Nothing is buffered here."""

    def sync(self) -> None:
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()
