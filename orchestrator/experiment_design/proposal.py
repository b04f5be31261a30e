"""The experiment that separates two effects, as a stage for a procedure.

Every stage of the catalogue of contrasts is rated by the separation that the fitted model predicts, in chi2 per minute,
for built-in and third-party effects alike, at the sizes that the recording found. Where nothing can be predicted, the
contrast that both effects declare as needed decides.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import INTERVAL_SIGMAS
from orchestrator.diagnosis.selection.contrasts import SAME_CURRENT, holds, needed_contrasts
from orchestrator.diagnosis.selection.scoring import linear_view, score
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.experiment_design.contrasts import STAGES, Bench, Stage, minutes, round_for_people
from orchestrator.experiment_design.separation import ConfoundedPair, confounded_pair, separation
from orchestrator.numerics.frames import to_dq
from protocols import Contrast, Inseparable, Interval, NextExperiment, SegmentStage

MAX_LENGTHENING: float = 3.0
"""Largest factor of the separation that longer readings of a stage are proposed for; they last its square as long."""
LENGTHENING_MARGIN: float = 1.3
"""Factor of the duration beyond what the prediction requires."""


def next_experiment(
    setup: DiagnosisSetup, fit: Fit, library: Sequence[CandidateEffect], first: str, second: str
) -> NextExperiment | Inseparable | None:
    """The experiment for a pair of effects; `Inseparable` where no stage is predicted to separate them enough.

    None where nothing can be predicted and no stage measures what both need, or where an operator can measure it, as
    at a second angle.

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
    pair, separates = confounded_pair(setup, fit, active, named[second]), (first, second)
    if pair is None:
        stage = _needed(setup, named[first], named[second])
        if stage is None:
            return None
        return NextExperiment(stage=stage, separates=separates, minutes=round(minutes(stage), 2))
    least = math.sqrt(setup.prepared.criteria.design.least_separation)
    stages = _candidates(setup, named[first], named[second])
    fresh = [stage for stage in stages if not is_measured(setup, stage)]
    rated = [(_sigmas(setup, pair, stage), stage) for stage in fresh]
    sufficient = [(sigmas, stage) for sigmas, stage in rated if sigmas > least]
    if not sufficient:
        longer = [_lengthened(stage, least / sigmas) for sigmas, stage in rated if least < MAX_LENGTHENING * sigmas]
        rated += [(_sigmas(setup, pair, stage), stage) for stage in longer]
        sufficient = [(sigmas, stage) for sigmas, stage in rated if sigmas > least]
    if not sufficient:
        if _needs_operator(setup, named[first], named[second]):
            return None
        best = max((sigmas for sigmas, _ in rated), default=0.0)
        has_measured = len(fresh) < len(stages) and active in fit.model.active
        reached = _reached_sigmas(setup, fit, pair) if has_measured else None
        return Inseparable(separates=separates, best_sigmas=best, least_sigmas=least, reached_sigmas=reached)
    sigmas, stage = max(sufficient, key=lambda item: item[0] ** 2 / minutes(item[1]))
    return NextExperiment(
        stage=stage,
        separates=separates,
        minutes=round(minutes(stage), 2),
        sigmas=_interval(sigmas, _relative_std(fit, active)),
        least_sigmas=least,
    )


def is_measured(setup: DiagnosisSetup, stage: Stage) -> bool:
    """Whether the recording holds a stage's points with its settings, for whatever time."""
    pieces = [p for p in setup.prepared.pieces if p.stage is SegmentStage(stage["kind"])]
    if "points_a" not in stage:
        return bool(pieces)
    means = np.array([to_dq(p.signals.i_ab, p.segment.rotor_angle_rad).mean(axis=0) for p in pieces])
    names = {"pwm_frequencies_hz": "pwm_frequency_hz", "amplitudes_v": "amplitude_v"}
    lists = {names[name]: stage[name] for name in names if name in stage}
    single = {"frequency_hz": stage["frequency_hz"]} if "frequency_hz" in stage else {}
    values = [dict(zip(lists, chosen, strict=True)) for chosen in product(*lists.values())]
    return all(
        any(
            math.dist(mean, point) < SAME_CURRENT * setup.current_a and _has(piece, {**single, **settings})
            for piece, mean in zip(pieces, means, strict=True)
        )
        for point in stage["points_a"]
        for settings in values
    )


