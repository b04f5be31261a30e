"""Moves of an effect's form: shapes and refinements freed or fixed, a second form tried.

The wrong shape of the right effect causes most spurious second ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.chords import trial_step
from orchestrator.diagnosis.fitting.gauss_newton import newton_step
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.selection.scoring import (
    LinearView,
    linear_gain,
    linear_view,
    log_bayes_factors,
    loss_without,
    movable,
    select_terms,
)
from orchestrator.diagnosis.selection.search_state import (
    MAX_SHAPE_ROUNDS,
    Move,
    SearchState,
    evidence_gain,
    first_accepted,
)
from protocols import ParameterRole

MAX_DEFERRED_FORM_GAIN: float = 0.3
"""Part of a flexible form's linear gain that may be postponed: few of its parameters bring most of the gain, and the
others are judged anew once those are free."""
MIN_SHARE_OF_FORM_DETAIL: float = 0.5
"""Part of the excess chi2 that a form's details have to remove to be freed; less may belong to another effect."""
LEAST_CHI2_LOSS_OF_SIMPLE_FORM: float = 1000.0
"""Loss of chi2, to first order, beyond which an effect's simple form does not suffice."""
MAX_CHI2_RATIO_OF_SECOND_FORM: float = 10.0
"""Factor of the first form's chi2 that the second may leave after one step; beyond, the trial ends. On switching
benches it was 1.1 where the second form did better, and 90 where it did not."""


def fixed_parameters(model: Model) -> list[tuple[EffectTerm, str]]:
    """Shapes and refinements that are not free."""
    roles = (ParameterRole.SHAPE, ParameterRole.REFINEMENT)
    return [(a, n) for a in model.active for n in a.candidate.of_role(*roles) if n not in a.free]


def free_moves(state: SearchState, view: LinearView, *, details: bool) -> Iterator[Move]:
    """Free the shapes of significant effects; free refinements that bring most of their gain.

    Parameters
    ----------
    view : LinearView
        Has the columns of all `fixed_parameters`.
    details : bool
        Whether details of a joint model's effects may be freed.
    """
    factors = log_bayes_factors(state.fit) if state.fit.model.active else {}
    significant = [n for n, factor in factors.items() if factor > state.limits.log_evidence]
    shapes = {a.name: _fixed(a, ParameterRole.SHAPE) for a in state.fit.model.active if a.name in significant}
    share = (0.0 if details else math.inf) if state.is_joint else MIN_SHARE_OF_FORM_DETAIL
    # A round of a joint model is costly: all that gain are freed at once.
    later = 0.0 if state.is_joint else MAX_DEFERRED_FORM_GAIN
    groups = [shapes]
    for is_detail in (False, True):
        select = partial(_select_refinements, state.fit, view, noise=state.noise, share=share, later=later)
        groups.append({a.name: select(a, only_details=is_detail) for a in state.fit.model.active})
    for freed in groups:
        names = {name: parameters for name, parameters in freed.items() if parameters}
        columns = [k for k in view.extra if view.columns[k][1] in names.get(view.columns[k][0].name, ())]
        gain = linear_gain(view.normal, view.right, view.fitted, columns)[0] if columns else 0.0
        if gain > 2.0 * state.limits.tie * state.noise:
            concerned = (*names, *(view.columns[k][1] for k in columns))
            # Details alone come last: those that gain more than the others adapt to anything.
            yield Move("free_shape", concerned, partial(_free, state, names), 0.0 if freed is groups[2] else gain)


def _fixed(active: EffectTerm, role: ParameterRole) -> tuple[str, ...]:
    return tuple(n for n in active.candidate.of_role(role) if n not in active.free)


def _select_refinements(
    fit: Fit,
    view: LinearView,
    active: EffectTerm,
    *,
    noise: float,
    share: float,
    later: float,
    only_details: bool = False,
) -> tuple[str, ...]:
    """Fixed refinements of an effect that together bring most of the gain of all.

    Details are selected where the others gain too little, or alone. They must also remove a `share` of the excess
    chi2, because they adapt to any missing effect.
    """
    limits, candidate = fit.criteria.selection, active.candidate
    rigid = _fixed(active, ParameterRole.REFINEMENT)
    columns = movable(
        view, [k for k in view.extra if view.columns[k][0].name == active.name and view.columns[k][1] in rigid]
    )
    first = [k for k in columns if not candidate.named(view.columns[k][1]).detail]
    details = [k for k in columns if k not in first]
    least = of_details = 2.0 * limits.tie * noise
    if fit.chi2_per_dof > limits.detected_chi2 and share:
        of_details = max(least, share * (fit.chi2 - fit.dof))
    groups = [([] if only_details else first, least), (details, of_details)]
    chosen = select_terms((view.normal, view.right), view.fitted, groups, later)
    return tuple(view.columns[k][1] for k in chosen)


