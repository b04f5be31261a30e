"""Best move first: one loop over a model's moves, on a part of the recording and then on the whole."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from orchestrator.diagnosis.fitting.baseline import (
    DiagnosisSetup,
    has_fine_grid,
    keep_fine_grid,
    on_usual_grid,
    with_finest_map,
)
from orchestrator.diagnosis.fitting.candidates import EffectTerm, Library
from orchestrator.diagnosis.fitting.chords import trial_step
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.gauss_newton import is_stuck
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.nuisances.segment_scatter import likelihood_of, with_scatter_as_noise, with_scatter_beside
from orchestrator.diagnosis.selection.forward_search import (
    MIN_EFFECT_SIZE,
    MIN_SHARE_OF_EXCESS,
    AcceptedModel,
    SearchResult,
    _inseparable,
    _is_indistinguishable,
    _min_gain,
    _refit_all,
    _share,
    _shortlist,
    _size,
    refit_steps,
)
from orchestrator.diagnosis.selection.interim import InterimRecorder
from orchestrator.diagnosis.selection.contrasts import separable
from orchestrator.diagnosis.selection.joint_search import (
    INDISTINGUISHABLE_SHARE,
    _candidate,
    _effect,
    _sufficient_alone,
    _evidence_gain,
    backward_elimination,
    log_bayes_factors,
    redundant_terms,
    refit,
    refit_briefly,
    with_all_effects,
)
from orchestrator.diagnosis.selection.joint_workflow import build_ladder, with_fixed_effects
from orchestrator.diagnosis.selection.quantiser import (
    refine_quantiser_by_fit,
    with_detected_quantiser,
)
from orchestrator.diagnosis.selection.refining import _at_bounds, _release_refinements, _select_refinements, _simplify, refinement_groups
from orchestrator.diagnosis.selection.scoring import (
    LinearView,
    Score,
    add_threshold,
    fits_as_well,
    keep_threshold,
    linear_gain,
    linear_gain_of_absent,
    linear_view,
    log_evidence,
    score,
    select_terms,
)
from orchestrator.diagnosis.selection.workflow import _evidence_lost, _is_minor, _is_redundant
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number
from protocols import ParameterRole

MANY = 4
MIN_SHARE_OF_ALL = 0.5
"""Part of what all absent effects would bring together that the best one has to bring, or all are added."""
MAX_EXCESS_OF_COMPLETE = 0.15


@dataclass(frozen=True)
class State:
    """A model, its noise and what was learned on the way."""

    setup: DiagnosisSetup
    fit: Fit
    first: Fit
    together: bool = False
    is_part: bool = True
    tied: Mapping[str, Sequence[str]] = field(default_factory=dict)
    missed: tuple[str, ...] = ()
    late: frozenset[str] = frozenset()
    """Effects added to a joint model."""

    @property
    def fitter(self) -> Fitter:
        return self.setup.part_fitter if self.is_part else self.setup.fitter

    @property
    def explains(self) -> bool:
        return self.fit.chi2_per_dof <= self.fit.criteria.selection.detected_chi2

    @property
    def signature(self) -> tuple[object, ...]:
        free = tuple((a.name, n) for a, n in self.fit.model.free)
        noise = self.fitter.noise
        return free, self.fit.model.space.grid, id(noise), self.is_part


@dataclass(frozen=True)
class Move:
    """A change with its fall of chi2 to first order, and what makes it."""

    kind: str
    names: tuple[str, ...]
    gain: float
    make: Callable[[], State | None]


def minimum(fitter: Fitter, model: Model, known: Fit) -> Fit:
    """The model fitted: many effects with frozen Jacobians."""
    if len(model.active) > MANY:
        return refit(fitter, model, known)
    return fitter.fit(model, known.linearisation, steps=5, relinearisations=1, tolerance=1e-3)


def climb(state: State, library: Library, tried: set[tuple[object, ...]]) -> State:
    """Take the best move until none is above its threshold."""
    while not state.fitter.budget.is_spent or state.together:
        better = None
        for move in moves(state, library):
            key = (move.kind, move.names, *(() if move.kind in ("swap", "merge") or (state.together and move.kind == "switch_form") else state.signature))
            if key in tried:
                continue
            tried.add(key)
            better = move.make()
            if better is not None:
                fit = better.fit
                state.fitter.tell(f"{move.kind} {', '.join(move.names)}: chi2 {number(fit.chi2_per_dof)}")
                break
        if better is None:
            return state
        state = better
    return state


def moves(state: State, library: Library) -> Iterator[Move]:
    """Moves above their threshold, the cheap ones first, the largest predicted gain first."""
    fit, fitter = state.fit, state.fitter
    fixed = [
        (a, n)
        for a in fit.model.active
        for n in a.candidate.of_role(ParameterRole.SHAPE, ParameterRole.REFINEMENT)
        if n not in a.free
    ]
    view = linear_view(fitter, fit, library, fixed)
    cheap = sorted([*_frees(state, view), *_adds(state, view, library)], key=lambda m: -m.gain)
    every = _gain_of_all(view)
    many = not state.together and not state.explains and len(library) > 1
    few = [m for m in cheap if not (m.kind == "add" and many and (m.gain < MIN_SHARE_OF_ALL * every or len(fit.model.active) >= 2))]
    yield from few
    if not state.explains:
        yield from _nuisances(state, library)
        yield from _forms(state)
        yield from _maps(state)
        if many:
            yield Move("full_model", (), every, lambda: _all(state, library))
            yield from (m for m in cheap if m not in few)
    if out := redundant_terms(fit):
        yield Move("remove", tuple(out), 0.0, lambda: _removed(state))
    if not state.together and not state.is_part:
        for a in sorted((a for a in fit.model.active if _is_minor(state.first, fit, a)), key=lambda a: a.relative_size):
            yield Move("remove", (a.name,), 0.0, lambda a=a: _pruned(state, a))
    for a in fit.model.active:
        if a.free_refinements and (len(fit.model.active) <= MANY):
            yield Move("fix_shape", (a.name,), 0.0, lambda a=a: _fixed(state, a.name))
    if state.together:
        pairs = [pair for pair in _swap_pairs(view) if state.is_part or pair[1] in state.late]
        for ratio, name, other in pairs[: fit.criteria.selection.most_trials]:
            yield Move("swap", (name, other.name), ratio, lambda name=name, other=other: _swapped(state, name, other))
        for one, other in combinations(fit.model.names, 2):
            if not separable(fit.prepared, _effect(fit, one), _effect(fit, other)):
                yield Move("merge", (one, other), 0.0, lambda one=one, other=other: _merged(state, one, other))
    if has_fine_grid(fit) and not state.is_part:
        yield Move("coarser_map", (), 0.0, lambda: _coarser(state))


def _gain_of_all(view: LinearView) -> float:
    absent = {c.name for c in view.absent}
    fitted = len(view.fit.model.free)
    columns = [k for k, (a, _) in enumerate(view.columns) if k >= fitted and a.name in absent]
    return linear_gain(view.normal, view.right, fitted, movable(view, columns))[0] if columns else 0.0


def movable(view: LinearView, columns: Sequence[int]) -> list[int]:
    """Those of some columns that no bound holds where they are."""
    left = list(columns)
    while left:
        _, x = linear_gain(view.normal, view.right, len(view.fit.model.free), left)
        stuck = [
            k
            for k, step in zip(left, x.tolist(), strict=True)
            if is_stuck(*view.columns[k], view.columns[k][0].standardised_value(view.columns[k][1]) + step)
        ]
        if not stuck:
            break
        left = [k for k in left if k not in stuck]
    return left


def _frees(state: State, view: LinearView) -> Iterator[Move]:
    """Shapes of significant effects, and refinements that together bring most of their gain."""
    fit = state.fit
    fitted, names = len(fit.model.free), [n for _, n in view.columns]
    noise = max(fit.chi2_per_dof, 1.0)
    shown = log_bayes_factors(fit) if fit.model.active else {}
    for role in (ParameterRole.SHAPE, ParameterRole.REFINEMENT):
        groups, gain = {}, 0.0
        for active in fit.model.active:
            own = [
                k
                for k, (a, n) in enumerate(view.columns)
                if k >= fitted and a.name == active.name and n in active.candidate.of_role(role)
            ]
            if not own:
                continue
            if role is ParameterRole.SHAPE:
                if shown[active.name] > fit.criteria.selection.log_evidence:
                    groups[active.name] = [names[k] for k in own]
                continue
            share = (math.inf if len(fit.model.active) > MANY else None) if state.is_part else 0.0
            own = movable(view, own)
            forms = refinement_groups(fit, active, names, own, noise, share)
            if some := select_terms((view.normal, view.right), fitted, forms, 0.3):
                groups[active.name] = [names[k] for k in some]
        chosen = [k for k, (a, n) in enumerate(view.columns) if k >= fitted and n in groups.get(a.name, ())]
        if not chosen:
            continue
        gain = linear_gain(view.normal, view.right, fitted, chosen)[0]
        model = fit.model.with_active([a.release(*groups.get(a.name, ())) for a in fit.model.active])
        needed = 2.0 * fit.criteria.selection.tie * noise if role is ParameterRole.REFINEMENT else 1.0
        if gain > needed:
            yield Move("free_shape", tuple(groups), gain, lambda m=model: _freed(state, m))


def _freed(state: State, model: Model) -> State | None:
    trial = minimum(state.fitter, model, state.fit)
    gain, tie = _evidence_gain(trial, state.fit), state.fit.criteria.selection.tie
    fall = state.fit.objective - trial.objective
    taken = gain > tie or (len(model.active) > MANY and fall > 2.0 * tie * max(1.0, trial.chi2_per_dof))
    state.fitter.trace.record(
        "free_shape", model.names, before=state.fit, after=trial, measure="log_evidence", score=gain, threshold=tie, taken=taken
    )
    return replace(state, fit=trial) if taken else None


def _adds(state: State, view: LinearView, library: Library) -> Iterator[Move]:
    fit = state.fit
    rejected = set(state.missed)
    if not state.together:
        rejected |= {n for tied in state.tied.values() for n in tied} | _inseparable(fit, library)
    scores = [s for s in score(view) if s.candidate.name not in rejected]
    if state.together:
        noise = max(fit.chi2_per_dof, 1.0)
        asking = [s for s in scores if s.gain > 2.0 * add_threshold(fit, s.candidate) * noise]
        asking = [s for s in asking if s.gain > 0.3 * asking[0].gain]
        if asking:
            yield Move("add", tuple(s.candidate.name for s in asking), asking[0].gain, lambda: _added_to_many(state, asking))
        return
    shortlist = _shortlist(scores, fit)
    if scores:
        state.fitter.trace.record(
            "screen",
            [s.candidate.name for s in shortlist or scores[:1]],
            before=fit,
            measure="chi2",
            score=scores[0].gain,
            threshold=_min_gain(scores[0], fit),
            taken=None if shortlist else False,
        )
    if shortlist:
        names = tuple(s.candidate.name for s in shortlist)
        yield Move("add", names, shortlist[0].gain, lambda: _added(state, shortlist, library))


def _added(state: State, shortlist: Sequence[Score], library: Library) -> State | None:
    fit, fitter, limits = state.fit, state.fitter, state.fit.criteria.selection
    fitter.under_way(f"which is missing? {', '.join(plain(s.candidate.name) for s in shortlist)}")
    trials = _refit_all(fitter, fit, shortlist)
    inflation = max(1.0, min(t.chi2_per_dof for _, t in trials))
    before = log_evidence(fit, inflation)
    odds = {c.name: c.prior_log_odds for c in library}
    ranked = sorted(((log_evidence(t, inflation) - before + odds[n], n, t) for n, t in trials), key=lambda one: -one[0])
    gain, name, trial = ranked[0]
    for g, n, t in ranked:
        fitter.trace.record("refit", [n], before=fit, after=t, measure="log_evidence", score=g, threshold=limits.log_evidence)
    enough = _size(trial, name) >= MIN_EFFECT_SIZE and _share(fit, trial) >= MIN_SHARE_OF_EXCESS
    if gain < limits.log_evidence:
        return None
    if not enough:
        return replace(state, missed=(*state.missed, *(n for g, n, _ in ranked if g > limits.log_evidence)))
    others = [
        n
        for g, n, t in ranked[1:]
        if gain - g < limits.tie or fits_as_well(t, trial) or _is_indistinguishable(fit, trial, t, name, n)
    ]
    grown = minimum(fitter, trial.model, trial)
    fitter.trace.record(
        "add", [name], before=fit, after=grown, measure="log_evidence", score=gain, threshold=limits.log_evidence, taken=grown.objective < fit.objective
    )
    if grown.objective >= fit.objective:
        return None
    return replace(state, fit=grown, tied={**state.tied, name: others}, missed=())


def _added_to_many(state: State, asking: Sequence[Score]) -> State | None:
    fit = state.fit
    terms = []
    for one in asking:
        active = one.candidate.absent().release(*one.candidate.of_role(ParameterRole.SHAPE))
        for name, x in zip(one.candidate.amplitudes, one.coordinates, strict=True):
            active = active.moved(name, float(x))
        terms.append(active)
    more = refit(state.fitter, fit.model.with_active([*fit.model.active, *terms]), fit)
    taken = more.objective < fit.objective
    state.fitter.trace.record("add", [a.name for a in terms], before=fit, after=more, measure="objective", score=fit.objective - more.objective, threshold=0.0, taken=taken)
    return replace(state, fit=more, late=state.late | {a.name for a in terms}) if taken else None


def _forms(state: State) -> Iterator[Move]:
    """Effects in their second form, or without parameters that ran to a bound."""
    for k, active in enumerate(state.fit.model.active):
        if state.together:
            other = active.candidate.absent_in_alternative_form()
            forms = [] if other is None else [other.release(*active.free)]
        else:
            ended = _at_bounds(active)
            forms = [*active.alternative_forms(), *([active.fix(*ended)] if ended else [])]
        for j, form in enumerate(forms):
            yield Move("switch_form", (active.name, str(j)), 0.0, lambda k=k, form=form: _switched(state, k, form))


def _switched(state: State, k: int, form: EffectTerm) -> State | None:
    fit, fitter, tie = state.fit, state.fitter, state.fit.criteria.selection.tie
    terms = list(fit.model.active)

    def having(term: EffectTerm) -> Model:
        return fit.model.with_active([*terms[:k], term, *terms[k + 1 :]])

    if state.together:
        model = having(form)
        if trial_step(fitter, model, fit).chi2_per_dof > 10.0 * fit.chi2_per_dof:
            return None
    else:
        begun = fitter.evaluate(having(_release_refinements(form)), fit.linearisation)
        reached = begun.objective - fitter.predicted_reduction(begun)
        if fit.objective - reached < 2.0 * tie:
            return None
        model = having(form.release(*_select_refinements(begun, form, 1.0)))
    trial = minimum(fitter, model, fit)
    gain = _evidence_gain(trial, fit)
    fitter.trace.record("switch_form", [form.name], before=fit, after=trial, measure="log_evidence", score=gain, threshold=tie, taken=gain > tie)
    return replace(state, fit=trial) if gain > tie else None


def _maps(state: State) -> Iterator[Move]:
    if state.fit.model.active and state.fit.model.space.is_free:
        yield Move("finer_map", (), 0.0, lambda: _finer(state))


def _finer(state: State) -> State | None:
    fit = state.fit
    many = len(fit.model.active) > MANY
    start = state.fitter.fit(with_fixed_effects(fit.model), fit.linearisation) if many else fit
    finer = with_finest_map(state.setup, state.fitter, start)
    state.fitter.trace.record("finer_map", before=fit, after=finer, taken=finer is not start)
    if finer is start:
        return None
    if many:
        finer = refit(state.fitter, finer.model.with_active(fit.model.active))
    return replace(state, fit=finer) if finer.objective < fit.objective else None


def _nuisances(state: State, library: Library) -> Iterator[Move]:
    if not state.fitter.noise.of_model.scatters:
        yield Move("noise", (), 0.0, lambda: _with_scatter(state, library))
    if state.setup.quantisers and state.together and state.is_part:
        yield Move("quantiser", (), 0.0, lambda: _timed(state, library))


def _with_scatter(state: State, library: Library) -> State | None:
    if state.is_part:
        wider = with_scatter_as_noise(state.setup, likelihood_of(state.fitter, state.fit, library))
    else:
        wider = with_scatter_beside(state.setup, state.fitter, state.fit, library)
    state.fitter.trace.record("noise", before=state.fit, taken=wider is not None)
    if wider is None:
        return None
    after = replace(state, setup=wider)
    return replace(after, fit=minimum(after.fitter, state.fit.model, state.fit))


def _timed(state: State, library: Library) -> State | None:
    timed = refine_quantiser_by_fit(state.setup, state.fit, library)
    if timed is None or timed[1].objective >= state.fit.objective:
        return None
    return replace(state, setup=timed[0], fit=timed[1])


def _all(state: State, library: Library) -> State:
    fit = refit_briefly(state.fitter, with_all_effects(state.fit.model, library))
    state.fitter.trace.record("full_model", fit.model.names, before=state.fit, after=fit, taken=True)
    return replace(state, fit=fit, together=True, missed=())


def _removed(state: State) -> State | None:
    fit = backward_elimination(state.fitter, state.fit)
    gone = tuple(n for n in state.fit.model.names if n not in fit.model.names)
    if not gone:
        return None
    missed = tuple(n for n in gone if n in state.late) if state.together else gone
    return replace(state, fit=fit, missed=(*state.missed, *missed))


def _pruned(state: State, active: EffectTerm) -> State | None:
    full = state.fit
    less = minimum(state.fitter, full.model.with_active([a for a in full.model.active if a.name != active.name]), full)
    redundant = _is_redundant(state.first, less, full, active.name)
    state.fitter.trace.record(
        "remove", [active.name], before=full, after=less, measure="log_evidence", score=-_evidence_lost(full, less),
        threshold=-keep_threshold(full, active.candidate), taken=redundant, note="small, uncertain, or what another effect's form makes" if redundant else "",
    )
    return replace(state, fit=less, missed=(*state.missed, active.name)) if redundant else None


def _fixed(state: State, name: str) -> State | None:
    k = state.fit.model.names.index(name)
    simple = _simplify(state.fitter, state.fit, k, state.fit.model.active[k].free_refinements)
    return None if simple is None else replace(state, fit=simple)


def _swap_pairs(view: LinearView) -> list[tuple[float, str, EffectTerm]]:
    """Pairs of an effect and an absent one, at its linear estimate, that makes up for most of the effect's loss."""
    fit, normal, right = view.fit, view.normal, view.right
    free = fit.model.free
    amplitudes = [k for k, (a, n) in enumerate(free) if n in a.candidate.amplitudes]
    pairs = []
    for one in fit.model.active:
        stay = [k for k in amplitudes if free[k][0].name != one.name]
        go = [k for k in amplitudes if free[k][0].name == one.name]
        away = -np.array([one.standardised_value(free[k][1]) for k in go])
        pull = right + normal[:, go] @ away
        order = [*stay, *go]
        worth, _ = linear_gain(normal[np.ix_(order, order)], pull[order], len(stay), range(len(stay), len(order)))
        for c in view.absent:
            place = [k for k, (a, _) in enumerate(view.columns) if k >= len(free) and a.name == c.name]
            order = [*stay, *place]
            columns = range(len(stay), len(order))
            gain, x = linear_gain_of_absent(c, normal[np.ix_(order, order)], pull[order], len(stay), columns)
            if gain > INDISTINGUISHABLE_SHARE * worth:
                other = c.absent()
                for n, value in zip(c.amplitudes, x, strict=True):
                    other = other.moved(n, float(value))
                pairs.append((gain / worth, one.name, other))
    return sorted(pairs, key=lambda pair: -pair[0])


