"""Which reader a file belongs to, told by its name's ending."""

from __future__ import annotations

from pathlib import Path

from orchestrator.importing._columnar import open_csv, open_parquet
from orchestrator.importing._mapping import ImportMapping
from orchestrator.importing._matlab import open_matlab
from orchestrator.importing._mf4 import open_mf4
from orchestrator.importing._source import Source, Wanted
from protocols import InputError

_CSV = (".csv", ".tsv", ".txt")
_PARQUET = (".parquet", ".pq")
_MATLAB = (".mat",)
_MDF = (".mf4", ".mdf")


def open_source(path: Path, mapping: ImportMapping) -> Source:
    """Open a measurement file for the columns of a mapping; raises `InputError`."""
    wanted = Wanted(tuple(mapping.number_columns()), mapping.segment_column)
    ending = path.suffix.lower()
    if ending in _CSV:
        return open_csv(path, wanted, mapping.csv)
    if ending in _PARQUET:
        return open_parquet(path, wanted)
    if ending in _MATLAB:
        return open_matlab(path, wanted)
    if ending in _MDF:
        return open_mf4(path, wanted)
    known = ", ".join((*_CSV, *_PARQUET, *_MATLAB, *_MDF))
    raise InputError(str(path), "", f"unknown kind of file; known: {known}")


def check_file(path: Path) -> None:
    """Raise `InputError` where `path` is no file that can be read."""
    try:
        if not path.is_file():
            raise InputError(str(path), "", "no such file")
        with path.open("rb"):
            pass
    except (OSError, ValueError) as error:
        raise InputError(repr(str(path)), "", f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
