"""Takes a run from its first stage to its end: which stage, which state, which point comes next.

One thread does everything here. Every path ends in `_shutdown`: the drive is disarmed, the reason is in the journal,
and the measured points are a valid recording.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from orchestrator.config import Plan, PlannedPoint, nameplate_doubts
from orchestrator.engine._interrupts import Interrupts
from orchestrator.engine._log import RunLog
from orchestrator.engine._measuring import Measurement
from orchestrator.engine._operator import Operator, Questions
from orchestrator.engine._overcurrent import explain_overcurrent, ripple_ratio, sensor_noise
from orchestrator.engine._plugins import UsedPlugins
from orchestrator.engine._point_queue import PointQueue
from orchestrator.engine._power import DISARMED_TEXT, PowerStage, as_drive_errors
from orchestrator.engine._probing import RippleProbe, weakened
from orchestrator.engine._stage_run import Engine, EngineContext
from orchestrator.engine._states import StateMachine, Trigger, table_of
from orchestrator.engine._thermometer import Thermometer
from orchestrator.recording import open_recording
from orchestrator.runs import RunDirectory
from protocols import (
    Capabilities,
    Drive,
    DriveFault,
    DriveRefused,
    EstimationReport,
    FaultCause,
    FluxbenchError,
    Note,
    PluginError,
    PointDone,
    PointStarted,
    RecordingError,
    ResumableDrive,
    RunAborted,
    RunEnded,
    RunInterrupted,
    RunStarted,
    Segment,
    StageStarted,
    StageState,
    StateChanged,
    StorageError,
)

Ending = Literal["finished", "faulted", "aborted"]
ENDINGS: dict[Ending, Trigger] = {"finished": Trigger.FINISH, "faulted": Trigger.FAULT, "aborted": Trigger.ABORT}


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run."""

    ending: Ending
    reason: str
    error: BaseException | None
    """Cause of a premature end."""
    estimates: EstimationReport | None = None
    """Estimates as in `RunEnded`."""


