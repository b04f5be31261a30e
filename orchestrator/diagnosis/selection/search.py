"""The search: one loop that takes the best move, in a part of the recording and then in the whole.

A model's effects, free shapes, form, grid and nuisances are the state. Every cheap move is predicted on one
linearisation, and the most promising is tried first; a costly move waits until no cheap one is above its threshold.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, with_sharpest_map
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, Library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.adding import add_moves, added, full_model, record_screen
from orchestrator.diagnosis.selection.environment_moves import (
    coarser_map_moves,
    first_map_moves,
    kink_moves,
    map_for_effect_moves,
    map_moves,
    noise_moves,
    with_detected_quantiser,
    with_fixed_effects,
)
from orchestrator.diagnosis.selection.naming import build_ladder, drop_confounded, plain_ladder
from orchestrator.diagnosis.selection.removing import (
    merge_moves,
    other_form_moves,
    remove_moves,
    swap_moves,
    tied_moves,
)
from orchestrator.diagnosis.selection.scoring import gain_of_all, linear_view, redundant_terms, score
from orchestrator.diagnosis.selection.search_state import (
    MAX_SHAPE_ROUNDS,
    AcceptedModel,
    Checkpoint,
    InterimRecorder,
    Move,
    SearchResult,
    SearchState,
    first_accepted,
    refit_steps,
)
from orchestrator.diagnosis.selection.shape_moves import (
    fix_moves,
    fixed_parameters,
    form_moves,
    free_moves,
    with_best_shapes,
)
from orchestrator.formatting.quantities import number, plural

FEW_EFFECTS: int = 2
"""Number of effects added one by one to an unexplained part; after these, all are fitted together."""
MIN_SHARE_OF_ALL: float = 0.5
"""Part of the gain of all absent effects that the best one has to bring; else many are missing."""
MAX_CHI2_RATIO_WITH_QUANTISER: float = 1.2
"""Largest ratio of chi2 with a detected timer's rounding to that without; a false detection had a ratio of 3.2."""

# Expected remaining time, in evaluations of the first model; medians of benches of one and two effects.
EVALUATIONS_LEFT_IF_CLEAN: float = 45.0
"""At the start, where the first model leaves only noise."""
EVALUATIONS_LEFT_FROM_SEARCH: float = 80.0
"""At the start of the search for effects."""
EVALUATIONS_LEFT_FROM_WHOLE: float = 60.0
"""At the start of the fit to the whole recording."""
EVALUATIONS_LEFT_PER_EFFECT: float = 25.0
"""At the start of a fit of all effects, per effect of the library."""
EVALUATIONS_LEFT_FROM_WHOLE_IF_JOINT: float = 300.0
"""At the start of its fit to the whole recording."""
EVALUATIONS_LEFT_FROM_REPORT: float = 22.0
"""At the end of the search."""


def search_effects(
    setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library, interim: InterimRecorder
) -> tuple[DiagnosisSetup, SearchResult]:
    """Search for missing effects, from the last of the first models.

    Returns
    -------
    setup : DiagnosisSetup
        With the nuisances that the search has accepted.
    search : SearchResult
        The ladder, fitted to the whole recording.
    """
    is_clean = steps[-1].fit.chi2_per_dof <= setup.prepared.criteria.selection.detected_chi2
    expected = EVALUATIONS_LEFT_IF_CLEAN if is_clean else EVALUATIONS_LEFT_FROM_SEARCH
    setup.fitter.begin("searching for missing effects", expected)
    if not is_clean and setup.prepared.quantiser is None:
        setup, steps = _with_quantiser(setup, steps, library)
    state = on_whole(_search_part(setup, steps, library, interim), steps)
    state = best_first(state, steps, library, interim)
    return state.setup, result_of(state, steps)


def _search_part(
    setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library, interim: InterimRecorder
) -> SearchState:
    fit = setup.part_fitter.fit(steps[-1].fit.model, relinearisations=0)
    return best_first(SearchState(setup, fit, steps[0].fit.chi2_per_dof), steps, library, interim)


def best_first(
    state: SearchState, steps: Sequence[AcceptedModel], library: Library, interim: InterimRecorder
) -> SearchState:
    """Take the best move until none is above its threshold."""
    tried: set[tuple[object, ...]] = set()
    while True:
        if state.view is None:
            view = linear_view(state.fitter, state.fit, library, _freeable(state, library))
            record_screen(state, view, library)
            state = replace(state, view=view)
        # A joint model has no limit on its computing; what is redundant goes even where nothing more may be added.
        is_over = state.fitter.budget.is_spent and not state.is_joint
        better = first_accepted(state, remove_moves(state) if is_over else _moves(state, library), tried)
        if better is None:
            interim.record(state, steps)
            return state
        if better.fit is not state.fit:
            effects = plural(len(better.fit.model.active), "effect")
            state.fitter.tell(f"{effects}: chi2 {number(better.fit.chi2_per_dof)}")
            interim.record(better, steps)
        state = better