def _swapped(state: State, name: str, other: EffectTerm) -> State | None:
    fit, fitter, limits = state.fit, state.fitter, state.fit.criteria.selection
    others = [a for a in fit.model.active if a.name != name]
    model = fit.model.with_active([*others, other.release(*other.candidate.of_role(ParameterRole.SHAPE))])
    trial = trial_step(fitter, model, fit)
    if _evidence_gain(trial, fit) < -limits.tie - 0.1 * log_bayes_factors(fit)[name]:
        return None
    trial = refit_briefly(fitter, model, trial)
    gain = _evidence_gain(trial, fit) + other.candidate.prior_log_odds - _candidate(fit, name).prior_log_odds
    better, lesser = (trial, fit) if gain > 0.0 else (fit, trial)
    parted = separable(fit.prepared, other.candidate.effect, _effect(fit, name))
    equal = abs(gain) < limits.tie or not parted or fits_as_well(lesser, better)
    fitter.trace.record(
        "swap", [other.name, name], before=fit, after=trial, measure="log_evidence", score=gain, threshold=0.0, taken=gain > 0.0, note="both do as well" if equal else ""
    )
    tied = dict(state.tied)
    if gain > 0.0:
        tied[other.name] = [*tied.pop(name, []), name] if equal else []
        return replace(state, fit=trial, tied=tied)
    if equal:
        tied[name] = list(dict.fromkeys([*tied.get(name, []), other.name]))
        return replace(state, tied=tied)
    return None


