"""The experiment that separates two effects, as a stage for a procedure.

Every stage of the catalogue of contrasts is rated by the separation that the fitted model predicts, in chi2 per minute,
for built-in and third-party effects alike. Where no stage separates enough, the contrast that both effects declare as
needed decides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.contrasts import holds, separating_contrasts
from orchestrator.diagnosis.selection.scoring import linear_view, score
from orchestrator.experiment_design.contrasts import STAGES, Bench, Stage, minutes
from orchestrator.experiment_design.separation import confounded_pair, separation
from protocols import NextExperiment


def next_experiment(
    setup: DiagnosisSetup, fit: Fit, library: Sequence[CandidateEffect], first: str, second: str
) -> NextExperiment | None:
    """The experiment for a pair of effects; None where no stage of a procedure can separate them.

    Parameters
    ----------
    setup : DiagnosisSetup
    fit : Fit
        A fit, with or without the first effect.
    library : sequence of CandidateEffect
        Contains both effects.
    first, second : str
        Names of the effects.
    """
    named = {candidate.name: candidate for candidate in library}
    active = next((a for a in fit.model.active if a.name == first), None) or _suspected(setup, fit, named[first])
    stage = _predicted(setup, fit, active, named[second]) or _needed(setup, named[first], named[second])
    if stage is None:
        return None
    return NextExperiment(stage=stage, separates=(first, second), minutes=round(minutes(stage), 2))


def catalogue(setup: DiagnosisSetup) -> list[Stage]:
    """Stages that the drive of the recording can measure, short ones first."""
    bench = Bench.of(setup)
    return [stage for stages in STAGES.values() for stage in stages(bench)]


def _suspected(setup: DiagnosisSetup, fit: Fit, candidate: CandidateEffect) -> EffectTerm:
    """An effect that is not in the model, with the amplitude that it would have there to first order."""
    active = candidate.absent()
    estimate = score(linear_view(setup.fitter, fit, [candidate]))[0]
    for name, x in zip(candidate.amplitudes, estimate.coordinates, strict=True):
        active = active.moved(name, float(x))
    return active


def _predicted(setup: DiagnosisSetup, fit: Fit, first: EffectTerm, second: CandidateEffect) -> Stage | None:
    """The stage of most separation per minute; None where none separates enough."""
    pair = confounded_pair(setup, fit, first, second)
    if pair is None:
        return None
    gains = [(separation(setup, pair, stage), stage) for stage in catalogue(setup)]
    limit = setup.prepared.criteria.design.least_separation
    sufficient = [(gain / minutes(stage), stage) for gain, stage in gains if math.isfinite(gain) and gain > limit]
    return max(sufficient, key=lambda item: item[0])[1] if sufficient else None


def _needed(setup: DiagnosisSetup, first: CandidateEffect, second: CandidateEffect) -> Stage | None:
    """The first stage for a contrast that both effects need and the recording lacks."""
    lacking = [c for c in separating_contrasts(first.effect, second.effect) if not holds(setup.prepared, c)]
    return next((stage for contrast in lacking for stage in STAGES[contrast](Bench.of(setup))), None)
