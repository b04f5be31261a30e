"""Files of a discovery: ``results/discovery.json``, its picture, and the effect plugin."""

from __future__ import annotations

import keyword
import os
import re
import tempfile
from collections.abc import Collection
from pathlib import Path

from orchestrator.discovery.discover import Learned
from orchestrator.discovery.pictures import curve_picture
from orchestrator.discovery.report import Discovery
from orchestrator.recording import replace_file
from protocols import InputError, RecordingError, StorageError

REPORT_NAME = "discovery.json"
PICTURE_NAME = "discovery.svg"
MAX_NAME_LENGTH: int = 80
"""Characters of an effect's name, as of a new plugin's."""
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_EXISTS = "exists already: give another name, or move it away"


def require_name(name: str, target: Path | None, taken: Collection[str] = ()) -> str:
    """The name of an effect to be written; raises `InputError` where it cannot be one, or its file not be written.

    Parameters
    ----------
    taken : collection of str
        Names of the library's effects.
    """
    if target is not None:
        _require_writable(target)
    if len(name) > MAX_NAME_LENGTH:
        raise InputError(f"{name[:12]}...", "", f"no name for an effect: it has more than {MAX_NAME_LENGTH} letters")
    if _NAME.fullmatch(name) is None or keyword.iskeyword(name):
        expected = "expected lower-case letters, digits and underscores, and no keyword of Python"
        raise InputError(name, "", f"no name for an effect: {expected}")
    if name in taken:
        raise InputError(name, "", "an effect of that name exists already: choose another")
    return name


def _require_writable(target: Path) -> None:
    """Raise `InputError` where no file can be made there: known before minutes of search."""
    if target.suffix != ".py":
        raise InputError(str(target), "", "an effect is written to a Python file: its name ends in .py")
    try:
        target.lstat()
    except (FileNotFoundError, NotADirectoryError):
        folder = next(folder for folder in (target.parent, *target.absolute().parents) if os.path.lexists(folder))
        try:  # permissions alone do not tell: root has them on a file system that is read only
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            raise InputError(str(target), "", f"cannot be written: {folder} is no folder to write to") from None
    except OSError as error:
        raise InputError(str(target), "", f"cannot be written: {error.strerror or error}") from error
    else:
        raise InputError(str(target), "", _EXISTS)


def save_discovery(directory: Path, found: Learned) -> None:
    """Replace the report and its picture in ``results/``; raises `StorageError`."""
    results = directory / "results"
    try:
        results.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{results}: cannot be made: {error.strerror or error}") from error
    replace_file(results / REPORT_NAME, found.report.model_dump_json(indent=2).encode())
    picture = curve_picture(found.report)
    if picture is not None:
        replace_file(results / PICTURE_NAME, picture)
    else:
        (results / PICTURE_NAME).unlink(missing_ok=True)


def load_discovery(directory: Path) -> Discovery | None:
    """The report in ``results/``; None where there is none. Raises `RecordingError` where it cannot be read."""
    file = directory / "results" / REPORT_NAME
    if not file.is_file():
        return None
    try:
        return Discovery.model_validate_json(file.read_bytes())
    except (OSError, ValueError) as error:
        raise RecordingError(str(file), "", "cannot be read: `fluxbench discover` writes it anew") from error


def write_law(target: Path, found: Learned) -> None:
    """Write the effects of a discovery to a file; none where there is no law. Raises `StorageError`."""
    if not found.text:
        return
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{target}: cannot be written: {error.strerror or error}") from error
    if os.path.lexists(target):  # made by another since this began
        raise StorageError(f"{target}: {_EXISTS}")
    replace_file(target, found.text.encode())
