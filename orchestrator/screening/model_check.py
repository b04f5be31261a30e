"""The check that a map is that of a model which explains its recording: a part of a diagnosis, for seconds.

A map is usable when the model that made it explains the recording. Estimators take out some effects of their own, each
in its way, whichever the recording has. R_s and a free map are fitted to the recording, and where these do
not explain it, the effects of the library that the score test ranks first, a few at most. The verdict is judged as a
diagnosis judges it. The map is usable where that verdict has no objection, and the estimated map is the model's.

What a few moves do not explain is not judged: the whole search of `fluxbench diagnose` decides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orchestrator.analysis._checks import flux_at, reference_flux_wb
from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, fit_baseline
from orchestrator.diagnosis.fitting.candidates import Library, observable_effects, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.contributions import contributions, mean_currents, rated_flux_wb
from orchestrator.diagnosis.judgement.judge import judge
from orchestrator.diagnosis.judgement.map_band import MapUncertainty
from orchestrator.diagnosis.judgement.sufficiency import solvable
from orchestrator.diagnosis.judgement.verdict import verdict_record
from orchestrator.diagnosis.reporting.delivery import EXPLAINED, objections_to
from orchestrator.diagnosis.reporting.ladder import current_error, noise_rms_v
from orchestrator.diagnosis.selection.adding import added
from orchestrator.diagnosis.selection.environment_moves import noise_moves
from orchestrator.diagnosis.selection.scoring import Score, linear_view, score
from orchestrator.diagnosis.selection.search_state import Move, SearchState, first_accepted
from orchestrator.diagnosis.selection.shape_moves import fixed_parameters, free_moves
from orchestrator.estimation import missing_model, model_check
from orchestrator.formatting.names import plain
from orchestrator.formatting.sentences import listed
from orchestrator.screening.common_gain import common_gain_wb
from orchestrator.screening.rivals import rivals_of
from orchestrator.screening.unequal_gains import UnequalCurrentGains, UnequalVoltageGains
from protocols import (
    Effect,
    FluxMap,
    Judgement,
    MapCriteria,
    NotMeasuredError,
    PluginError,
    RecordingReader,
    Remark,
    UsabilityCheck,
)

MAX_MOVES: int = 5
"""Moves (an effect added, a shape freed, segments' scatter counted as noise) after which a recording is not judged:
two effects, each with a shape, beside scatter. More belong to a search, which also takes back what it added."""


def check_model(
    effects: Sequence[Effect], recording: RecordingReader, flux_map: FluxMap, criteria: MapCriteria
) -> UsabilityCheck:
    """Whether a model of few effects explains a recording, and has the estimated map.

    Parameters
    ----------
    effects : sequence of Effect
        The library that is screened.
    flux_map : FluxMap
        The recommended map.

    Returns
    -------
    UsabilityCheck
        ``model``. Its value is the distance of the map from the model's (rms) and the half width of the model's 95 %
        band together, in per cent of the rated flux. Where the recording is not explained, or is too little for a
        diagnosis, the check was not possible.
    """
    try:
        screened = _screened(recording, effects)
    except (NotMeasuredError, PluginError) as error:
        return missing_model("{problem}", problem=str(error))
    return screened.check(flux_map, criteria)


@dataclass(frozen=True)
class _Screened:
    """The model of few effects, and what is judged of it.

    Attributes
    ----------
    strongest : str or None
        The effect with the largest linear gain beside the first model; None where none has any.
    objections : str
        Why a diagnosis would not deliver this model's map; empty where it would.
    """

    setup: DiagnosisSetup
    fit: Fit
    judgement: Judgement
    band_wb: float
    strongest: str | None
    objections: str

    def check(self, flux_map: FluxMap, criteria: MapCriteria) -> UsabilityCheck:
        verdict, names = self.judgement.verdict, [plain(name) for name in self.fit.model.names]
        if verdict not in EXPLAINED or self.objections:
            why = self.objections or self.judgement.reasons[-1].sentence
            model = f"R_s, a map and {listed(names)} do" if names else "R_s and a map alone do"
            text = f"{model} not explain the recording ({{verdict}}: {{why}})"
            if self.strongest is not None and not names:
                text += "; of the library, {effect} explains most"
            return missing_model(text, verdict=plain(verdict), why=why.rstrip("."), effect=plain(self.strongest or ""))
        currents = mean_currents(self.fit)
        psi = self.fit.model.magnetics.flux_and_inductance(currents)[0]
        off = flux_at(flux_map)(currents) - psi
        off = off[np.isfinite(off).all(axis=1)]
        reference = reference_flux_wb(flux_map, self.setup.prepared.manifest.motor)
        if not len(off) or not reference:
            return missing_model("the estimated map and the model's share no currents")
        off = off - off.mean(axis=0)
        distance, band = (100.0 * x / reference for x in (float(np.sqrt(np.mean(off**2))), self.band_wb))
        return model_check(distance, band, criteria, verdict=plain(verdict), effects=listed(names))


@solvable
def _screened(recording: RecordingReader, effects: Sequence[Effect]) -> _Screened:
    setup = open_for_diagnosis(recording)
    library = observable_effects(
        scaled_library(effects, setup.prepared.manifest), [piece.signals for piece in setup.prepared.pieces]
    )
    first = fit_baseline(setup)
    scores = (
        []
        if first.chi2_per_dof <= first.criteria.selection.detected_chi2
        else score(linear_view(setup.fitter, first, library))
    )
    setup, last = _explaining(setup, first, library)
    uncertainty = MapUncertainty.of(setup.fitter, last, library)
    gains = scaled_library([UnequalCurrentGains(), UnequalVoltageGains()], setup.prepared.manifest)
    rivals = rivals_of(setup.fitter, last, (*library, *gains), uncertainty)
    uncertainty = replace(uncertainty, absent=(*uncertainty.absent, *rivals))
    currents, rated_wb = mean_currents(last), rated_flux_wb(setup)
    band_wb = math.hypot(uncertainty.band_wb(currents), common_gain_wb(last, currents))
    record = verdict_record(
        first,
        setup.fitter.hold(last.model),
        len(last.model.active),
        periodic_lines=sum(not line.switching for line in setup.fitter.noise.lines),
        noise_v=noise_rms_v(last),
        current_error=current_error(last),
        map_error=band_wb / rated_wb,
        hidden_map_error=uncertainty.hidden_wb(currents) / rated_wb,
    )
    judgement = judge(record)
    moved = {name: share.relative_to_flux for name, share in contributions(setup, first, last).items()}
    objections = objections_to(last, judgement.verdict, 100.0 * band_wb / rated_wb, moved)
    objections += _more_than_noise(last)
    return _Screened(
        setup=setup,
        fit=last,
        judgement=judgement,
        band_wb=band_wb,
        strongest=scores[0].candidate.name if scores and scores[0].gain > 0.0 else None,
        objections="; ".join(remark.text for remark in objections),
    )


def _more_than_noise(fit: Fit) -> list[Remark]:
    """An objection where effects leave more than noise: after a few moves that may be an effect which was not tried."""
    if not fit.model.active or fit.chi2_per_dof - 1.0 <= fit.criteria.verdict.noise_accuracy_excess_chi2:
        return []
    return [Remark.of("not_noise", "chi2 {chi2:.3g} per degree of freedom is more than noise", chi2=fit.chi2_per_dof)]


def _explaining(setup: DiagnosisSetup, first: Fit, library: Library) -> tuple[DiagnosisSetup, Fit]:
    """The first model, with the few moves that explain a part of the recording, fitted to the whole."""
    if first.chi2_per_dof <= first.criteria.selection.detected_chi2:
        return setup, first
    part = setup.part_fitter.fit(first.model, relinearisations=0)
    state, tried = SearchState(setup, part, first.chi2_per_dof), set[tuple[object, ...]]()
    for _ in range(MAX_MOVES):
        better = None if state.is_explained else first_accepted(state, _moves(state, library), tried)
        if better is None:
            break
        state = better
    if state.fit is part:
        return setup, first
    return state.setup, state.setup.fitter.fit(state.fit.model, relinearisations=2, tolerance=3e-4)


def _moves(state: SearchState, library: Library) -> Iterator[Move]:
    """The search's cheap moves, the largest predicted gain first."""
    view = linear_view(state.fitter, state.fit, library, fixed_parameters(state.fit.model))
    moves = [*free_moves(state, view, details=False), *_add_moves(state, score(view))]
    yield from sorted(moves, key=lambda move: -move.gain)
    yield from noise_moves(state, library)


def _add_moves(state: SearchState, scores: Sequence[Score]) -> Iterator[Move]:
    """Add one of the effects with the largest linear gain, however small: nothing is named here, only explained."""
    limits, noise = state.limits, max(1.0, (state.fit.chi2 - scores[0].gain) / state.fit.dof) if scores else 1.0
    shortlist = [s for s in scores[: limits.most_trials] if s.gain > 2.0 * limits.log_evidence * noise]
    if shortlist:
        effects = tuple(s.candidate.name for s in shortlist)
        yield Move("add", effects, partial(_with_best, state, shortlist), shortlist[0].gain)


def _with_best(state: SearchState, shortlist: Sequence[Score]) -> SearchState | None:
    best = min((added(state, scored) for scored in shortlist), key=lambda trial: trial.objective)
    grown = state.minimum(best.model, best)
    threshold = 2.0 * state.limits.log_evidence * max(1.0, grown.chi2_per_dof)
    return state.after(grown) if state.fit.objective - grown.objective > threshold else None
