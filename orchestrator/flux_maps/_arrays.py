"""Named arrays from .npz and .mat files, without their meaning."""

from __future__ import annotations

import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.importing import inflated_size
from orchestrator.validation.memory import require_memory
from protocols import InputError

_DAMAGE = (
    ArithmeticError, AttributeError, EOFError, LookupError, MemoryError, RuntimeError, SyntaxError, TypeError,
    ValueError, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""Errors of numpy's and scipy's readers for damaged files."""


def npz_arrays(path: Path) -> dict[str, Any]:
    """The arrays of an .npz file; nothing is unpickled. Raises `InputError`, or OSError."""
    try:
        # numpy does not close a file that it opened itself and cannot read.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            require_memory(path, sum(member.file_size for member in file.zip.infolist()), "its arrays")
            return {name: file[name] for name in file.files}
    except _DAMAGE as error:
        raise InputError(str(path), "", f"not an .npz file of plain arrays: {first_line(error)}") from None


def mat_arrays(path: Path) -> dict[str, Any]:
    """The variables of a .mat file, structs as dictionaries. Raises `InputError`, or OSError."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        require_memory(path, inflated_size(path), "its variables")
        with path.open("rb") as opened:
            stream: Any = opened  # the published stubs of loadmat know paths only
            content: dict[str, Any] = loadmat(stream, simplify_cells=True)
    except NotImplementedError:  # scipy's error for HDF5
        raise InputError(str(path), "", "a MATLAB 7.3 file; save it with -v7") from None
    except (*_DAMAGE, MatReadError) as error:
        raise InputError(str(path), "", f"not a MATLAB file: {first_line(error)}") from None
    return content


READERS = {".npz": npz_arrays, ".mat": mat_arrays}
"""The reader of each kind of file."""


def first_line(error: Exception) -> str:
    """The first line of an error's message."""
    return (str(error).splitlines() or [type(error).__name__])[0]
