"""`fluxbench run` and `fluxbench resume`: from options to a run, and from its result to an exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from orchestrator.config import read_procedure
from orchestrator.engine import (
    NOTHING_LEFT,
    AbsentOperator,
    Operator,
    RemoteOperator,
    RunResult,
    RunServices,
    TerminalOperator,
    extend_run,
    handling_signals,
    resume_run,
    start_run,
)
from orchestrator.extras import how_to_install, is_installed
from orchestrator.interface.api import as_overrides, run_directory
from orchestrator.interface.cli._output import complain, give_up_broken_output, say_document, say_notes
from orchestrator.shelf import JudgedRun, ask_serial, judge_run, run_folder_of, work_through, write_junit
from protocols import DriveFault, FaultCause, FluxbenchError


@dataclass(frozen=True)
class Audience:
    """Options of a run's output, and of the operator's presence."""

    unattended: str | None = None
    """The confirmation with which the procedure's own answers count on a real drive."""
    quiet: bool = False
    as_json: bool = False
    log: str = "text"
    """text, or json: one object per line."""
    view: bool = False
    """Whether the viewer opens and follows the run."""
    streams: tuple[str, ...] = ()
    """Names of additional streams."""
    remote: str | None = None
    """Name of the program through which the operator answers."""
    junit: Path | None = None
    """File to which the judgement by the procedure's limits is written."""

    @property
    def console_mode(self) -> str:
        if self.remote is not None:
            return "quiet"
        if self.log == "json":
            return "jsonl"
        return "quiet" if self.quiet or self.as_json else "auto"

    def options(self) -> dict[str, dict[str, Any]]:
        """Options of each stream, by its plugin's name."""
        # With --json the result alone goes to standard output.
        output = "stderr" if self.as_json and self.log == "json" else "stdout"
        console = {"console": {"mode": self.console_mode, "output": output}}
        return {
            **(console if self.remote is None else {"remote": {}}),
            **({"report": {}} if is_installed("report") else {}),
            **({"rerun": {"view": "auto" if self.view else "none"}} if self.view or is_installed("viewer") else {}),
            **{name: {} for name in self.streams},
        }


def run(
    source: str,
    drive: str | None,
    motor: Path | None,
    overrides: Sequence[str],
    out: Path | None,
    audience: Audience,
    about: Mapping[str, Any] | None = None,
    judged: list[JudgedRun] | None = None,
) -> int:
    """Commission into a new directory; returns the exit code.

    The values of `about` override those of the procedure's own section of that name. `judged` has the runs before this
    one of the same station, which is added.
    """
    about = {f"about.{name}": value for name, value in (about or {}).items() if value not in (None, [])}
    loaded = read_procedure(source, overrides=[*overrides, *as_overrides(about)], drive=drive, motor=motor)
    path = run_directory(loaded.procedure.name, out)
    if audience.console_mode == "auto":
        say_notes(loaded.notes)
    with loaded.locating_errors():
        return _with_services(lambda services: start_run(loaded.procedure, path, services), audience, judged)


def run_queue(
    source: str,
    drive: str | None,
    motor: Path | None,
    overrides: Sequence[str],
    audience: Audience,
    about: Mapping[str, Any],
) -> int:
    """Commission motor after motor, each after a question for its serial number; returns the worst exit code."""
    name = read_procedure(source, overrides=overrides, drive=drive, motor=motor).procedure.name
    judged: list[JudgedRun] = []

    def run_motor(serial: str) -> int:
        path = run_folder_of(name, serial)
        return run(source, drive, motor, overrides, path, audience, {**about, "serial": serial}, judged)

    return work_through(ask_serial, run_motor, _warn)


def run_further(source: Path, rounds: int, audience: Audience, effects: Path | None = None) -> int:
    """Measure the experiment that a run's diagnosis proposes, and diagnose again, with its own effects."""
    from orchestrator.interface.cli._further import continuation, diagnose_again

    further = continuation(source, rounds, effects)
    for left in reversed(range(rounds)):
        code = _with_services(partial(extend_run, further.path, further.stages), audience)
        if code != 0 or further.effects is None:
            return code
        is_proposed = diagnose_again(further.path, further.effects, quiet=audience.console_mode != "auto")
        if not (left and is_proposed):
            break
        further = continuation(further.path, left, further.effects)
    return 0


