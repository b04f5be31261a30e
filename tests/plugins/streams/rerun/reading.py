"""Reads a ``view.rrd`` back, and runs the viewer's receiving end as a process of its own."""

from __future__ import annotations

import subprocess
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
from rerun.chunk import RrdReader

from plugins.streams.rerun._live import HOST, wait_for_viewer
from plugins.streams.rerun._tape import executable


def rows(file: Path, content: str) -> list[dict[str, Any]]:
    """All rows of an entity as dictionaries of column and value."""
    found: list[dict[str, Any]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a torn file has no footer is what some tests are about
        for chunk in RrdReader(file).stream().filter(content=content):
            found += pa.Table.from_batches([chunk.to_record_batch()]).to_pylist()
    return found


def entities(file: Path) -> Counter[str]:
    """How many rows with a time each entity has; none of a file that is begun and has no recording in it yet."""
    found: Counter[str] = Counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reader = RrdReader(file)
        for chunk in reader.stream() if reader.recordings() else ():
            found[chunk.entity_path] += 0 if chunk.is_static else chunk.num_rows
    return found


def arrived(file: Path) -> Counter[str]:
    """How many rows with a time each entity has in a file that another process is writing; none in the midst of one."""
    try:
        return entities(file)
    except RuntimeError as error:  # rerun's own kind for a frame of which the end is not there yet
        if "Failed to decode frame" not in str(error):
            raise
        return Counter()


@contextmanager
def receiver(port: int, file: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A process that takes what is sent to a viewer and writes it into a file."""
    words = [executable(), "--bind", HOST, "--port", str(port), "--save", str(file)]
    process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        assert wait_for_viewer(port, 20.0), "the receiving end does not start"
        yield process
    finally:
        process.kill()
        process.wait()
