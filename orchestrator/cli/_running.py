"""One command from its words to an exit code; what is wrong becomes one line on stderr."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import typer

from orchestrator.cli._app import app

COMPLETING = "_FLUXBENCH_COMPLETE"
"""Set by the shell that asks for what might come next."""
COMPLETION_OPTIONS = ("--install-completion", "--show-completion")


def run_app(arguments: Sequence[str], settle: Callable[[bool], None] | None = None) -> int:
    """Run one command; what is wrong becomes one line on stderr and an exit code.

    `settle` is told whether the command energises, before it begins.
    """
    from orchestrator.cli._foreign import with_plugin_commands
    from orchestrator.cli._output import give_up_broken_output

    try:
        code = int(
            with_plugin_commands(app, arguments)(
                list(arguments), standalone_mode=False, obj=settle, prog_name="fluxbench"
            )
            or 0
        )
        sys.stdout.flush()
    except (typer.Abort, KeyboardInterrupt):
        return _say("interrupted", 130)
    except SystemExit as error:  # no command of ours leaves like that; typer does where the pipe is broken
        if isinstance(error.__context__, BrokenPipeError):
            give_up_broken_output()
            return 0
        if COMPLETING in os.environ or any(word in COMPLETION_OPTIONS for word in arguments):
            return int(error.code or 0)
        return _say(f"a plugin called exit({error.code}) in the middle of the command", 3)
    except BrokenPipeError:  # whoever read the output has had enough
        give_up_broken_output()
        return 0
    except OSError as error:
        if error.filename is not None:
            asked_for = error.errno == errno.ENAMETOOLONG  # a name that was given, and no fault of the disk
            return _say(f"{error.filename}: {error.strerror or error}", 2 if asked_for else 3)
        give_up_broken_output()
        return _say(f"standard output: cannot be written: {error.strerror or error}", 3)
    except MemoryError as error:  # numpy says for what, Python itself does not
        return _say(f"not enough memory: {error}" if str(error) else "not enough memory", 3)
    except Exception as error:
        return _explain(error)
    return code


def _explain(error: Exception) -> int:
    """One line and an exit code for an error of ours or of the words; anything else is a defect and goes on."""
    usage = getattr(error, "format_message", None)  # as all of typer's own errors have it
    if usage is not None:
        return _say(usage(), getattr(error, "exit_code", 2))
    from protocols import FluxbenchError  # not before it is needed: it costs most of what --help may take

    if not isinstance(error, FluxbenchError):
        raise error
    return _say(f"{error}{_place_of(error)}", error.exit_code, getattr(error, "choices", ()))


def _place_of(error: Exception) -> str:
    """File and line of a plugin's own code that raised what an error of ours is about; empty where there is none."""
    from traceback import extract_tb

    from protocols import PluginError

    cause = error.__cause__
    if not isinstance(error, PluginError) or cause is None:
        return ""
    own = _room_of(extract_tb(error.__traceback__)[-1].filename)
    frames = [frame for frame in extract_tb(cause.__traceback__) if _room_of(frame.filename) != own]
    foreign = [frame for frame in frames if "site-packages" not in frame.filename and "<" not in frame.filename]
    return f" ({foreign[-1].filename}, line {foreign[-1].lineno})" if foreign else ""


def _room_of(file: str) -> str:
    """The package's folder that a file of this program is in, and else the file itself."""
    here = Path(__file__).resolve().parents[1]
    return str(here) if Path(file).resolve().is_relative_to(here) else file


def _say(line: str, code: int, choices: Sequence[str] = ()) -> int:
    from orchestrator.cli._output import complain

    complain(line, choices)
    return code