def _merged(state: State, one: str, other: str) -> State | None:
    fit = state.fit
    factors = log_bayes_factors(fit)
    lesser, stays = sorted((one, other), key=lambda name: factors[name] + _candidate(fit, name).prior_log_odds)
    alone = _sufficient_alone(state.fitter, fit, lesser, stays)
    if alone is None:
        return None
    keeps, trial = alone
    goes = stays if keeps == lesser else lesser
    state.fitter.trace.record("merge", [keeps, goes], before=fit, after=trial, measure="log_evidence", score=_evidence_gain(trial, fit), threshold=-16.0, taken=True)
    return replace(state, fit=trial, tied={**state.tied, keeps: list(dict.fromkeys([*state.tied.get(keeps, []), goes]))})


def _coarser(state: State) -> State | None:
    usual = minimum(state.fitter, on_usual_grid(state.setup, state.fit), state.fit)
    keeps = keep_fine_grid(state.fit, usual)
    state.fitter.trace.record("coarser_map", before=state.fit, after=usual, taken=not keeps)
    return None if keeps else replace(state, fit=usual)


def search_best_first(
    setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library, interim: InterimRecorder
) -> tuple[DiagnosisSetup, SearchResult, list[str]]:
    """The search: a part first, then the whole."""
    first = steps[-1].fit
    if first.chi2_per_dof > first.criteria.selection.detected_chi2:
        timed = with_detected_quantiser(setup, first, library)
        if timed is not setup:
            beside = refit_steps(timed, steps)
            if beside[-1].fit.chi2_per_dof <= 1.2 * first.chi2_per_dof:
                setup, steps = timed, beside
    part = State(setup, setup.part_fitter.fit(steps[-1].fit.model, relinearisations=0), steps[0].fit)
    tried: set[tuple[object, ...]] = set()
    part = climb(part, library, tried)
    setup = part.setup
    if part.setup.fitter.noise is not steps[-1].fit.linearisation.noise:
        steps = refit_steps(setup, steps)
    fit = steps[-1].fit
    if part.fit.model.active:
        if part.together:
            fit = setup.fitter.fit(with_fixed_effects(part.fit.model))
            fit = refit(setup.fitter, fit.model.with_active(part.fit.model.active))
        else:
            fit = setup.fitter.fit(part.fit.model, relinearisations=2, tolerance=3e-4)
    whole = climb(replace(part, fit=fit, is_part=False, missed=(), late=frozenset()), library, tried)
    setup = whole.setup
    if setup.fitter.noise is not steps[-1].fit.linearisation.noise:
        steps = refit_steps(setup, steps)
    fit = whole.fit
    missed = [n for n in whole.missed if n not in fit.model.names]
    if not fit.model.active:
        return setup, SearchResult(list(steps), missed), []
    if whole.together:
        search = build_ladder(setup, steps, fit, {k: list(v) for k, v in whole.tied.items()}, missed)
        return setup, search, []
    fit = setup.fitter.fit(fit.model, fit.linearisation, steps=8, relinearisations=3, tolerance=3e-4)
    return setup, ladder_of(setup, steps, fit, whole.tied, missed), []


def ladder_of(setup, steps, fit, tied, missed) -> SearchResult:  # noqa
    rungs = [s for s in steps if s.added not in fit.model.names]
    factors = log_bayes_factors(fit)
    names = list(fit.model.names)
    for count, name in enumerate(names, 1):
        if count == len(names):
            rungs.append(AcceptedModel(name, fit, factors[name]))
        else:
            some = fit.model.with_active([replace(a, free=()) for a in fit.model.active[:count]])
            rungs.append(AcceptedModel(name, setup.fitter.evaluate(some, fit.linearisation), factors[name]))
    return SearchResult(rungs, missed, {n: list(o) for n, o in tied.items() if n in names})
