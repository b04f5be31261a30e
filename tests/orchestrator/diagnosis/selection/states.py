"""States of a search over the pieces of a recording."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from orchestrator.diagnosis.fitting.candidates import EffectTerm, Library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.scoring import LinearView, linear_view
from orchestrator.diagnosis.selection.search_state import Move, SearchState
from orchestrator.diagnosis.selection.shape_moves import fixed_parameters
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from protocols import Signals
from tests.orchestrator.diagnosis.pieces import Array, free_model, setup_of


def state_of(maker: Fitter, fit: Fit | None = None, **fields: Any) -> SearchState:
    """The state of a fit, by default of the map alone; part and whole are the same recording."""
    fit = maker.fit(free_model()) if fit is None else fit
    return SearchState(setup_of(maker), fit, fields.pop("first_chi2", fit.chi2_per_dof), **fields)


def joint_state(maker: Fitter, terms: list[EffectTerm]) -> SearchState:
    """A joint model of these effects, fitted."""
    state = state_of(maker, is_joint=True)
    return state.after(state.minimum(state.fit.model.with_active(terms)))


def view_of(state: SearchState, library: Library) -> LinearView:
    return linear_view(state.fitter, state.fit, library, fixed_parameters(state.fit.model))


def made(move: Move) -> SearchState:
    """The state after a move that is above its threshold."""
    after = move.make()
    assert after is not None
    return after


def error_of(active: EffectTerm, signals: Signals) -> Array:
    """What the command has to have on top, so that the signals' own voltage is what the effect leaves of it."""
    error = np.zeros(signals.v_ab.shape)
    for _ in range(5):
        commanded = replace(signals, v_ab=signals.v_ab + error)
        left = np.asarray(active.candidate.effect.correct(commanded, active.parameters).v_ab)
        error = np.asarray(error + signals.v_ab - left, dtype=np.float64)
    return error


def errors_of(active: EffectTerm, prepared: PreparedRecording) -> dict[str, Array]:
    """`error_of` in each segment."""
    return {piece.segment.id: error_of(active, piece.signals) for piece in prepared.pieces}
