"""Holds the model against what a run has measured, and says what that leaves to be measured. Decides nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter, ValidationError

from protocols import (
    Compared,
    Diagnosed,
    DiagnoseStage,
    DiagnosisStep,
    Effect,
    EstimateStage,
    ExperimentProposed,
    Procedure,
    ProcedureError,
    Stage,
)

if TYPE_CHECKING:
    from orchestrator.recording import Recording
    from protocols import DiagnosisReport


def compared(recording: Recording, stage: DiagnoseStage) -> Compared:
    """The bare model that the ladder starts from, held against the recording.

    Raises
    ------
    NotMeasuredError
        Where the recording holds too little.
    """
    from orchestrator.diagnosis import compare_recording

    return Compared(report=compare_recording(recording, model=stage.model))


def diagnosed(
    recording: Recording,
    stage: DiagnoseStage,
    effects: Sequence[Effect],
    number: int,
    on_step: Callable[[DiagnosisStep], None],
    poll: Callable[[], None],
) -> tuple[Diagnosed, ExperimentProposed | None]:
    """The diagnosis of the recording, written to its results, and the experiment that it asks for, not accepted yet.

    Parameters
    ----------
    number : int
        How many proposed experiments are in the recording.
    on_step : callable
        Told each rung of the ladder as it is reached; what it raises ends the diagnosis.
    poll : callable
        Called several times a second; what it raises ends the diagnosis.

    Raises
    ------
    NotMeasuredError
        Where the recording holds too little.
    """
    from orchestrator.diagnosis import diagnose_and_keep

    diagnosis, kept = diagnose_and_keep(
        recording, effects, model=stage.model, without=stage.without, on_step=on_step, poll=poll
    )
    message = Diagnosed(round=number, report=kept.report, words=kept.words)
    return message, _proposal(diagnosis.report, number)


def _proposal(report: DiagnosisReport, number: int) -> ExperimentProposed | None:
    found = report.next_experiment
    return None if found is None else ExperimentProposed(**found.model_dump(), round=number, accepted=False)


def following_stages(stage: DiagnoseStage, experiment: dict[str, Any], procedure: Procedure) -> tuple[Stage, ...]:
    """What a run goes on with after a proposal: the experiment, the estimators anew, and one diagnosis more.

    Raises
    ------
    ProcedureError
        Where the experiment is no stage of a procedure.
    """
    again = [s for s in procedure.stages if isinstance(s, EstimateStage)][-1:]
    return (
        _stage_of(experiment, procedure.name),
        *again,
        stage.model_copy(update={"rounds": max(stage.rounds - 1, 0)}),
    )


def _stage_of(experiment: dict[str, Any], where: str) -> Stage:
    """The stage that a diagnosis proposes, validated; raises `ProcedureError` where it is none."""
    try:
        stage: Stage = TypeAdapter[Any](Stage).validate_python(experiment)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise ProcedureError(where, f"next_experiment.{place}", first["msg"]) from None
    return stage
