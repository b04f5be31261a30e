"""Moves of what surrounds the effects: the map's grid, variance components, a modulator's timer."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from orchestrator.diagnosis.fitting.baseline import (
    MAX_CHI2_FOR_FINER_MAP,
    DiagnosisSetup,
    has_fine_grid,
    is_finer_map_justified,
    map_log_evidence,
    on_usual_grid,
    with_finest_map,
    with_kink_switched,
)
from orchestrator.diagnosis.fitting.candidates import Library
from orchestrator.diagnosis.fitting.chords import MIN_JOINT_GAIN, fit_with_frozen_jacobian
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.nuisances.command_traces import command_traces
from orchestrator.diagnosis.nuisances.quantiser_beside_fit import quantiser_beside
from orchestrator.diagnosis.nuisances.quantiser_in_dwells import quantiser_of_dwells
from orchestrator.diagnosis.nuisances.quantiser_search import detect_quantisation
from orchestrator.diagnosis.nuisances.segment_scatter import (
    MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH,
    likelihood_of,
    with_scatter,
)
from orchestrator.diagnosis.selection.search_state import Move, SearchState
from orchestrator.formatting.names import plain
from protocols import SearchMove


def noise_moves(state: SearchState, library: Library) -> Iterator[Move]:
    """Count segment scatter as noise; in a joint model of a part, estimate the modulator's timer anew."""
    if not state.fitter.noise.of_model.scatters:
        yield Move("noise", (), partial(_count_scatter, state, library), is_once=True)
    if state.setup.quantisers and state.is_joint and state.is_part:
        yield Move("quantiser", (), partial(_estimate_quantiser, state, library))


def _count_scatter(state: SearchState, library: Library) -> SearchState | None:
    # On the whole, an unresolved quantiser or drifting sensor offsets may be the only misfit beside the effects.
    max_chi2 = 1.0 + MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH if state.is_part else math.inf
    wider = with_scatter(state.setup, state.fitter, state.fit, library, max_chi2=max_chi2)
    after = None if wider is None else replace(state, setup=wider)
    fit = None if after is None else after.minimum(state.fit.model)
    state.record("noise", (), fit, None, None, taken=after is not None)
    return None if after is None or fit is None else after.after(fit)


def _estimate_quantiser(state: SearchState, library: Library) -> SearchState | None:
    estimate = refine_quantiser_by_fit(state.setup, state.fit, library)
    if estimate is None:
        return None
    setup, fit = estimate
    gain = state.fit.objective - fit.objective
    state.record("quantiser", (), fit, gain, 0.0, measure="objective", taken=gain > 0.0)
    return replace(state, setup=setup).after(fit) if gain > 0.0 else None


def map_moves(state: SearchState) -> Iterator[Move]:
    """Refine the map: a missing effect may have hidden the gain of a finer one.

    Where a map may be what is left, it is tried again for each set of effects.
    """
    fit = state.fit
    if fit.model.active and fit.model.space.is_free:
        effects = fit.model.names if fit.chi2_per_dof < MAX_CHI2_FOR_FINER_MAP else ()
        yield Move("finer_map", effects, partial(_refine_map, state), is_once=True)


def first_map_moves(state: SearchState, best: Move | None) -> Iterator[Move]:
    """Refine the map, or make the best other move: whichever lowers the objective by more.

    It is tried once for each set of effects: a trial takes some ten fits, which a search of many samples cannot afford
    after each freed shape.
    """
    if state.fit.model.space.is_free:
        yield Move("finer_map", ("first", *state.fit.model.names), partial(_refine_map_or, state, best), is_once=True)


def _refine_map_or(state: SearchState, best: Move | None) -> SearchState | None:
    other = None if best is None else best.make()
    if best is None or other is None:
        return _refine_map(state)
    finer = _refine_map(state, state.fit.objective - other.fit.objective, f"in place of the {plain(best.kind)} before")
    return finer or other


def _refine_map(state: SearchState, min_gain: float = 0.0, note: str = "") -> SearchState | None:
    # There are many maps to try: those of a joint model are compared with the effects fixed.
    fit = (
        state.fitter.fit(with_fixed_effects(state.fit.model), state.fit.linearisation) if state.is_joint else state.fit
    )
    finer = with_finest_map(state.setup, state.fitter, fit)
    if finer is fit:
        state.record("finer_map", (), None, None, None, taken=False)
        return None
    if state.is_joint:
        finer = state.minimum(finer.model.with_active(state.fit.model.active), finer)
    gain = state.fit.objective - finer.objective
    taken = gain > min_gain
    state.record("finer_map", (), finer, gain, min_gain, measure="objective", taken=taken, note=note if taken else "")
    return state.after(finer) if taken else None


def kink_moves(state: SearchState) -> Iterator[Move]:
    """Give the map a kink at i_q = 0, or take it away.

    On a smooth map a play about zero torque imitates iron that saturates from zero flux on. A large misfit is a missing
    effect, to which a kink would adapt.
    """
    space = state.fit.model.space
    may_be_map = state.fit.chi2_per_dof < MAX_CHI2_FOR_FINER_MAP
    if may_be_map and state.fit.model.active and space.is_free and not state.is_part:
        kind: SearchMove = "coarser_map" if space.grid.kink else "finer_map"
        yield Move(kind, ("kink",), partial(_switch_kink, state, kind), is_once=True)


