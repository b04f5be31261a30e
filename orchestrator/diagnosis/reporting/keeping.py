"""A diagnosis with its text and figures, saved in the results of a run or recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from orchestrator.diagnosis._diagnose import Diagnosis, Proposer, diagnose_recording
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.reporting.delivery import Delivery
from orchestrator.diagnosis.reporting.diagnosis_file import SavedDiagnosis, save_diagnosis
from orchestrator.diagnosis.reporting.words import in_words
from orchestrator.diagnosis.selection.first_models import ModelChoice
from orchestrator.diagnosis.selection.search_state import InterimResult
from orchestrator.recording import Recording
from protocols import DiagnosisStep, Effect, EstimationReport, Remark, StorageError
from protocols.fleet_priors import FleetPriors


def deliver(delivery: Delivery, recording: Recording, out: Path | None) -> EstimationReport:
    """Add a fit's map and R_s to the results of a run or recording; raises `StorageError`."""
    from orchestrator.estimation import deliver_model  # which knows the diagnosis too

    return deliver_model(
        out or recording.path,
        delivery.map,
        delivery.resistance,
        delivery.objections,
        manifest=recording.manifest,
        title=delivery.title,
    )


def diagnose_and_keep(
    recording: Recording,
    effects: Sequence[Effect],
    *,
    propose: Proposer | None,
    model: ModelChoice = "saturated",
    without: Sequence[str] = (),
    out: Path | None = None,
    on_step: Callable[[DiagnosisStep], None] | None = None,
    poll: Callable[[], None] = lambda: None,
    tell: Callable[[str], None] = lambda _: None,
    criteria: Criteria | None = None,
    priors: FleetPriors | None = None,
    workers: int = 1,
    on_interim: Callable[[InterimResult], None] = lambda _: None,
    report_early: bool = False,
) -> tuple[Diagnosis, SavedDiagnosis]:
    """`diagnose_recording`, saved in ``results/``: ``diagnosis.json``, ``diagnosis.npz`` and the model's map.

    Where that cannot be written (a read-only disk), a remark is added instead.

    Parameters
    ----------
    propose : callable or None
        Chooses the next experiment; None for no proposal.
    on_step : callable, optional
        Called with each step of the ladder; an exception ends the diagnosis.
    poll : callable
        Called several times a second; an exception ends the diagnosis.
    tell : callable
        Called with a short description of the current operation.
    on_interim : callable
        Called with the interim result of the search whenever it has changed.
    report_early : bool
        `KeyboardInterrupt` only ends the search; see `diagnose_recording`.
    out : Path, optional
        Directory for `model.json` and the folder ``results``; the recording's by default.
    """
    steps: list[DiagnosisStep] = []

    def keep(step: DiagnosisStep) -> None:
        # A ladder that is shown again replaces the earlier one.
        del steps[step.index :]
        steps.append(step)
        if on_step is not None:
            on_step(step)

    diagnosis = diagnose_recording(
        recording,
        effects,
        propose=propose,
        model=model,
        without=without,
        out=out,
        on_step=keep,
        poll=poll,
        tell=tell,
        criteria=criteria,
        priors=priors,
        workers=workers,
        on_interim=on_interim,
        report_early=report_early,
    )
    words = in_words(diagnosis)
    try:
        save_diagnosis(out or recording.path, diagnosis.report, words, steps)
        if diagnosis.delivery is not None:
            diagnosis = replace(diagnosis, estimates=deliver(diagnosis.delivery, recording, out))
    except StorageError as error:
        remark = Remark.of("not_written", "{problem}", problem=str(error))
        diagnosis = replace(diagnosis, report=diagnosis.report.with_remark(remark))
    return diagnosis, SavedDiagnosis(diagnosis.report, words, tuple(steps), diagnosis.estimates)
