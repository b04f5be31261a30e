"""Explanation of a diagnosis from its report: reasons, search and evidence."""

from __future__ import annotations

from protocols import DiagnosisReport, EffectBasis, Explanation, SearchEvent


def explanation_of(report: DiagnosisReport) -> Explanation:
    """The verdict with its reasons, the search, and the evidence of each named effect."""
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
                material=effect.material,
                twins=effect.twins,
                steps=tuple(event.step for event in report.search if _supports(event, effect.name)),
            )
            for effect in report.effects
        ),
    )


def _supports(event: SearchEvent, name: str) -> bool:
    """Whether a move added, kept or named an effect."""
    if event.move == "remove":
        return event.decision == "refused" and name in event.effects
    if event.move in ("swap", "merge"):
        wins = event.effects[:1] if event.decision == "taken" else event.effects[1:]
        return name in wins
    return event.decision == "taken" and name in event.effects