class Commissioning:
    """One run (or the rest of one) on a connected drive.

    Parameters
    ----------
    run : RunDirectory
        Open and locked; points in its journal are not measured again.
    plan : Plan
        Checked against limits and capabilities.
    drive : Drive
        Connected, disarmed.
    capabilities : Capabilities
    plugins : UsedPlugins
        Plugins of the plan's stages.
    operator : Operator
    interrupts : Interrupts
    log : RunLog
    thermometer : Thermometer, optional
        Beside the drive.
    """

    def __init__(
        self,
        run: RunDirectory,
        plan: Plan,
        drive: Drive,
        capabilities: Capabilities,
        plugins: UsedPlugins,
        operator: Operator,
        interrupts: Interrupts,
        log: RunLog,
        thermometer: Thermometer | None = None,
    ) -> None:
        self._run, self._drive, self._capabilities = run, drive, capabilities
        self._interrupts, self._log = interrupts, log
        limits = plan.procedure.limits
        self._power = PowerStage(drive, capabilities, limits, interrupts)
        self._measurement = Measurement(run, self._power, log, interrupts, capabilities, limits, thermometer)
        self._probe = RippleProbe(self._power, limits, plan.procedure.motor, interrupts)
        self._machine = StateMachine(table_of(plan.stages), self._on_change)
        self._queue = PointQueue(run, plan, capabilities)
        self._engine = Engine(
            run,
            capabilities,
            self._queue,
            self._machine,
            self._power,
            log,
            Questions(operator, interrupts, log, simulated=capabilities.simulated),
            interrupts,
            plugins,
        )
        self._current_point: PlannedPoint | None = None
        self._summary: EstimationReport | None = None
        self._unwritten: StorageError | None = None

    @property
    def state(self) -> str:
        return self._machine.state

    def execute(self) -> Outcome:
        """Run the remaining stages; never raises, and never leaves the drive energised."""
        try:
            self._begin()
            index = 0
            while index < len(self._queue.stages):  # a stage may append more
                index = self._enter(index)
            outcome = Outcome("finished", "every stage is done", None)
        except (RunInterrupted, RunAborted) as error:
            outcome = Outcome("aborted", str(error), error)
        except FluxbenchError as error:
            outcome = Outcome("faulted", str(error), error)
        except SystemExit as error:
            plugin_error = PluginError("plugins", "", f"one of them called exit({error.code}) in the middle of the run")
            outcome = Outcome("faulted", str(plugin_error), plugin_error)
        except BaseException as error:  # a defect: the drive first, then the traceback
            outcome = Outcome("faulted", f"{type(error).__name__}: {error}", error)
        return self._shutdown(outcome)

    def _begin(self) -> None:
        procedure = self._queue.plan.procedure
        self._log.publish(
            RunStarted(
                run=self._run.path.name,
                name=procedure.name,
                motor=procedure.motor,
                about=procedure.about,
                limits=procedure.limits,
                drive=self._capabilities.name,
                stages=len(procedure.stages),
                points=self._queue.points,
                points_done=len(self._queue.done),
                seconds=self._queue.seconds_left,
            )
        )
        for warning in nameplate_doubts(procedure.motor):
            self._log.publish(Note(level="warning", text=warning))
        self._machine.fire(Trigger.CONNECT)
        self._power.verify_at_rest()
        last = max(self._queue.done.values(), key=lambda segment: segment.start_s, default=None)
        if last is not None and isinstance(self._drive, ResumableDrive):
            with as_drive_errors(self._capabilities.name):
                self._drive.restore(last.id, self._run.end_s())

    def _enter(self, index: int) -> int:
        """Measure the remaining points of a stage and let it evaluate them; returns the next stage's index."""
        self._interrupts.check()
        stage = self._queue.stages[index]
        context = EngineContext(index, self._engine, self._keep_estimates)
        remaining = self._queue.points_left(index)
        if remaining and stage.measuring is not None:
            self._log.publish(StageStarted(index=index, stage=stage.name, title=stage.title, points=len(remaining)))
            self._machine.fire(stage.measuring.trigger)
            self._power.arm()
            try:
                self._measure_points(index, stage.measuring, context, self._within_limits(index, remaining))
            except DriveRefused as refusal:
                return self._skipped(index, refusal)
        if self._queue.has_work(index):
            if not remaining:
                self._log.publish(StageStarted(index=index, stage=stage.name, title=stage.title, points=0))
            stage.work(context)
        return index + 1

    def _measure_points(
        self, index: int, measuring: StageState, context: EngineContext, points: list[PlannedPoint]
    ) -> None:
        stage = self._queue.stages[index]
        excitations = stage.as_run(context, [point.excitation for point in points])
        for point in points:
            if self._interrupts.pause_wanted:
                self._pause(measuring)
            excitation = next(excitations, None)
            if excitation is None:
                self._log.publish(self._queue.finish_early(index), durable=True)
                return
            point_as_run = self._queue.validated(point, excitation)
            if self._machine.state != measuring.name:  # it stood down to compute
                self._machine.fire(measuring.trigger)
            self._power.arm()
            self._measure_point(point, point_as_run, partial(stage.after_point, context))

    def _skipped(self, index: int, refusal: DriveRefused) -> int:
        """Index after a refused proposal and the stages appended with it; raises the refusal of any other stage."""
        end = self._queue.end_of_appended(index)
        if end is None:
            raise refusal
        message = f"stages.{index} was proposed, and the drive refuses it: {refusal}; passed over"
        self._log.publish(Note(level="warning", text=message))
        return end

    def _within_limits(self, index: int, remaining: list[PlannedPoint]) -> list[PlannedPoint]:
        """The points with their injection scaled down to the ripple measured at the largest currents."""
        factor = self._queue.injection_scale(index)
        if factor is None:
            factor = self._probe.factor(remaining)
            if factor < 1.0:
                message = (
                    f"the ripple at the largest current exceeds the nameplate's: injection at {factor:.0%} of the plan"
                )
                self._log.publish(Note(level="info", text=message))
        return [weakened(point, factor) for point in remaining]

    def _measure_point(self, planned: PlannedPoint, point: PlannedPoint, after: Callable[[Segment], None]) -> None:
        target_d_a, target_q_a = point.target if point.target is not None else (None, None)
        self._log.publish(
            PointStarted(
                id=point.id,
                stage_index=point.stage_index,
                target_d_a=target_d_a,
                target_q_a=target_q_a,
                seconds=point.seconds,
            )
        )
        self._current_point = point
        segment, (achieved_d_a, achieved_q_a) = self._measurement.measure(point)
        self._current_point = None
        after(segment)  # if the process dies here, the point is repeated on resume
        if isinstance(self._drive, ResumableDrive):
            with as_drive_errors(self._capabilities.name):
                self._drive.checkpoint(point.id)
        self._queue.mark_done(planned, segment)
        self._log.publish(
            PointDone(
                id=point.id,
                stage_index=point.stage_index,
                segment=segment,
                achieved_d_a=achieved_d_a,
                achieved_q_a=achieved_q_a,
                points_done=len(self._queue.done),
                points=self._queue.points,
                seconds_left=self._queue.seconds_left,
            ),
            durable=True,
        )

    def _keep_estimates(self, estimates: EstimationReport) -> None:
        self._summary = estimates

    def _pause(self, measuring: StageState) -> None:
        self._engine.stand_down("a pause was requested")
        self._machine.fire(Trigger.PAUSE)
        self._log.before_prompt()
        self._interrupts.wait_until_resumed()
        self._machine.fire(measuring.trigger, "the operator let it go on")
        self._power.arm()

    def _shutdown(self, outcome: Outcome) -> Outcome:
        """Stop in any state; the reason includes what could not be written."""
        trouble: list[str] = []
        try:
            if self._machine.may(Trigger.STOP):  # else it was already stopping
                trouble.append(self._attempt(lambda: self._machine.fire(Trigger.STOP, outcome.reason)))
        finally:  # even after a defect the drive is disarmed
            stood_down = self._power.stand_down()
        if stood_down:
            level: Literal["info", "error"] = "info" if stood_down == DISARMED_TEXT else "error"
            trouble.append(self._attempt(lambda: self._log.publish(Note(level=level, text=stood_down))))
        if self._power.unsafe is not None and outcome.ending != "faulted":
            outcome = Outcome("faulted", stood_down, self._power.unsafe, outcome.estimates)
        if self._queue.done:
            trouble.append(self._attempt(self._keep_manifest))
        outcome = self._explained(outcome)
        reason = "; ".join(dict.fromkeys(filter(None, (outcome.reason, *trouble))))
        ending = self._ending(outcome)
        self._attempt(lambda: self._machine.fire(ENDINGS[ending], reason))
        ended = RunEnded(outcome=ending, reason=reason, run=self._run.path.name, estimates=self._summary)
        trouble.append(self._attempt(lambda: self._log.publish(ended, durable=True)))
        reason = "; ".join(dict.fromkeys(filter(None, (outcome.reason, *trouble))))
        return Outcome(self._ending(outcome), reason, outcome.error or self._unwritten, self._summary)

    def _explained(self, outcome: Outcome) -> Outcome:
        """The outcome with the likely cause of an overcurrent trip added."""
        fault, point = outcome.error, self._current_point
        if not isinstance(fault, DriveFault) or fault.cause is not FaultCause.OVERCURRENT or point is None:
            return outcome
        procedure, noise, ripple = self._queue.plan.procedure, None, None
        if self._queue.done:
            with suppress(FluxbenchError, OSError):  # without a readable recording the hint has less detail
                recording = open_recording(self._run.path)
                noise = sensor_noise(recording)
                ripple = ripple_ratio(recording, procedure.motor, noise)
        hint = explain_overcurrent(
            point, procedure.motor, procedure.limits, self._capabilities.sampling_frequency_hz, noise, ripple
        )
        explained = DriveFault(fault.cause, f"{point.id}: {fault.detail}; {hint}")
        return replace(outcome, reason=str(explained), error=explained)

    def _ending(self, outcome: Outcome) -> Ending:
        """The ending; a run with an unwritten result is faulted, even if every stage is done."""
        return "faulted" if outcome.error is None and self._unwritten is not None else outcome.ending

    def _keep_manifest(self) -> None:
        try:
            self._run.write_manifest()
        except RecordingError as error:  # the run's own files cannot be read: a fault of the disk
            raise StorageError(str(error)) from error

    def _attempt(self, call: Callable[[], object]) -> str:
        """One step of the shutdown; its error text, so that a full disk does not prevent the next step."""
        try:
            call()
        except StorageError as error:
            self._unwritten = self._unwritten or error
            return str(error)
        except (FluxbenchError, OSError) as error:
            return str(error)
        return ""

    def _on_change(self, source: str, target: str, reason: str) -> None:
        self._log.publish(StateChanged(source=source, target=target, reason=reason), durable=True)
