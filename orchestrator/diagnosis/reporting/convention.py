"""Report of a diagnosis that inconsistent metadata ended before any fit."""

from __future__ import annotations

from orchestrator.diagnosis.criteria import Criteria
from protocols import Convention, DiagnosisReport, DiagnosisWords, NoiseFloor, Reason, Rung, Unexplained


def convention_report(recording: str, convention: Convention, criteria: Criteria, seconds: float) -> DiagnosisReport:
    """A report without effects, with an empty ladder step."""
    return DiagnosisReport(
        recording=recording,
        noise_floor=NoiseFloor(rms_v=None),
        verdict="convention",
        reasons=(Reason(quantity="convention", value=None, limit=None, sentence=convention.evidence),),
        effects=(),
        traces=(),
        joint=(),
        ladder=(Rung(added=None, chi2=None, rms_v=None, heldout_rms_v=None, current_rms_a=None),),
        unexplained=Unexplained(fraction=None, shape=()),
        next_experiment=None,
        convention=convention,
        seconds=seconds,
        criteria=criteria.model_dump(mode="json"),
    )


def convention_words(convention: Convention) -> DiagnosisWords:
    """The finding as text."""
    return DiagnosisWords(
        where_it_fails="in the manifest or the logging, before any model",
        what_it_looks_like=convention.evidence,
        likely_cause=f"{convention.what}; no effect of physics was looked for",
        if_added="nothing was fitted",
        to_decide=convention.correction.text,
    )
