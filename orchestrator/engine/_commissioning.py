"""Takes a run from its first stage to its end: which stage, which state, which point comes next.

One thread does everything here. Whatever happens on the way, the run ends through one door:
the drive stands down, the reason is in the journal, and what was measured is a valid recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from orchestrator.config import Plan, PlannedPoint
from orchestrator.engine._agenda import Agenda
from orchestrator.engine._diagnosing import compared, diagnosed, following_stages
from orchestrator.engine._interrupts import Interrupts
from orchestrator.engine._log import RunLog
from orchestrator.engine._measuring import Measurement
from orchestrator.engine._operator import Operator, Questions
from orchestrator.engine._power import SAFE, PowerStage, as_drive_errors
from orchestrator.engine._probing import RippleProbe, weakened
from orchestrator.engine._states import State, StateMachine, Trigger
from orchestrator.recording import Recording, open_recording
from orchestrator.runs import RunDirectory
from protocols import (
    AlignmentStage,
    Capabilities,
    CapabilityError,
    ClassicalStage,
    DiagnoseStage,
    DiagnosisStep,
    Drive,
    Effect,
    Estimate,
    EstimateStage,
    EstimationReport,
    Estimator,
    ExperimentProposed,
    FluxbenchError,
    GatesOffStage,
    InjectionStage,
    LockChecked,
    LockCheckStage,
    MapEstimated,
    Note,
    NotMeasuredError,
    OperatorStage,
    PluginError,
    PointDone,
    PointStarted,
    ProcedureError,
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
    StagesAppended,
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

LEAST_CONFIDENCE = 0.5
"""Below it a lock that nothing speaks against is not known."""
NOT_KNOWN = "Whether the rotor is locked cannot be measured on this motor. Have you seen that it is held?"

Ending = Literal["finished", "faulted", "aborted"]
ENDINGS: dict[Ending, Trigger] = {"finished": Trigger.FINISH, "faulted": Trigger.FAULT, "aborted": Trigger.ABORT}


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    ending: Ending
    reason: str
    error: BaseException | None
    """What ended it before its time."""
    estimates: EstimationReport | None = None
    """As `RunEnded` has it."""


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
    effects : sequence of Effect
        The library of a diagnose stage.
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
        effects: Sequence[Effect],
        operator: Operator,
        interrupts: Interrupts,
        log: RunLog,
    ) -> None:
        self._run, self._drive, self._capabilities = run, drive, capabilities
        self._estimators, self._effects = estimators, effects
        self._interrupts, self._log = interrupts, log
        self._questions = Questions(operator, interrupts, log)
        limits = plan.procedure.limits
        self._power = PowerStage(drive, capabilities, limits, interrupts)
        self._measurement = Measurement(run, self._power, log, interrupts, capabilities, limits)
        self._probe = RippleProbe(self._power, limits, plan.procedure.motor, interrupts)
        self._machine = StateMachine(self._on_change)
        self._agenda = Agenda(run, plan, capabilities)
        self._summary: EstimationReport | None = None

    @property
    def state(self) -> State:
        return self._machine.state

    def execute(self) -> Outcome:
        """Run every stage that is left; never raises, and never leaves the drive energised."""
        try:
            self._begin()
            index = 0
            while index < len(self._agenda.stages):  # a diagnosis may append to them
                self._enter(index, self._agenda.stages[index])
                index += 1
            outcome = Outcome("finished", "every stage is done", None)
        except (RunInterrupted, RunAborted) as error:
            outcome = Outcome("aborted", str(error), error)
        except FluxbenchError as error:
            outcome = Outcome("faulted", str(error), error)
        except SystemExit as error:
            plugin_error = PluginError("plugins", "", f"one of them called exit({error.code}) in the middle of the run")
            outcome = Outcome("faulted", str(plugin_error), plugin_error)
        except BaseException as error:  # a defect: the drive comes first, the traceback after
            outcome = Outcome("faulted", f"{type(error).__name__}: {error}", error)
        return self._leave(outcome)

    def _begin(self) -> None:
        procedure = self._agenda.plan.procedure
        self._log.say(
            RunStarted(
                run=str(self._run.path),
                name=procedure.name,
                motor=procedure.motor,
                limits=procedure.limits,
                drive=self._capabilities.name,
                stages=len(procedure.stages),
                points=len(self._agenda.plan.points),
                points_done=len(self._agenda.done),
                seconds=self._agenda.seconds_left,
            )
        )
        self._machine.fire(Trigger.CONNECT)
        self._power.verify_at_rest()
        last = max(self._agenda.done.values(), key=lambda segment: segment.start_s, default=None)
        if last is not None and isinstance(self._drive, ResumableDrive):
            with as_drive_errors(self._capabilities.name):
                self._drive.restore(last.id, self._run.end_s())

    def _enter(self, index: int, stage: Stage) -> None:
        self._interrupts.check()
        if isinstance(stage, OperatorStage):
            if not self._agenda.passed(index):
                self._ask(stage)
        elif isinstance(stage, EstimateStage):
            if not self._agenda.estimated_later(index):
                self._estimate(stage)
        elif isinstance(stage, DiagnoseStage):
            if not self._agenda.passed(index):
                self._diagnose(index, stage)
        else:
            self._measure(index, stage)

    def _stand_down(self, reason: str) -> None:
        if self._power.armed:
            self._machine.fire(Trigger.STOP, reason)
            self._log.say(Note(level="info", text=self._power.stand_down()))

    def _ask(self, stage: OperatorStage) -> None:
        self._stand_down("the drive is disarmed while the operator is asked")
        self._machine.fire(Trigger.ASK_OPERATOR)
        self._questions.put(stage.prompt, answered=stage.answer is not None)
        if stage.brake is not None:
            self._power.set_brake(stage.brake == "engage")

    def _measure(self, index: int, stage: MeasuringStage) -> None:
        left = self._agenda.points_left(index)
        if left:
            self._log.say(StageStarted(index=index, stage=stage.kind, points=len(left)))
            self._machine.fire(STAGE_TRIGGERS[stage.kind])
            self._power.arm()
            left = self._within_limits(index, left)
        for point in left:
            if self._interrupts.pause_wanted:
                self._pause(stage)
            self._measure_point(point)
        if isinstance(stage, LockCheckStage) and not self._agenda.passed(index):
            self._judge_lock(stage, self._agenda.plan.points_of(index))

    def _within_limits(self, index: int, left: list[PlannedPoint]) -> list[PlannedPoint]:
        """The points with their injection as weak as the ripple at the rim makes necessary."""
        factor = self._agenda.factor(index)
        if factor is None:
            factor = self._probe.factor(left)
            if factor < 1.0:
                told = (
                    f"the ripple at the rim is stronger than the nameplate says: injection at {factor:.0%} of the plan"
                )
                self._log.say(Note(level="info", text=told))
        return [weakened(point, factor) for point in left]

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
        self._agenda.tick_off(point, segment)
        self._log.say(
            PointDone(
                id=point.id,
                stage_index=point.stage_index,
                segment=segment,
                achieved_d_a=achieved_d_a,
                achieved_q_a=achieved_q_a,
                points_done=len(self._agenda.done),
                points=len(self._agenda.plan.points),
                seconds_left=self._agenda.seconds_left,
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
        segments: list[Segment] = [self._agenda.done[point.id] for point in points]
        verdict = judge_lock(
            [(segment, recording.load(segment)) for segment in segments],
            stage.tolerance_rad,
            voltage_delay_samples=self._capabilities.voltage_delay_samples,
        )
        if verdict.locked and verdict.confidence < LEAST_CONFIDENCE:
            verdict = verdict.model_copy(update={"locked": None})
        self._log.say(verdict, durable=True)
        if verdict.locked is None:
            self._trust_the_brake(stage, verdict)
        elif not verdict.locked:
            raise RunAborted(f"the rotor is not locked: {verdict.summary}")

    def _trust_the_brake(self, stage: LockCheckStage, verdict: LockChecked) -> None:
        """What cannot be measured has to be known by a person, here or in the procedure."""
        self._log.say(Note(level="warning", text=f"{verdict.summary}; lock_check.accept_not_known accepts that"))
        self._machine.fire(Trigger.ASK_OPERATOR)
        self._questions.put(NOT_KNOWN, answered=stage.accept_not_known is not None)

    def _compute(self, trigger: Trigger = Trigger.ESTIMATE) -> None:
        """Stand down first: nobody knows how long a computation takes on a machine that is busy."""
        self._stand_down("the drive is disarmed while the computer works on what was measured")
        self._machine.fire(trigger)

    def _recording(self) -> Recording:
        self._run.write_manifest()
        return open_recording(self._run.path)

    def _estimate(self, stage: EstimateStage) -> None:
        from orchestrator.estimation import estimate_recording

        self._compute()
        wanted = [e for e in self._estimators if stage.estimators is None or e.name in stage.estimators]
        try:
            self._summary = estimate_recording(
                self._recording(), wanted, self._run.path, on_estimate=self._say_estimate
            )
        except NotMeasuredError as error:
            self._log.say(Note(level="warning", text=str(error)))

    def _diagnose(self, index: int, stage: DiagnoseStage) -> None:
        self._compute(Trigger.COMPARE)
        recording = self._recording()
        try:
            self._log.say(compared(recording, stage), durable=True)
            self._machine.fire(Trigger.DIAGNOSE)
            found, proposal = diagnosed(
                recording, stage, self._effects, self._agenda.experiments, self._say_step, self._interrupts.check
            )
        except NotMeasuredError as error:
            self._log.say(Note(level="warning", text=f"no diagnosis: {error}"))
            return
        self._log.say(found, durable=True)
        if proposal is not None:
            self._machine.fire(Trigger.PROPOSE)
            self._propose(index, stage, proposal)

    def _propose(self, index: int, stage: DiagnoseStage, proposal: ExperimentProposed) -> None:
        """Append the experiment to the plan, where the stage has rounds left and the limits allow it."""
        longer: tuple[StagesAppended, Plan] | None = None
        if stage.rounds > 0:
            try:
                more = following_stages(stage, proposal.stage, self._agenda.plan.procedure)
                longer = StagesAppended(by=index, stages=more), self._agenda.longer(more)
            except (ProcedureError, CapabilityError) as error:
                self._log.say(Note(level="warning", text=f"the proposed experiment cannot be run here: {error}"))
        self._log.say(proposal.model_copy(update={"accepted": longer is not None}), durable=True)
        if longer is not None:
            self._log.say(longer[0], durable=True)
            self._agenda.append(*longer)

    def _say_step(self, step: DiagnosisStep) -> None:
        self._interrupts.check()
        self._log.say(step)

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
        if self._agenda.done:
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
