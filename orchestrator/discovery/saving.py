"""Files of a discovery: ``results/discovery.json``, its picture, and the effect plugin."""

from __future__ import annotations

import re
from pathlib import Path

from orchestrator.discovery.discover import Learned
from orchestrator.discovery.pictures import curve_picture
from orchestrator.discovery.report import Discovery
from orchestrator.recording import replace_file
from protocols import InputError, RecordingError, StorageError

REPORT_NAME = "discovery.json"
PICTURE_NAME = "discovery.svg"
_NAME = re.compile(r"[a-z][a-z0-9_]*")


def require_name(name: str, target: Path | None) -> str:
    """The name of an effect to be written; raises `InputError` where it cannot be one, or its file not be written."""
    if target is not None and target.exists():
        raise InputError(str(target), "", "exists already: give another name, or move it away")
    if target is not None and target.suffix != ".py":
        raise InputError(str(target), "", "an effect is written to a Python file: its name ends in .py")
    if _NAME.fullmatch(name) is None:
        raise InputError(name, "", "no name for an effect: expected lower-case letters, digits and underscores")
    return name


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
    replace_file(target, found.text.encode())
