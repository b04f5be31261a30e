"""Explanation of a diagnosis from its report: reasons, search and evidence."""

from __future__ import annotations

from orchestrator.diagnosis.fitting.candidates import MAP_RUNGS
from orchestrator.formatting.names import plain
from orchestrator.formatting.results import effect_notes, mutual_twins
from protocols import DiagnosisReport, EffectBasis, Explanation, MotorModel, SearchEvent


def explanation_of(report: DiagnosisReport, model: MotorModel | None = None) -> Explanation:
    """The verdict with its reasons, the search, and the evidence of each named effect.

    Parameters
    ----------
    model : MotorModel, optional
        The recording's model as it is now.
    """
    twins = mutual_twins(report.effects)
    apart = [remark.text for remark in report.remarks if remark.code == "separated"]
    return Explanation(
        recording=report.recording,
        verdict=report.verdict,
        reasons=report.reasons,
        verdict_record=report.verdict_record,
        search=report.search,
        effects=tuple(
            EffectBasis(
                name=effect.name,
                relative_size=effect.relative_size,
                log_evidence=effect.log_evidence,
                probability=effect.probability,
                share=effect.share,
                share_in=effect.share_in,
                material=effect.material,
                twins=twins[effect.name],
                steps=tuple(event.step for event in report.search if _supports(event, effect.name)),
            )
            for effect in report.effects
        ),
        notes=(*effect_notes(report), *apart),
        model_changes=() if model is None else model_changes(report, model),
    )


def model_changes(report: DiagnosisReport, model: MotorModel) -> tuple[str, ...]:
    """Effects that were added to a diagnosed model since, or removed: ``+ dead time (does not help)``."""
    before, names = _diagnosed_effects(report), [effect.name for effect in model.effects]
    if before is None:
        return ()
    useless = {effect.name for effect in model.effects if effect.helps is False}
    added = [f"+ {plain(n)}{' (does not help)' * (n in useless)}" for n in names if n not in before]
    return (*added, *(f"− {plain(n)}" for n in before if n not in names))


def removed_effects(report: DiagnosisReport, model: MotorModel) -> tuple[str, ...]:
    """Names of the diagnosis' effects that the model lacks."""
    names = {effect.name for effect in model.effects}
    return tuple(name for name in _diagnosed_effects(report) or () if name not in names)


def _diagnosed_effects(report: DiagnosisReport) -> tuple[str, ...] | None:
    """The effects of the diagnosed model; None of a file of an older version, which does not have them."""
    rungs, record = report.ladder, report.verdict_record
    before = (rungs[-1].effects if rungs else ()) or tuple(record.effect_widths if record is not None else ())
    return None if {effect.name for effect in report.effects} - {*before, *MAP_RUNGS} else before


def _supports(event: SearchEvent, name: str) -> bool:
    """Whether a move added, kept or named an effect."""
    if event.move == "remove":
        return event.decision == "rejected" and name in event.effects
    if event.move in ("swap", "merge"):
        wins = event.effects[:1] if event.decision == "accepted" else event.effects[1:]
        return name in wins
    return event.decision == "accepted" and name in event.effects
