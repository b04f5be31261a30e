"""Takes a run from its first stage to its end: which stage, which state, which point comes next.

One thread does everything here. Whatever happens on the way, the run ends through one door:
the drive stands down, the reason is in the journal, and what was measured is a valid recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from orchestrator.config import Plan, PlannedPoint
from orchestrator.engine._interrupts import Interrupts
from orchestrator.engine._log import RunLog
from orchestrator.engine._measuring import Measurement
from orchestrator.engine._operator import Operator
from orchestrator.engine._power import SAFE, PowerStage, as_drive_errors
from orchestrator.engine._states import State, StateMachine, Trigger
from orchestrator.recording import Recording, open_recording
from orchestrator.runs import RunDirectory
from protocols import (
    AlignmentStage,
    Capabilities,
    ClassicalStage,
    Drive,
    Estimate,
    EstimateStage,
    Estimator,
    FluxbenchError,
    GatesOffStage,
    InjectionStage,
    LockCheckStage,
    MapEstimated,
    Note,
    NotMeasuredError,
    OperatorAnswered,
    OperatorAsked,
    OperatorStage,
    PointDone,
    PointStarted,
    ResistanceEstimate,
    ResistanceEstimated,
    ResistanceStage,
    ResumableDrive,
    RunAborted,
    RunEnded,
    RunInterrupted,
    RunStarted,
    Segment,
    Stage,
    StageStarted,
    StateChanged,
)

MeasuringStage = GatesOffStage | AlignmentStage | LockCheckStage | ResistanceStage | ClassicalStage | InjectionStage

STAGE_TRIGGERS = {
    "gates_off": Trigger.READ_GATES_OFF,
    "alignment": Trigger.ALIGN,
    "lock_check": Trigger.CHECK_LOCK,
    "resistance": Trigger.ESTIMATE_RESISTANCE,
    "classical": Trigger.SWEEP_CLASSICAL,
    "injection": Trigger.SWEEP_INJECTION,
}

Ending = Literal["finished", "faulted", "aborted"]
ENDINGS: dict[Ending, Trigger] = {"finished": Trigger.FINISH, "faulted": Trigger.FAULT, "aborted": Trigger.ABORT}


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    ending: Ending
    reason: str
    error: BaseException | None
    """What ended it before its time."""
    estimates: Mapping[str, object] = field(default_factory=dict)
    """As `RunEnded` has them."""


class Commissioning:
    """One run (or what is left of one) on a connected drive.

    Parameters
    ----------
    run : RunDirectory
        Open and locked; points that its journal holds are not measured again.
    plan : Plan
        Checked against limits and capabilities.
    drive : Drive
        Connected, disarmed.
    capabilities : Capabilities
    estimators : sequence of Estimator
        Installed ones; an estimate stage takes all, or those that it names.
    operator : Operator
    interrupts : Interrupts
    log : RunLog
    """

    def __init__(
        self,
        run: RunDirectory,
        plan: Plan,
        drive: Drive,
        capabilities: Capabilities,
        estimators: Sequence[Estimator],
        operator: Operator,
        interrupts: Interrupts,
        log: RunLog,
    ) -> None:
        self._run, self._plan, self._drive, self._capabilities = run, plan, drive, capabilities
        self._estimators, self._operator, self._interrupts, self._log = estimators, operator, interrupts, log
        limits = plan.procedure.limits
        self._power = PowerStage(drive, capabilities, limits, interrupts)
        self._measurement = Measurement(run, self._power, log, interrupts, capabilities, limits)
        self._machine = StateMachine(self._on_change)
        self._done = dict(run.completed())
        self._seconds_left = sum(point.seconds for point in plan.points if point.id not in self._done)
        self._summary: dict[str, object] = {}

    @property
    def state(self) -> State:
        return self._machine.state

    def execute(self) -> Outcome:
        """Run every stage that is left; never raises, and never leaves the drive energised."""
        try:
            self._begin()
            for index, stage in enumerate(self._plan.procedure.stages):
                self._enter(index, stage)
            outcome = Outcome("finished", "every stage is done", None)
        except (RunInterrupted, RunAborted) as error:
            outcome = Outcome("aborted", str(error), error)
        except FluxbenchError as error:
            outcome = Outcome("faulted", str(error), error)
        except BaseException as error:  # a defect: the drive comes first, the traceback after
            outcome = Outcome("faulted", f"{type(error).__name__}: {error}", error)
        return self._leave(outcome)

    def _begin(self) -> None:
        procedure = self._plan.procedure
        self._log.say(
            RunStarted(
                run=str(self._run.path),
                name=procedure.name,
                motor=procedure.motor,
                limits=procedure.limits,
                drive=self._capabilities.name,
                stages=len(procedure.stages),
                points=len(self._plan.points),
                points_done=len(self._done),
                seconds=self._seconds_left,
            )
        )
        self._machine.fire(Trigger.CONNECT)
        self._power.verify_at_rest()
        last = max(self._done.values(), key=lambda segment: segment.start_s, default=None)
        if last is not None and isinstance(self._drive, ResumableDrive):
            with as_drive_errors(self._capabilities.name):
                self._drive.restore(last.id, self._run.end_s())

    def _enter(self, index: int, stage: Stage) -> None:
        self._interrupts.check()
        if isinstance(stage, OperatorStage):
            if not self._measured_after(index):
                self._ask(stage)
        elif isinstance(stage, EstimateStage):
            self._estimate(stage)
        else:
            self._measure(index, stage)

    def _measured_after(self, index: int) -> bool:
        """Whether a later stage has points already: then the operator did this deed in the run's first life."""
        return any(point.id in self._done for point in self._plan.points if point.stage_index > index)

    def _stand_down(self, reason: str) -> None:
        if self._power.armed:
            self._machine.fire(Trigger.STOP, reason)
            self._log.say(Note(level="info", text=self._power.stand_down()))

    def _ask(self, stage: OperatorStage) -> None:
        self._stand_down("the operator is needed")
        self._machine.fire(Trigger.ASK_OPERATOR)
        self._log.say(OperatorAsked(prompt=stage.prompt))
        if stage.answer is not None:
            self._log.say(OperatorAnswered(answer=stage.answer, by="procedure"), durable=True)
        else:
            self._log.before_prompt()
            agreed = self._operator.confirm(stage.prompt, self._interrupts)
            self._log.say(OperatorAnswered(answer="yes" if agreed else "no", by="operator"), durable=True)
            if not agreed:
                raise RunAborted(f"the operator said no to: {stage.prompt}")
        if stage.brake is not None:
            self._power.set_brake(stage.brake == "engage")

    def _measure(self, index: int, stage: MeasuringStage) -> None:
        points = self._plan.points_of(index)
        left = [point for point in points if point.id not in self._done]
        if left:
            self._log.say(StageStarted(index=index, stage=stage.kind, points=len(left)))
            self._machine.fire(STAGE_TRIGGERS[stage.kind])
            self._power.arm()
        for point in left:
            if self._interrupts.pause_wanted:
                self._pause(stage)
            self._measure_point(point)
        if isinstance(stage, LockCheckStage):
            self._judge_lock(stage, points)

    def _measure_point(self, point: PlannedPoint) -> None:
        target_d_a, target_q_a = point.target if point.target is not None else (None, None)
        self._log.say(
            PointStarted(
                id=point.id,
                stage_index=point.stage_index,
                target_d_a=target_d_a,
                target_q_a=target_q_a,
                seconds=point.seconds,
            )
        )
        segment, (achieved_d_a, achieved_q_a) = self._measurement.measure(point)
        if isinstance(self._drive, ResumableDrive):
            with as_drive_errors(self._capabilities.name):
                self._drive.checkpoint(point.id)
        self._done[point.id] = segment
        self._seconds_left -= point.seconds
        self._log.say(
            PointDone(
                id=point.id,
                stage_index=point.stage_index,
                segment=segment,
                achieved_d_a=achieved_d_a,
                achieved_q_a=achieved_q_a,
                points_done=len(self._done),
                points=len(self._plan.points),
                seconds_left=max(0.0, self._seconds_left),
            ),
            durable=True,
        )

    def _pause(self, stage: MeasuringStage) -> None:
        self._stand_down("a pause was asked for")
        self._machine.fire(Trigger.PAUSE)
        self._log.before_prompt()
        self._interrupts.wait_until_resumed()
        self._machine.fire(STAGE_TRIGGERS[stage.kind], "the operator let it go on")
        self._power.arm()

    def _judge_lock(self, stage: LockCheckStage, points: Sequence[PlannedPoint]) -> None:
        from orchestrator.analysis import judge_lock

        self._compute()
        recording = self._recording()
        segments: list[Segment] = [self._done[point.id] for point in points]
        verdict = judge_lock(
            [(segment, recording.load(segment)) for segment in segments],
            stage.tolerance_rad,
            voltage_delay_samples=self._capabilities.voltage_delay_samples,
        )
        self._log.say(verdict, durable=True)
        if verdict.locked and verdict.confidence < 0.5:
            self._log.say(Note(level="warning", text=verdict.summary))
        if not verdict.locked:
            raise RunAborted(f"the rotor is not locked: {verdict.summary}")

    def _compute(self) -> None:
        """Stand down first: nobody knows how long a computation takes on a machine that is busy."""
        self._stand_down("computing needs no current")
        self._machine.fire(Trigger.ESTIMATE)

    def _recording(self) -> Recording:
        self._run.write_manifest()
        return open_recording(self._run.path)

    def _estimate(self, stage: EstimateStage) -> None:
        from orchestrator.analysis import estimate_recording

        self._compute()
        wanted = [e for e in self._estimators if stage.estimators is None or e.name in stage.estimators]
        try:
            report = estimate_recording(self._recording(), wanted, self._run.path, on_estimate=self._say_estimate)
        except NotMeasuredError as error:
            self._log.say(Note(level="warning", text=str(error)))
            return
        self._summary = report.model_dump(mode="json")

    def _say_estimate(self, estimate: Estimate) -> None:
        self._interrupts.check()
        if isinstance(estimate, ResistanceEstimate):
            self._log.say(ResistanceEstimated(estimate=estimate))
        else:
            self._log.say(MapEstimated(estimate=estimate))

    def _leave(self, outcome: Outcome) -> Outcome:
        """Stop, whatever has happened; what can no longer be written is told in the reason."""
        trouble = [self._last_word(lambda: self._machine.fire(Trigger.STOP, outcome.reason))]
        stood_down = self._power.stand_down()
        if stood_down:
            level: Literal["info", "error"] = "info" if stood_down == SAFE else "error"
            trouble.append(self._last_word(lambda: self._log.say(Note(level=level, text=stood_down))))
        if self._done:
            trouble.append(self._last_word(self._run.write_manifest))
        reason = "; ".join(dict.fromkeys(filter(None, (outcome.reason, *trouble))))
        self._last_word(lambda: self._machine.fire(ENDINGS[outcome.ending], reason))
        ended = RunEnded(outcome=outcome.ending, reason=reason, run=str(self._run.path), estimates=self._summary)
        self._last_word(lambda: self._log.say(ended, durable=True))
        return Outcome(outcome.ending, reason, outcome.error, self._summary)

    def _last_word(self, call: Callable[[], object]) -> str:
        """Do one thing of the way out; a disk that is full must not keep the next from being done."""
        try:
            call()
        except (FluxbenchError, OSError) as error:
            return str(error)
        return ""

    def _on_change(self, source: State, target: State, reason: str) -> None:
        self._log.say(StateChanged(source=source.value, target=target.value, reason=reason), durable=True)
