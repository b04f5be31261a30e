"""One command from its arguments to an exit code; an error becomes one line on stderr."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import typer

from orchestrator.interface.cli._app import app

COMPLETING = "_FLUXBENCH_COMPLETE"
"""Environment variable that a shell sets to request completions."""
WRONG_PLACES = {
    errno.EISDIR, errno.ENOTDIR, errno.ENOENT, errno.EEXIST, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG,
    errno.ELOOP,
}  # fmt: skip
"""Errors of the system about a place that the user has named, and no fault of the disk."""
ANOTHER_PLACE = "; name another file or folder"
COMPLETION_OPTIONS = ("--install-completion", "--show-completion")


def run_app(arguments: Sequence[str], settle: Callable[[bool], None] | None = None) -> int:
    """Run one command; an error becomes one line on stderr and an exit code.

    `settle` is called with whether the command energises, before the command begins.
    """
    from orchestrator.interface.cli._foreign import with_plugin_commands
    from orchestrator.interface.cli._output import give_up_broken_output

    try:
        code = int(
            with_plugin_commands(app, arguments)(
                list(arguments), standalone_mode=False, obj=settle, prog_name="fluxbench"
            )
            or 0
        )
        sys.stdout.flush()
    except (typer.Abort, KeyboardInterrupt):
        return _fail("interrupted", 130)
    except SystemExit as error:  # no command of ours leaves like that; typer does where the pipe is broken
        if isinstance(error.__context__, BrokenPipeError):
            give_up_broken_output()
            return 0
        if COMPLETING in os.environ or any(word in COMPLETION_OPTIONS for word in arguments):
            return int(error.code or 0)
        return _fail(f"a plugin called exit({error.code}) in the middle of the command", 3)
    except BrokenPipeError:  # the reader of the output has ended
        give_up_broken_output()
        return 0
    except OSError as error:
        if error.filename is not None:
            line = f"{error.filename}: {error.strerror or error}"
            return _fail(line + ANOTHER_PLACE, 2) if error.errno in WRONG_PLACES else _fail(line, 3)
        if error.errno is None:  # a library's own error, which no call of the system made
            return _explain(error, arguments)
        give_up_broken_output()
        return _fail(f"standard output: cannot be written: {error.strerror or error}", 3)
    except MemoryError as error:  # numpy's error has a text, Python's own has none
        return _fail(f"not enough memory: {error}" if str(error) else "not enough memory", 3)
    except Exception as error:
        return _explain(error, arguments)
    return code


def _explain(error: Exception, arguments: Sequence[str]) -> int:
    """One line and an exit code for an error; the traceback of one that nothing expected goes to a file."""
    if hasattr(error, "format_message"):  # as all of typer's own errors have it
        from orchestrator.interface.cli._usage import usage_line

        return _fail(usage_line(error), getattr(error, "exit_code", 2))
    from protocols import FluxbenchError, StorageError  # a late import: it takes most of the time of --help

    if not isinstance(error, FluxbenchError):
        from orchestrator.extras import how_to_install, missing_extra

        extra = missing_extra(error)
        if extra is not None:
            return _fail(how_to_install(extra), 2)
        from orchestrator.interface.cli._defects import describe_defect, keep_traceback, run_among

        line, is_plugins = describe_defect(error)
        return _fail(line + keep_traceback(error, run_among(arguments)), 2 if is_plugins else 3)
    cause = error.__cause__ or error.__context__
    if isinstance(error, StorageError) and isinstance(cause, OSError) and cause.errno in WRONG_PLACES:
        return _fail(f"{error}{ANOTHER_PLACE}", 2)
    return _fail(f"{error}{_place_of(error)}", error.exit_code, getattr(error, "choices", ()))


def _place_of(error: Exception) -> str:
    """File and line of a plugin's code that caused an error of ours; empty where there is none."""
    from sysconfig import get_path
    from traceback import extract_tb

    from protocols import PluginError

    cause = error.__cause__
    if not isinstance(error, PluginError) or cause is None:
        return ""
    files = [(frame.filename, frame.lineno) for frame in extract_tb(cause.__traceback__)]
    foreign = [(file, line) for file, line in files if "site-packages" not in file and "<" not in file]
    foreign = [(file, line) for file, line in foreign if not file.startswith(get_path("stdlib"))]
    foreign = [(file, line) for file, line in foreign if not _is_own(file)]
    return f" ({foreign[-1][0]}, line {foreign[-1][1]})" if foreign else ""


def _is_own(file: str) -> bool:
    """Whether a file is of a package that runs plugins; built-in plugins are in none."""
    root = Path(__file__).resolve().parents[3]
    return any(Path(file).resolve().is_relative_to(root / package) for package in ("orchestrator", "protocols"))


def _fail(line: str, code: int, choices: Sequence[str] = ()) -> int:
    from orchestrator.interface.cli._output import complain

    complain(line, choices)
    return code