def _has(piece: SegmentData, settings: Mapping[str, float]) -> bool:
    """Whether a segment was measured with these settings."""
    of_segment = {**piece.segment.settings, "pwm_frequency_hz": piece.signals.pwm_frequency_hz}
    return all(math.isclose(float(of_segment.get(name) or 0.0), x, rel_tol=0.01) for name, x in settings.items())


def _reached_sigmas(setup: DiagnosisSetup, fit: Fit, pair: ConfoundedPair) -> float:
    """Separation of the two effects by the recording: how much worse the second one fits in the first one's place."""
    in_place = setup.fitter.fit(pair.model, fit.linearisation)
    return math.sqrt(max(in_place.objective - fit.objective, 0.0) / max(fit.chi2_per_dof, 1.0))


def _sigmas(setup: DiagnosisSetup, pair: ConfoundedPair, stage: Stage) -> float:
    """Predicted separation by a stage in standard deviations; 0 where it cannot be predicted."""
    gain = separation(setup, pair, stage)
    return math.sqrt(max(gain, 0.0)) if math.isfinite(gain) else 0.0


def _lengthened(stage: Stage, factor: float) -> Stage:
    """The stage with readings so long that its separation grows by a factor, and a margin; chi2 grows with the time."""
    return {**stage, "duration_s": round_for_people(LENGTHENING_MARGIN * factor**2 * float(stage["duration_s"]))}


def _relative_std(fit: Fit, active: EffectTerm) -> float:
    """Relative standard deviation of an effect's size in the fit; 0 where it is not in the model."""
    which = [k for k, (a, n) in enumerate(fit.model.free) if a.name == active.name and n in a.candidate.amplitudes]
    x = np.array([active.standardised_value(fit.model.free[k][1]) for k in which])
    if not len(x):
        return 0.0
    covariance = fit.covariance(max(fit.chi2_per_dof, 1.0))[np.ix_(which, which)]
    return float(math.sqrt(x @ covariance @ x) / (x @ x))


def _interval(sigmas: float, relative_std: float) -> Interval:
    """The separation with its 95 % interval: it is proportional to the size, and measured with a deviation of one."""
    half = INTERVAL_SIGMAS * math.hypot(relative_std * sigmas, 1.0)
    return Interval(value=sigmas, low=max(sigmas - half, 0.0), high=sigmas + half, unit="1")


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


def _candidates(setup: DiagnosisSetup, first: CandidateEffect, second: CandidateEffect) -> list[Stage]:
    """The stages that may separate two effects: of a contrast that both need and the recording lacks, else all.

    Without that contrast the two count as indistinguishable, whatever another stage adds.
    """
    bench = Bench.of(setup)
    return [stage for c in _lacking(setup, first, second) for stage in STAGES[c](bench)] or catalogue(setup)


def _needed(setup: DiagnosisSetup, first: CandidateEffect, second: CandidateEffect) -> Stage | None:
    """The first stage for a contrast that both effects need and the recording lacks."""
    lacking = _lacking(setup, first, second)
    return next((stage for contrast in lacking for stage in STAGES[contrast](Bench.of(setup))), None)


def _needs_operator(setup: DiagnosisSetup, first: CandidateEffect, second: CandidateEffect) -> bool:
    """Whether the recording lacks a contrast that both effects need and that no stage measures by itself."""
    return any(not STAGES[contrast](Bench.of(setup)) for contrast in _lacking(setup, first, second))


def _lacking(setup: DiagnosisSetup, first: CandidateEffect, second: CandidateEffect) -> list[Contrast]:
    return [c for c in needed_contrasts(first.effect, second.effect) if not holds(setup.prepared, c)]
