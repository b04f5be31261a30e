"""Hold the model against what has been measured, name what it lacks, and measure what tells more."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from orchestrator.recording import Recording
from orchestrator.stages import parse_stage
from plugins.stages.estimate import DIAGNOSIS, EstimateStage
from plugins.stages.operator import OperatorStage
from protocols import (
    CapabilityError,
    Compared,
    Diagnosed,
    DiagnosisStep,
    ExperimentProposed,
    MapEstimated,
    Note,
    NotMeasuredError,
    PluginUse,
    Procedure,
    ProcedureError,
    ResistanceEstimated,
    Stage,
    StageEntry,
    StageRun,
    StageState,
    UnderWay,
)

if TYPE_CHECKING:
    from orchestrator.diagnosis import Diagnosis, InterimResult

COMPARING = StageState("comparing", "compare")
DIAGNOSING = StageState("diagnosing", "diagnose", after=COMPARING.name)
PROPOSING = StageState("proposing", "propose", after=DIAGNOSING.name)

MAGNETIC = ("saturation", "cross_saturation")
"""Rungs of a diagnosis that are no plugins."""


class DiagnoseStage(Stage):
    """Hold the model against what has been measured so far, and name what it lacks; disarmed meanwhile.

    Where two effects are indistinguishable and `rounds` allows it, the experiment that separates them is measured
    (a stage more, of the run's own recording), the estimators run anew, and so does the diagnosis.
    """

    name = DIAGNOSIS
    title = "diagnosis"
    working = (COMPARING, DIAGNOSING, PROPOSING)

    model: Literal["saturated", "linear"] = "saturated"
    without: tuple[str, ...] = ()
    """Effects taken out of the library."""
    rounds: Annotated[int, Field(ge=0, le=10)] = 0
    """Most proposed experiments that may follow."""

    def uses(self) -> Sequence[PluginUse]:
        left_out = [(k, name) for k, name in enumerate(self.without) if name not in MAGNETIC]
        return (PluginUse("effects", None), *(PluginUse("effects", name, f"without.{k}") for k, name in left_out))

    def work(self, run: StageRun) -> None:
        run.enter(COMPARING)
        recording = run.recording()
        assert isinstance(recording, Recording)  # results are kept beside it
        try:
            run.publish(compared(recording, self), durable=True)
            run.enter(DIAGNOSING)
            diagnosis, proposal = diagnosed(recording, self, run)
        except NotMeasuredError as error:
            run.publish(Note(level="warning", text=f"no diagnosis: {error}"))
            return
        run.publish(diagnosis, durable=True)
        if proposal is not None:
            run.enter(PROPOSING)
            self._propose(run, proposal)

    def _propose(self, run: StageRun, proposal: ExperimentProposed) -> None:
        """Append the experiment to the run, where the stage has rounds left and the limits allow it."""
        more: Sequence[StageEntry] = ()
        if self.rounds > 0:
            try:
                more = self.following(proposal.stage, run.procedure)
                run.plan(more)
            except (ProcedureError, CapabilityError) as error:
                more = ()
                run.publish(Note(level="warning", text=f"the proposed experiment cannot be run here: {error}"))
        run.publish(proposal.model_copy(update={"accepted": bool(more)}), durable=True)
        if more:
            run.append(more)

    def following(self, experiment: dict[str, Any], procedure: Procedure) -> tuple[StageEntry, ...]:
        """What a run goes on with after a proposal: the experiment, the estimators anew, and one diagnosis more.

        Raises
        ------
        ProcedureError
            Where the experiment is no stage of a procedure.
        """
        again = [entry for entry in procedure.stages if entry.kind == EstimateStage.name][-1:]
        measured = parse_stage(experiment, procedure.name, "next_experiment")
        return (measured.entry(), *again, self.model_copy(update={"rounds": max(self.rounds - 1, 0)}).entry())

    def going_on(self, experiment: dict[str, Any], procedure: Procedure, rounds: int) -> tuple[StageEntry, ...]:
        """What to append to a finished run: is the rotor still held, and what `following` says."""
        more = self.model_copy(update={"rounds": rounds}).following(experiment, procedure)
        return (_lock_question(procedure).entry(), *more)


def compared(recording: Recording, stage: DiagnoseStage) -> Compared:
    """The bare model that the ladder starts from, held against the recording; `NotMeasuredError` on too little."""
    from orchestrator.diagnosis import compare_recording

    return Compared(report=compare_recording(recording, model=stage.model))


def diagnosed(recording: Recording, stage: DiagnoseStage, run: StageRun) -> tuple[Diagnosed, ExperimentProposed | None]:
    """The diagnosis, written to the recording's results, and the experiment that it asks for, not accepted yet.

    Raises
    ------
    NotMeasuredError
        Where the recording holds too little.
    """
    from orchestrator.diagnosis import diagnose_and_keep, workers_here
    from orchestrator.experiment_design.proposal import next_experiment

    def publish_step(step: DiagnosisStep) -> None:
        run.check()
        run.publish(step)

    waiting = _Waiting(run)

    diagnosis, kept = diagnose_and_keep(
        recording,
        run.plugins("effects"),
        propose=next_experiment,
        model=stage.model,
        without=stage.without,
        on_step=publish_step,
        poll=run.check,
        tell=waiting.tell,
        on_interim=waiting.keep,
        workers=workers_here(),
    )
    publish_model(run, diagnosis)
    message = Diagnosed(round=run.appended, report=kept.report, words=kept.words)
    experiment = diagnosis.report.next_experiment
    if experiment is None:
        return message, None
    return message, ExperimentProposed(**experiment.model_dump(), round=run.appended, accepted=False)


def publish_model(run: StageRun, diagnosis: Diagnosis) -> None:
    """Hand over R_s and the map of the diagnosed model, which replace the estimators' where they are recommended."""
    from orchestrator.estimation import estimate_of_map

    estimates, delivery = diagnosis.estimates, diagnosis.delivery
    if estimates is None:
        return
    run.conclude(estimates)
    if delivery is not None and estimates.method == delivery.map.method:
        if estimates.resistance is not None:
            run.publish(ResistanceEstimated(estimate=estimates.resistance))
        why = {"remarks": tuple(check.remark for check in estimates.checks)}
        run.publish(MapEstimated(estimate=estimate_of_map(delivery.map, estimates).model_copy(update=why)))


class _Waiting:
    """Lets the streams say what a search is doing, once a second at most, and what it has found so far."""

    def __init__(self, run: StageRun, clock: Callable[[], float] = time.monotonic) -> None:
        self._run, self._clock, self._next_s = run, clock, -math.inf

    def tell(self, text: str) -> None:
        if self._clock() >= self._next_s:
            self._next_s = self._clock() + 1.0
            self._run.publish(UnderWay(text=text))

    def keep(self, result: InterimResult) -> None:
        self._run.publish(UnderWay(text=result.sentence, is_result=True))


def _lock_question(procedure: Procedure) -> OperatorStage:
    """Is the rotor where the alignment left it? The procedure's own answer counts, where it has one."""
    questions = [entry.settings for entry in procedure.stages if entry.kind == OperatorStage.name]
    about_the_lock = [settings for settings in questions if settings.get("brake") == "engage"] or questions
    answer = about_the_lock[-1].get("answer") if about_the_lock else None
    prompt = "Has the rotor been held ever since the run was measured, and is its brake (or lock) still engaged?"
    return OperatorStage(prompt=prompt, answer=answer)
