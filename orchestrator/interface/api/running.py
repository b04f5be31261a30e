"""A procedure run from Python: arguments replace the command line's questions."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.extras import is_installed
from orchestrator.interface.api.measurements import Measurements, open
from orchestrator.interface.api.threads import one_thread
from orchestrator.runs import refuse_file
from protocols import InputError, Procedure

if TYPE_CHECKING:
    from orchestrator.engine import Operator


@one_thread()
def run(
    procedure: str | PathLike[str] | Procedure,
    *,
    drive: str | None = None,
    motor: str | PathLike[str] | None = None,
    settings: Mapping[str, Any] | None = None,
    out: str | PathLike[str] | None = None,
    operator: Operator | None = None,
    unattended: str | None = None,
    streams: Sequence[str] | None = None,
) -> Measurements:
    """Commission a motor into a new run directory.

    Parameters
    ----------
    procedure : str, path or Procedure
        Name of a shipped procedure, a YAML file, or a loaded procedure.
    drive, motor, settings : optional
        As `load_procedure` takes them, for a procedure that is not loaded yet; settings by their key paths:
        ``{"limits.current_a": 3.0}``.
    out : path, optional
        The run directory; by default ``runs/<name>-<time>``.
    operator : Operator, optional
        Answers the procedure's questions; without one, the procedure's own answers count where the drive is simulated.
    unattended : str, optional
        ``"I have made the bench safe"``: without an operator, the procedure's answers count on a real drive as well.
    streams : sequence of str, optional
        Outputs; by default ``report``, where its extra is installed. ``report`` writes report.html, ``console``
        prints the progress, ``rerun`` writes view.rrd.

    Raises
    ------
    FluxbenchError
        An argument is wrong (nothing was energised, no directory is left), or the run ended in a fault (its directory
        is kept, and named in the error's notes).
    """
    # A caller that only reads recordings does not need the engine.
    from orchestrator.config import load_procedure
    from orchestrator.engine import AbsentOperator, Interrupts, RunServices, handling_signals, start_run

    if not isinstance(procedure, Procedure):
        overrides, motor_file = as_overrides(settings or {}), None if motor is None else Path(motor)
        procedure = load_procedure(str(procedure), overrides=overrides, drive=drive, motor=motor_file)
    elif drive or motor or settings:
        raise InputError("run", "procedure", "is loaded already: pass drive, motor and settings to `load_procedure`")
    path = run_directory(procedure.name, None if out is None else Path(out))
    with ExitStack() as stack:
        on_main = threading.current_thread() is threading.main_thread()  # no other thread may handle signals
        interrupts = stack.enter_context(handling_signals()) if on_main else Interrupts()
        named = streams if streams is not None else ["report"] if is_installed("report") else []
        services = RunServices(operator or AbsentOperator(unattended), interrupts, {name: {} for name in named})
        error = start_run(procedure, path, services).outcome.error
    if error is not None:
        error.add_note(f"the run is kept in {path}")
        raise error
    return open(path)


def run_directory(name: str, out: Path | None) -> Path:
    """The folder of a run: `out`, or a new one below ``runs/``; raises `InputError` for an unusable one."""
    path = out if out is not None else Path("runs") / f"{name}-{time.strftime('%Y%m%d-%H%M%S')}"
    if not path.name:
        raise InputError("--out", "", "expected a folder of its own")
    refuse_file(path)
    return path


def as_overrides(settings: Mapping[str, Any]) -> list[str]:
    """Settings by key paths in the form of ``--set``."""
    return [f"{key}={json.dumps(value, default=str)}" for key, value in settings.items()]