def resume(path: Path, audience: Audience) -> int:
    """Go on with an interrupted run; energises only on the operator's word."""
    return _with_services(lambda services: resume_run(path, services), audience)


def _with_services(
    commission: Callable[[RunServices], RunResult], audience: Audience, judged: list[JudgedRun] | None = None
) -> int:
    # A viewer's library would write its own words to the terminal; what matters of them is in the streams' tally.
    os.environ.setdefault("RUST_LOG", "off")
    operator = _operator(audience)
    with ExitStack() as stack:
        interrupts = stack.enter_context(handling_signals())
        if isinstance(operator, RemoteOperator):
            stack.enter_context(operator.listening(interrupts))
        result = commission(RunServices(operator, interrupts, audience.options()))
    troubles = [tally.trouble for tally in result.streams if tally.trouble]
    if troubles and result.outcome.error is None:
        _warn("; ".join(troubles))
    report = result.path / "report.html"
    if audience.console_mode == "auto":
        if report.is_file():
            _print(f"report: {report}")
        for extra, output in (("report", report.name), ("viewer", "view.rrd")):
            if not is_installed(extra):
                _print(f"no {output}: {how_to_install(extra)}")
    judgement = judge_run(result.path) if result.outcome.error is None or audience.junit is not None else None
    if audience.junit is not None and judgement is not None:
        runs = [] if judged is None else judged
        runs.append(judgement)
        write_junit(audience.junit, runs)
    code = _exit_code(result, troubles, audience, judgement)
    give_up_broken_output()
    return code


def _operator(audience: Audience) -> Operator:
    if audience.remote is not None:
        return RemoteOperator(audience.remote)
    alone = audience.unattended is not None or not sys.stdin.isatty()
    return AbsentOperator(audience.unattended) if alone else TerminalOperator()


def _exit_code(result: RunResult, troubles: Sequence[str], audience: Audience, judgement: JudgedRun | None) -> int:
    outcome, as_json = result.outcome, audience.as_json
    acceptance = None if judgement is None else judgement.acceptance
    if as_json:
        import json

        estimates = {} if outcome.estimates is None else outcome.estimates.model_dump(mode="json")
        document = {
            "run": str(result.path),
            "outcome": outcome.ending,
            "reason": outcome.reason,
            "estimates": estimates,
            "acceptance": None if acceptance is None else acceptance.model_dump(mode="json"),
        }
        _print(json.dumps(document, indent=2))
    if outcome.error is None:
        if outcome.reason == NOTHING_LEFT and not as_json:
            _print(f"{result.path}: {outcome.reason}; `fluxbench estimate` and `diagnose` compute again")
        if judgement is None or acceptance is None:
            return 0
        if audience.console_mode == "auto":
            _print(judgement.label)
        if not acceptance.passed:
            _warn(f"not accepted: {'; '.join(acceptance.objections)}")
        return judgement.exit_code
    resume_hint = f"`fluxbench resume {result.path}` continues at the first unmeasured point"
    from orchestrator.interface.cli._defects import describe_defect, keep_traceback, place_of

    error, reason, code = outcome.error, outcome.reason, 3
    if not isinstance(error, FluxbenchError):
        reason = describe_defect(error)[0] + keep_traceback(error, result.path)
    else:
        code = max(error.exit_code, 3)
        cause = error.__cause__
        if isinstance(error, DriveFault) and error.cause is FaultCause.INTERNAL and cause is not None:
            reason += place_of(cause) + keep_traceback(error, result.path)
    _warn("; ".join([f"{outcome.ending}: {reason}", resume_hint, *troubles]))
    return code


def _warn(line: str) -> None:
    with suppress(OSError):  # the terminal is gone
        complain(line)


def _print(text: str) -> None:
    with suppress(OSError):  # the terminal is gone
        say_document(text)
