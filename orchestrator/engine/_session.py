"""Starts, resumes or extends a run.

A start claims the directory, connects, plans, then writes the run. On a failure before the first capture the directory
is removed.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from orchestrator.config import Plan, PlanSummary, check_plan, make_plan
from orchestrator.engine._commissioning import Commissioning, Outcome
from orchestrator.engine._interrupts import Interrupts
from orchestrator.engine._log import RunLog
from orchestrator.engine._operator import Operator
from orchestrator.engine._plugins import UsedPlugins
from orchestrator.engine._power import as_drive_errors
from orchestrator.engine._thermometer import Thermometer, open_thermometer
from orchestrator.engine.streaming import Dispatcher, StreamTally
from orchestrator.operating_system.files import free_bytes
from orchestrator.registry.plugins import PluginKind, load_plugin, make_options
from orchestrator.runs import RunDirectory, private_directory
from orchestrator.stages import parse_stages, spelled_out
from protocols import (
    Capabilities,
    Drive,
    DriveSetup,
    FluxbenchError,
    Note,
    PluginError,
    Procedure,
    RecordingError,
    StageEntry,
    StagesAppended,
    StorageError,
    Stream,
    StreamSetup,
)

STREAM_START_TIMEOUT_S = 5.0
"""Longest wait for the streams to start before a run begins."""
SPACE_PER_RECORDING = 3
"""Space of a run over that of its waveforms: results, report and view take as much again, and some is left."""
ON_MISSING_OPTION = "`--set drive.{option}={example}` gives it, and `fluxbench probe` lists the drives on this machine"
"""Advice where an option of the drive is missing."""
NOTHING_LEFT = "the run is finished: there is nothing left to do"


@dataclass(frozen=True)
class RunServices:
    """Operator, interrupts and streams of a run."""

    operator: Operator
    interrupts: Interrupts
    streams: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Options of each stream, by its plugin's name."""


@dataclass(frozen=True)
class RunResult:
    """Result of an ended run."""

    path: Path
    outcome: Outcome
    streams: Sequence[StreamTally]


def start_run(procedure: Procedure, path: Path, services: RunServices) -> RunResult:
    """Commission a motor into a new run directory.

    Parameters
    ----------
    procedure : Procedure
    path : Path
        The run directory; must not exist, or be empty.
    services : RunServices

    Returns
    -------
    RunResult
        Also where the run ended in a fault: that is in its outcome.

    Raises
    ------
    FluxbenchError
        An input is wrong, or the drive does not answer. No run directory is left
        behind, unless something was measured.
    """
    procedure = spelled_out(procedure)  # so that a later resume does not take changed defaults
    plugins = UsedPlugins(parse_stages(procedure))
    streams = _stream_makers(services.streams, path)
    path = path.resolve()
    sealed = load_plugin(PluginKind.DRIVES, procedure.drive.name).sealed_options
    with RunDirectory.claim(path):
        try:
            with connected_drive(procedure, private_directory(path)) as (drive, capabilities):
                plan = make_plan(procedure, capabilities)
                require_space(path, check_plan(plan, capabilities))
                with open_thermometer(procedure.thermometer) as thermometer:
                    run = RunDirectory.create(path, procedure, capabilities, sealed=sealed)
                    with run.at_work():
                        return _commission(run, plan, drive, capabilities, plugins, streams, services, thermometer)
        except BaseException:
            # A run that is under way ends in an outcome. Where something was measured all the same, it stays.
            if RunDirectory.has_captures(path):
                raise
            for folder in (path, private_directory(path)):
                shutil.rmtree(folder, ignore_errors=True)
            raise


def resume_run(path: Path, services: RunServices) -> RunResult:
    """Continue a run at its first point that is not done; a finished one comes back as it is.

    Raises
    ------
    FluxbenchError
        The directory is no run, or is still being worked on.
    """
    run = RunDirectory.open(path)
    run.refuse_lost_journal()
    with run.lock():
        ended = run.ended()
        if ended is not None and ended.outcome == "finished":
            return RunResult(run.path, Outcome("finished", NOTHING_LEFT, None, ended.estimates), ())
        return _go_on(run, services)