def _free(state: SearchState, names: Mapping[str, Sequence[str]]) -> SearchState | None:
    freed = [a.release(*names.get(a.name, ())) for a in state.fit.model.active]
    trial = state.minimum(state.fit.model.with_active(freed), rounds=MAX_SHAPE_ROUNDS)
    gain, tie = evidence_gain(trial, state.fit), state.limits.tie
    # Of many shapes freed at once some have no evidence of their own.
    falls = state.is_joint and state.fit.objective - trial.objective > 2.0 * tie * max(1.0, trial.chi2_per_dof)
    taken = gain > tie or falls
    state.record("free_shape", tuple(names), trial, gain, tie, taken=taken)
    return state.after(trial) if taken else None


def fix_moves(state: SearchState) -> Iterator[Move]:
    """Fix an effect's refinements again, where its simple form now does as well."""
    for active in state.fit.model.active:
        names = active.free_refinements
        if names and loss_without(state.fit, active, names) <= LEAST_CHI2_LOSS_OF_SIMPLE_FORM:
            yield Move("fix_shape", (active.name,), partial(_fix, state, active))


def _fix(state: SearchState, active: EffectTerm) -> SearchState | None:
    trial = state.minimum(_with_form(state.fit.model, active.fix(*active.free_refinements)))
    gain, tie = evidence_gain(trial, state.fit), state.limits.tie
    state.record("fix_shape", (active.name,), trial, gain, -tie, taken=gain > -tie)
    return state.after(trial) if gain > -tie else None


def form_moves(state: SearchState) -> Iterator[Move]:
    """Other starts of an effect's form."""
    for active in state.fit.model.active:
        if state.is_joint:
            second = active.candidate.absent_in_alternative_form()
            forms = [] if second is None else [second.release(*active.free)]
        else:
            forms = active.alternative_forms()
        for index, form in enumerate(forms):
            # A form is tried once beside the same effects.
            effects = (active.name, str(index), *(() if state.is_joint else state.fit.model.names))
            yield Move("switch_form", effects, partial(_switch, state, form), is_once=True)


def _switch(state: SearchState, form: EffectTerm) -> SearchState | None:
    fit, fitter, tie = state.fit, state.fitter, state.limits.tie
    if state.is_joint:
        model = _with_form(fit.model, form)
        if trial_step(fitter, model, fit).chi2_per_dof > MAX_CHI2_RATIO_OF_SECOND_FORM * fit.chi2_per_dof:
            return None
    else:
        begun = fitter.evaluate(_with_form(fit.model, _release_refinements(form)), fit.linearisation)
        if fit.objective - begun.objective + newton_step(begun, begun.projected(), 0.0)[1] < 2.0 * tie:
            return None
        model = _with_form(fit.model, form.release(*_wanted(begun, form)))
    trial = state.minimum(model)
    gain = evidence_gain(trial, fit)
    state.record("switch_form", (form.name,), trial, gain, tie, taken=gain > tie)
    return state.after(trial) if gain > tie else None


def _with_form(model: Model, form: EffectTerm) -> Model:
    """The model with one effect in another form."""
    return model.with_active([form if a.name == form.name else a for a in model.active])


def _release_refinements(form: EffectTerm) -> EffectTerm:
    """An effect with its refinements free, except those that lead from its first form to the second."""
    declared = ((n, form.candidate.named(n)) for n in form.candidate.of_role(ParameterRole.REFINEMENT))
    return form.release(*(n for n, p in declared if p.other_form is None or form.values[n] != p.neutral))


def _wanted(begun: Fit, form: EffectTerm) -> tuple[str, ...]:
    """Refinements of a form that bring most of the gain of all, which are free in a fit."""
    free = begun.model.free
    extra = [k for k, (a, n) in enumerate(free) if a.name == form.name and n not in form.free]
    order = [*(k for k in range(len(free)) if k not in extra), *extra]
    normal, right = begun.projected()
    fixed = begun.model.with_active([form if a.name == form.name else a for a in begun.model.active])
    view = LinearView(
        replace(begun, model=fixed), (), tuple(free[k] for k in order), normal[order][:, order], right[order]
    )
    return _select_refinements(
        begun, view, form, noise=1.0, share=MIN_SHARE_OF_FORM_DETAIL, later=MAX_DEFERRED_FORM_GAIN
    )


def with_best_shapes(state: SearchState) -> SearchState:
    """The state with shapes and refinements freed, one move after another, while the evidence asks for it."""
    tried: set[tuple[object, ...]] = set()
    while True:
        view = linear_view(state.fitter, state.fit, (), fixed_parameters(state.fit.model))
        forms = () if state.is_explained or state.is_joint else form_moves(state)
        better = first_accepted(state, chain(free_moves(state, view, details=True), forms), tried)
        if better is None:
            return state
        state = better