def _moves(state: SearchState, library: Library) -> Iterator[Move]:
    """Moves of a state: cheap ones by their predicted gain, then costly ones."""
    view = state.view
    assert view is not None
    if state.is_joint and not state.is_explained:
        yield from form_moves(state)
    cheap = sorted([*free_moves(state, view, details=False), *add_moves(state, view, library)], key=lambda m: -m.gain)
    is_open = not state.is_explained and not state.is_joint and len(library) > 1
    everything = gain_of_all(view) if is_open else 0.0
    few = len(state.fit.model.active) < FEW_EFFECTS
    waiting = [m for m in cheap if is_open and m.kind == "add" and (not few or m.gain < MIN_SHARE_OF_ALL * everything)]
    if is_open and few and state.is_part:
        yield from first_map_moves(state, next((m for m in cheap if m not in waiting), None))
    yield from (m for m in cheap if m not in waiting)
    if not state.is_explained:
        yield from noise_moves(state, library)
        if not state.is_joint:
            yield from form_moves(state)
        yield from map_moves(state)
    if everything > 2.0 * state.limits.log_evidence * state.noise:
        yield Move("full_model", (), partial(_add_all, state, library))
    yield from waiting
    yield from remove_moves(state)
    if state.is_joint:
        yield from swap_moves(state, view)
        yield from merge_moves(state)
        yield from free_moves(state, view, details=True)
    else:
        yield from fix_moves(state)
        if not state.is_explained:
            yield from tied_moves(state, library)
    yield from kink_moves(state)
    yield from map_for_effect_moves(state)
    yield from other_form_moves(state)
    yield from coarser_map_moves(state)


def _freeable(state: SearchState, library: Library) -> list[tuple[EffectTerm, str]]:
    """Fixed shapes and refinements that may be freed: of a joint model while it is whole, or leaves something."""
    is_whole = len(state.fit.model.active) == len(library)
    is_settled = state.is_joint and state.is_explained and not is_whole
    return [] if is_settled else fixed_parameters(state.fit.model)


def _add_all(state: SearchState, library: Library) -> SearchState:
    state.setup.fitter.begin(f"fitting {len(library)} effects together", EVALUATIONS_LEFT_PER_EFFECT * len(library))
    return full_model(state, library)


def _with_quantiser(
    setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library
) -> tuple[DiagnosisSetup, Sequence[AcceptedModel]]:
    """The setup with a modulator's timer where the readings show one, and the first models with its rounding."""
    first = steps[-1].fit
    timed = with_detected_quantiser(setup, first, library)
    if timed is setup:
        return setup, steps
    beside = refit_steps(timed, steps)
    reached, limit = beside[-1].fit, MAX_CHI2_RATIO_WITH_QUANTISER * first.chi2_per_dof
    # Large effects hide a true timer's rounding, but only a false one raises chi2 much.
    taken = reached.chi2_per_dof <= limit
    setup.fitter.trace.record(
        "quantiser",
        before=first,
        after=reached,
        measure="chi2_per_dof",
        score=reached.chi2_per_dof,
        threshold=limit,
        taken=taken,
    )
    return (timed, beside) if taken else (setup, steps)


def on_whole(state: SearchState, steps: Sequence[AcceptedModel]) -> SearchState:
    """The state with its model fitted to the whole recording."""
    fitter, model = state.setup.fitter, state.fit.model
    expected = EVALUATIONS_LEFT_FROM_WHOLE_IF_JOINT if state.is_joint else EVALUATIONS_LEFT_FROM_WHOLE
    fitter.begin("repeating the search on the whole recording", expected)
    if not model.active:
        fit = refit_steps(state.setup, steps)[-1].fit
    elif state.is_joint:
        # The map is fitted first: the whole recording covers more of the current plane.
        rested = fitter.fit(with_fixed_effects(model), relinearisations=0)
        whole = replace(state, is_part=False)
        fit = whole.minimum(rested.model.with_active(model.active), rested, rounds=MAX_SHAPE_ROUNDS)
    else:
        fit = fitter.fit(model, relinearisations=2, tolerance=3e-4)
    return replace(state.after(fit), is_part=False, refused=(), late=frozenset())


def result_of(state: SearchState, steps: Sequence[AcceptedModel]) -> SearchResult:
    """The ladder of a whole recording's model."""
    steps, fit = refit_steps(state.setup, steps), with_sharpest_map(state.setup, state.fitter, state.fit)
    if not fit.model.active:
        return plain_ladder(replace(state, fit=fit), [*steps[:-1], replace(steps[-1], fit=fit)])
    if state.is_joint:
        # The last move may have left the map's equations linearised elsewhere.
        state = replace(state, fit=state.minimum(fit.model, rounds=MAX_SHAPE_ROUNDS))
        return drop_confounded(state.fitter, build_ladder(state, steps))
    fit = state.fitter.fit(fit.model, fit.linearisation, steps=8, relinearisations=8, tolerance=3e-4)
    return plain_ladder(replace(state, fit=fit), steps)


def with_effect(setup: DiagnosisSetup, fit: Fit, candidate: CandidateEffect) -> Fit:
    """The model refitted with one named effect, in its flexible form where the evidence requires it."""
    state = SearchState(setup, fit, fit.chi2_per_dof, is_part=False)
    scored = score(linear_view(setup.fitter, fit, [candidate]))[0]
    rough = added(state, scored)
    return with_best_shapes(state.after(state.minimum(rough.model, rough))).fit


def unfinished_search(checkpoint: Checkpoint) -> SearchResult:
    """The result of an unfinished search: fits to the whole recording, with the noise of the last checkpoint."""
    state, fit = checkpoint.state, checkpoint.state.fit
    if state.is_part:
        out = redundant_terms(fit) if state.is_joint else []
        model = fit.model.with_active([active for active in fit.model.active if active.name not in out])
        state = on_whole(replace(state, fit=replace(fit, model=model)), checkpoint.first)
    return result_of(state, checkpoint.first)