def extend_run(path: Path, stages: Sequence[StageEntry], services: RunServices) -> RunResult:
    """Go on with a finished run by some stages more, on the same drive and into the same recording.

    Raises
    ------
    FluxbenchError
        The directory is no run, is not finished or still being worked on, or the stages exceed its limits or
        the drive's. Nothing was energised, and nothing appended.
    """
    run = RunDirectory.open(path)
    run.refuse_lost_journal()
    with run.lock():
        ended = run.ended()
        if ended is None or ended.outcome != "finished":
            raise RecordingError(str(path), "", f"the run is not finished: `fluxbench resume {path}` comes first")
        return _go_on(run, services, more=tuple(stages))


def _go_on(run: RunDirectory, services: RunServices, more: tuple[StageEntry, ...] = ()) -> RunResult:
    procedure = run.procedure()
    appended = [*(stage for message in run.appended() for stage in message.stages), *more]
    plugins = UsedPlugins(parse_stages(procedure, appended))
    streams = _stream_makers(services.streams, run.path)
    with connected_drive(procedure, run.private_directory) as (drive, capabilities):
        plan = make_plan(procedure, capabilities, appended)
        check_plan(plan, capabilities)
        if more:
            run.journal.append(StagesAppended(by=None, stages=more), durable=True)
        with open_thermometer(procedure.thermometer) as thermometer:
            return _commission(run, plan, drive, capabilities, plugins, streams, services, thermometer)


def _stream_makers(wanted: Mapping[str, Mapping[str, Any]], path: Path) -> dict[str, Callable[[], Stream]]:
    makers: dict[str, Callable[[], Stream]] = {}
    for name, options in wanted.items():
        plugin: type[Stream] = load_plugin(PluginKind.STREAMS, name)
        setup = StreamSetup(run=path, options=make_options(plugin, dict(options), f"stream {name}"))
        makers[name] = partial(plugin, setup)
    return makers


def require_space(path: Path, summary: PlanSummary) -> None:
    """Raise `StorageError` where the disk has too little space for a plan's recording and its results."""
    needed, free = SPACE_PER_RECORDING * (summary.bytes or 0), free_bytes(path)
    if free is not None and free < needed:
        sizes = f"the run needs some {1e-6 * needed:.0f} MB, and {1e-6 * free:.0f} MB are free"
        raise StorageError(f"{path}: {sizes}; nothing was energised")


@contextmanager
def connected_drive(procedure: Procedure, private: Path | None) -> Iterator[tuple[Drive, Capabilities]]:
    """Context with the procedure's drive connected; closed at the end."""
    plugin = load_plugin(PluginKind.DRIVES, procedure.drive.name)
    options = make_options(plugin, procedure.drive.options, "drive", ON_MISSING_OPTION)
    name = procedure.drive.name
    setup = DriveSetup(motor=procedure.motor, options=options, seed=procedure.seed, private_directory=private)
    with _as_plugin_errors(name):
        drive: Drive = plugin(setup)
    try:
        with _as_plugin_errors(name):
            capabilities = drive.connect()
        yield drive, capabilities
    finally:
        with suppress(FluxbenchError), as_drive_errors(name):  # a link that is gone cannot be closed
            drive.close()


@contextmanager
def _as_plugin_errors(name: str) -> Iterator[None]:
    """Raise any other exception of a plugin's setup as `PluginError`."""
    try:
        yield
    except FluxbenchError:
        raise
    except (Exception, SystemExit) as error:
        first_line = f"{type(error).__name__}: {error}".splitlines()[0]
        problem = f"cannot be set up for this motor with these options ({first_line[:200]})"
        raise PluginError("drives", name, problem) from error


def _commission(
    run: RunDirectory,
    plan: Plan,
    drive: Drive,
    capabilities: Capabilities,
    plugins: UsedPlugins,
    streams: Mapping[str, Callable[[], Stream]],
    services: RunServices,
    thermometer: Thermometer | None,
) -> RunResult:
    dispatcher = Dispatcher(streams)
    # Wait for slow imports of streams before energising, because they delay the heartbeat.
    dispatcher.drain(STREAM_START_TIMEOUT_S)
    log = RunLog(run.journal, dispatcher)
    who = services.operator, services.interrupts
    outcome = Commissioning(run, plan, drive, capabilities, plugins, *who, log, thermometer).execute()
    tallies = dispatcher.close()
    for tally in tallies:
        if tally.has_failed:
            with suppress(StorageError):  # the disk that a stream could not write may be the journal's
                run.journal.append(Note(level="warning", text=tally.trouble))
    return RunResult(run.path, outcome, tallies)
