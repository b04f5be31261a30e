"""Whether a path is the directory of a run or recording; an error says what it is instead, and how to find a run."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from orchestrator.recording._json import MANIFEST_NAME
from protocols import RecordingError

RUN_FILE = "run.json"
"""File that makes a recording a run."""
_MAX_DEPTH = 2
"""Folders between a run and one of its files."""
_EXPECTED = "expected the directory of a run or recording"
_LIST = "`fluxbench runs` lists the runs"


def has_recording(path: Path) -> bool:
    """Whether a directory is a run or a recording."""
    try:
        return any((path / name).exists() for name in (RUN_FILE, MANIFEST_NAME))
    except OSError:  # a name that cannot be one, such as a very long one
        return False


def require_recording(path: Path) -> None:
    """Raise `RecordingError` where a path is not the directory of a run or recording."""
    if not has_recording(path):
        raise RecordingError(str(path), "", _what_it_is(path))


def _what_it_is(path: Path) -> str:
    """What a path is instead of a run, and what to do."""
    home = next((folder for folder in path.parents[:_MAX_DEPTH] if has_recording(folder)), None)
    if not path.exists():
        return f"no such directory; {_suggestion(path)}" if home is None else f"no such file in {home}"
    kind = "folder" if path.is_dir() else "file"
    if home is not None:
        return f"is a {kind} of the run or recording {home}; give that directory instead"
    if kind == "file":
        return f"is a file; {_EXPECTED}: {_LIST}, `fluxbench import` makes a recording of a log"
    if any(path.glob(f"*/{RUN_FILE}")):
        return f"a folder of runs, not a run; `fluxbench runs --folder {path}` lists them"
    return f"neither a run nor a recording: it has no {RUN_FILE} and no {MANIFEST_NAME}; {_LIST}"


def _suggestion(path: Path) -> str:
    """The run of the most similar name beside a missing one, or in ``runs``; else how to find one."""
    near = [folder for parent in (path.parent, Path("runs")) for folder in parent.glob("*") if has_recording(folder)]
    names = {folder.name: folder for folder in reversed(near)}
    close = get_close_matches(path.name, names, 1)
    return f"did you mean {names[close[0]]}?" if close else f"{_EXPECTED}: {_LIST}"
