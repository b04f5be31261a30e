"""The page's choices: procedures, motors and drives; and the folder of a run."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from orchestrator.config import load_motor, load_procedure
from orchestrator.formatting.sentences import shown
from orchestrator.registry.plugins import PluginKind, installed
from orchestrator.validation.plain_files import read_text
from protocols import FluxbenchError, InputError, shipped_procedures

RUNS = "runs"
REPORT = "report.html"


def choices(folder: Path) -> dict[str, Any]:
    """All choices for the page but the runs, with each file's error beside its name."""
    return {
        "folder": shown(str(folder)),
        "procedures": [*_procedures(folder)],
        "motors": [*_motors(folder)],
        "drives": sorted(info.name for info in installed(PluginKind.DRIVES)),
    }


def procedure_word(folder: Path, name: str) -> str:
    """Argument of `run` for a listed procedure; raises `InputError` for others."""
    if name in shipped_procedures():
        return name
    return _file_word(folder, name, "procedure", _has_stages)


def motor_word(folder: Path, name: str) -> str:
    """Argument of ``--motor`` for a listed motor file; raises `InputError` for others."""
    return _file_word(folder, name, "motor", lambda text: not _has_stages(text))


def run_folder(folder: Path, name: str) -> Path:
    """Folder of a listed run; raises `InputError` for others."""
    place = folder / RUNS / name
    try:
        if name not in ("", ".", "..") and Path(name).name == name and (place / "run.json").is_file():
            return place
    except OSError:  # a name that is too long for the file system
        pass
    raise InputError("runs", "", "no such run")


def _procedures(folder: Path) -> Iterator[dict[str, str]]:
    for name, text in _files(folder):
        if _has_stages(text):
            yield _choice(name, str(folder / name), lambda word: load_procedure(word).summary)
    # The page preselects the first.
    for name in sorted(shipped_procedures(), key=lambda name: name != "demo"):
        yield _choice(name, name, lambda word: load_procedure(word).summary)


def _motors(folder: Path) -> Iterator[dict[str, str]]:
    for name, text in _files(folder):
        if not _has_stages(text) and re.search(r"^motor:", text, re.MULTILINE):
            yield _choice(name, str(folder / name), lambda word: load_motor(Path(word)).name)


def _choice(name: str, word: str, summary: Callable[[str], str | None]) -> dict[str, str]:
    try:
        return {"name": name, "summary": shown(summary(word) or ""), "problem": ""}
    except FluxbenchError as error:
        return {"name": name, "summary": "", "problem": shown(str(error))}


def _files(folder: Path, max_bytes: int = 1 << 20) -> Iterator[tuple[str, str]]:
    """Name and text of each YAML file in the folder and its subfolders, except the runs'."""
    for file in sorted([*folder.glob("*.y*ml"), *folder.glob("[!.]*/*.y*ml")]):
        name = file.relative_to(folder)
        if name.parts[0] == RUNS or not file.is_file() or file.stat().st_size > max_bytes:
            continue
        try:
            yield str(name), read_text(file, max_bytes)
        except (OSError, UnicodeDecodeError):
            continue


def _file_word(folder: Path, name: str, what: str, is_one: Any) -> str:
    if not any(known == name and is_one(text) for known, text in _files(folder)):
        raise InputError(what, "", f"none of this folder's has the name {shown(repr(name))}")
    return f"./{name}"


def _has_stages(text: str) -> bool:
    return re.search(r"^stages:", text, re.MULTILINE) is not None