def _switch_kink(state: SearchState, kind: SearchMove) -> SearchState | None:
    other = with_kink_switched(state.setup, state.fitter, state.fit)
    gain, least = (map_log_evidence(other) - map_log_evidence(state.fit)) / state.noise, state.limits.tie
    note = (
        "the same map without its kink at i_q = 0" if kind == "coarser_map" else "the same map with a kink at i_q = 0"
    )
    state.record(kind, (), other, gain, least, taken=gain > least, note=note)
    return state.after(other) if gain > least else None


def coarser_map_moves(state: SearchState) -> Iterator[Move]:
    """Return to the usual map, where a fine one no longer gains: effects found later may explain what it was for."""
    if state.fit.model.active and has_fine_grid(state.fit) and not state.is_part:
        yield Move("coarser_map", (), partial(_coarsen_map, state))


def _coarsen_map(state: SearchState) -> SearchState | None:
    usual = state.minimum(on_usual_grid(state.setup, state.fit))
    keeps = is_finer_map_justified(state.fit, usual)
    state.record("coarser_map", (), usual, None, None, taken=not keeps)
    return None if keeps else state.after(usual)


def map_for_effect_moves(state: SearchState) -> Iterator[Move]:
    """Put the finest map in the place of an effect, which may have stood for it beside a coarser one."""
    if not state.is_part and has_fine_grid(state.fit):
        for name in state.fit.model.names:
            yield Move("remove", (name, "map"), partial(_map_for_effect, state, name), is_once=True)


def _map_for_effect(state: SearchState, name: str) -> SearchState | None:
    fit = state.fit
    others = [active for active in fit.model.active if active.name != name]
    bare = state.fitter.fit(with_fixed_effects(fit.model.with_active(others)), fit.linearisation)
    finest = with_finest_map(state.setup, state.fitter, bare)
    trial = state.minimum(finest.model.with_active(others), finest)
    gain, least = (map_log_evidence(trial) - map_log_evidence(fit)) / state.noise, -state.limits.log_evidence
    taken = gain >= least
    note = "the finest map in its place" if taken else ""
    state.record("remove", (name,), trial, gain, least, taken=taken, note=note)
    return state.after(trial) if taken else None


def with_fixed_effects(model: Model) -> Model:
    """The model with all effect parameters fixed."""
    return model.with_active([replace(active, free=()) for active in model.active])


MAX_QUANTISER_ROUNDS: int = 4
"""Maximum number of alternating estimates of quantiser and fit."""
MAX_ROUNDS_WITH_QUANTISER: int = 6
"""Relinearisations of the fit in one such round."""
TOLERANCE_WITH_QUANTISER: float = 1e-2
"""Gain of a relinearisation, as a part of the excess chi2, below which that fit ends."""


def with_detected_quantiser(setup: DiagnosisSetup, fit: Fit, library: Library) -> DiagnosisSetup:
    """The setup with voltages rounded by the modulator's timer, where the readings show one.

    For a PWM frequency with dwells only, the timer's phases are estimated beside a fit, all effects adapting.
    """
    prepared = setup.prepared
    setup.fitter.tell("testing whether a modulator's timer rounds the commands")
    resistance_ohm = prepared.manifest.motor.stator_resistance_ohm or 1.0
    quantisers = detect_quantisation(
        command_traces(prepared, (setup.l_d_h, setup.l_q_h), resistance_ohm),
        prepared.manifest.drive.dc_bus_voltage_v,
        prepared.criteria.selection.log_evidence,
    )
    return _by_dwells(replace(setup, quantisers=quantisers), fit, library) if quantisers else setup


def _by_dwells(setup: DiagnosisSetup, fit: Fit, library: Library) -> DiagnosisSetup:
    """The setup with the likeliest timer beside a fit near the readings' estimates."""
    likelihood = likelihood_of(setup.with_quantiser(None).part_fitter, fit, library)
    scatter = likelihood.most_likely((True, True))
    timer, _ = quantiser_of_dwells(setup.part_fitter.prepared, likelihood, scatter, setup.quantisers)
    return setup.with_quantiser(timer)


def refine_quantiser_by_fit(setup: DiagnosisSetup, fit: Fit, library: Library) -> tuple[DiagnosisSetup, Fit] | None:
    """The setup with the timer estimated from all equations of a part's fit, and the fit with it.

    None where there is no timer, no misfit, or no significant gain by another timer.
    """
    limits = fit.criteria.selection
    if not setup.quantisers or fit.chi2_per_dof <= limits.detected_chi2:
        return None
    # Rounding makes the objective discontinuous in the timer's phase: the estimate by dwells is a second start.
    setup.fitter.tell("the modulator's timer, by the voltages that hold the currents")
    beside = _by_dwells(setup, fit, library)
    setup.part_fitter.trace.record("quantiser", before=fit, taken=True, note="estimated from the dwells")
    starts = (setup, fit), (beside, beside.part_fitter.relinearise(fit.model))
    timed, sharper = min(starts, key=lambda start: start[1].objective)
    gained = fit.objective - sharper.objective
    for turn in range(MAX_QUANTISER_ROUNDS):
        timed.fitter.tell("the modulator's timer, by all that the effects leave")
        timer, gain = quantiser_beside(sharper, timed.quantisers, timed.fitter.pm_flux_wb)
        gained += gain if turn == 0 else 0.0
        timed = timed.with_quantiser(timer)
        sharper = fit_with_frozen_jacobian(
            timed.part_fitter,
            sharper.model,
            rounds=MAX_ROUNDS_WITH_QUANTISER,
            tolerance=TOLERANCE_WITH_QUANTISER,
            known=sharper,
        )
        if gain < MIN_JOINT_GAIN:
            break
    return None if gained < 2.0 * limits.log_evidence * fit.chi2_per_dof else (timed, sharper)
