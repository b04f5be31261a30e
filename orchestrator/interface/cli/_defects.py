"""Exceptions that nothing expected: one line names the plugin, the file and the line; the traceback goes to a file."""

from __future__ import annotations

import sys
import sysconfig
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import Any

TRACEBACKS = "traceback.log"
"""File of a run's directory to which tracebacks are appended."""


def describe_defect(error: BaseException) -> tuple[str, bool]:
    """An exception with its place as one line, and whether a plugin raised it."""
    what = " ".join(f"{type(error).__name__}: {error}".split()) if str(error) else type(error).__name__
    plugin, place = _origin(error)
    if plugin is not None:
        return f"{plugin}: {what}{place}", True
    return f"a defect of fluxbench, please report it: {what}{place}", False


def place_of(error: BaseException) -> str:
    """File and line of a plugin's code, or else of ours, that raised an exception: `` (mine.py, line 12)``."""
    return _origin(error)[1]


def _origin(error: BaseException) -> tuple[str | None, str]:
    """Kind and name of the plugin that raised an exception, if one did, and the place.

    The plugin is the innermost one with a method in the traceback; the place is the innermost line of its own code.
    """
    frames = list(traceback.walk_tb(error.__traceback__))
    for k in reversed(range(len(frames))):
        plugin = frames[k][0].f_locals.get("self")
        kind = _kind_of(plugin)
        if kind is None:
            continue
        home = getattr(sys.modules.get(type(plugin).__module__), "__file__", None)
        own = [(frame, line) for frame, line in frames[k:] if home is not None and _is_below(frame, Path(home))]
        frame, line = (own or [frames[k]])[-1]
        return f"{kind}: {getattr(plugin, 'name', '')}", f" ({frame.f_code.co_filename}, line {line})"
    here = [(frame, line) for frame, line in frames if not _is_library(frame.f_code.co_filename)]
    return None, f" ({here[-1][0].f_code.co_filename}, line {here[-1][1]})" if here else ""


def keep_traceback(error: BaseException, run: Path | None) -> str:
    """Append the traceback to a run's file, or write it to a temporary one; returns where it is, as part of a line."""
    moment = datetime.now(UTC).isoformat(timespec="seconds")
    text = f"{moment} {' '.join(sys.argv)}\n{''.join(traceback.format_exception(error))}\n"
    content = text.encode("utf-8", "backslashreplace")
    if run is not None:
        try:
            with (run / TRACEBACKS).open("ab") as file:
                file.write(content)
            return f"; the traceback is in {run / TRACEBACKS}"
        except OSError:
            pass
    try:
        with tempfile.NamedTemporaryFile(prefix="fluxbench-", suffix=f"-{TRACEBACKS}", delete=False) as kept:
            kept.write(content)
        return f"; the traceback is in {kept.name}"
    except OSError as failure:
        return f"; the traceback could not be written: {failure.strerror or failure}"


def run_among(arguments: Sequence[str]) -> Path | None:
    """The first argument that is a run's directory."""
    return next((Path(word) for word in arguments if "\0" not in word and _is_run(Path(word))), None)


def _is_run(path: Path) -> bool:
    try:
        return (path / "run.json").is_file()
    except (OSError, ValueError):  # words that are no path
        return False


def _kind_of(instance: Any) -> str | None:
    """Kind of a plugin's instance, by the entry points or the module's name; None for other objects."""
    from orchestrator.registry.plugins import PluginKind, installed

    kind = type(instance)
    if kind.__module__.startswith("effects_of_"):  # as `load_effects_file` names them
        return str(PluginKind.EFFECTS.value)
    classes = {f"{base.__module__}:{base.__qualname__}" for base in kind.__mro__}
    name = getattr(kind, "name", None)
    return next(_kinds(installed, list(PluginKind), classes, name), None)


def _kinds(installed: Any, kinds: Sequence[Any], classes: set[str], name: object) -> Iterator[str]:
    for kind in kinds:
        for info in installed(kind):
            module, _, attribute = info.module.partition(":")
            found = getattr(sys.modules.get(module), attribute, None)
            if found is not None and info.name == name and f"{found.__module__}:{found.__qualname__}" in classes:
                yield str(kind.value)


def _is_below(frame: FrameType, home: Path) -> bool:
    """Whether a frame's code is in a module's file, or in the package of which that is the `__init__`."""
    file = Path(frame.f_code.co_filename)
    return file == home or (home.name == "__init__.py" and home.parent in file.parents)


def _is_library(file: str) -> bool:
    stdlib = sysconfig.get_path("stdlib")
    return "site-packages" in file or file.startswith(("<", stdlib))
