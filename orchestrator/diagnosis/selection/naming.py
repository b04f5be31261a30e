"""Which effects of a final model are causes: the ladder, removal of confounded ones, and a second opinion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from orchestrator.diagnosis.fitting.candidates import Library, value_at
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.contributions import Contribution, contributions, is_material
from orchestrator.diagnosis.judgement.intervals import (
    INTERVAL_SIGMAS,
    block_scatter_ratio,
    is_none_significant,
    possibly_absent,
)
from orchestrator.diagnosis.judgement.verdict import fitted_verdict, residual_fraction_of
from orchestrator.diagnosis.selection.adding import sub_threshold_effects
from orchestrator.diagnosis.selection.scoring import LinearView, linear_view, log_bayes_factors, loss_without, score
from orchestrator.diagnosis.selection.search_state import AcceptedModel, SearchResult, SearchState, baseline_models
from orchestrator.formatting.names import plain as plain_name
from orchestrator.formatting.quantities import number
from protocols import EffectParameter, FoundEffect, JointEntry, ParameterValue, Remark

MIN_RATIO_OF_CAUSE_TO_RESIDUAL: float = 3.0
"""Factor of the final residual fraction that a cause has to explain: less may be due to another's wrong form."""
IMITABLE: str = "what is left could imitate it"
MAX_SHARE_OF_ERROR: float = 10.0
"""Factor of the first model's error that an effect may remove while something unknown remains; one that removes more
is balanced by another. Correct effects removed up to 1.7, a single confounded one 3.6, balanced ones 28 to 236."""
MAX_SHARE_OF_ERROR_OF_PAIR: float = 2.0
"""`MAX_SHARE_OF_ERROR` where two or more effects exceed this value; such balanced pairs removed 2.0 to 3.6 each."""
MAX_RELATIVE_SCATTER: float = 0.2
"""Largest scatter between blocks, relative to its size, of an effect named while something unknown remains."""


def plain_ladder(state: SearchState, steps: Sequence[AcceptedModel]) -> SearchResult:
    """Ladder of effects that were added one by one: one step per cause, in their order.

    All steps use the final effect parameters and noise; R_s and the map are refitted.
    """
    whole, first, names = state.fit, steps[0].fit, state.fit.model.names
    gains = {step.added: step.log_evidence for step in steps if step.added is not None} | dict(state.gains)
    sizes = {} if state.is_explained else contributions(state.setup, first, whole)
    limit = _imitable_share(first, whole)
    below = tuple(n for n in names if n in sizes and sizes[n].share <= limit)
    causes = [n for n in names if n not in below]
    if (smaller := _strongest_alone(state, causes)) is not None:
        return plain_ladder(smaller, steps)
    for name in below:
        _record_name(state, name, sizes[name], limit, taken=False, note=IMITABLE)
    return SearchResult(_rungs(state, steps, causes, gains), *_beside(state), view=state.view, below_materiality=below)


def _record_name(
    state: SearchState, name: str, size: Contribution, least_share: float, *, taken: bool, note: str
) -> None:
    state.fitter.trace.record(
        "name",
        [name],
        after=state.fit,
        measure="share",
        score=size.share,
        threshold=least_share,
        taken=taken,
        note=note,
    )


def _imitable_share(first: Fit, whole: Fit) -> float:
    """Share of the first error that an effect has to take away for what is left to be no imitation of it.

    What a cause takes away, over the noise inflated to the residual, exceeds the residual over the noise itself.
    """
    return residual_fraction_of(first.chi2_per_dof, whole) * math.sqrt(max(whole.chi2_per_dof, 1.0))


def build_ladder(state: SearchState, steps: Sequence[AcceptedModel]) -> SearchResult:
    """Ladder of a joint model: one step per cause, the largest first; the last step has all effects.

    All steps use the final effect parameters and noise; R_s and the map are refitted.
    """
    whole, first = state.fit, steps[0].fit
    sizes, factors = contributions(state.setup, first, whole), log_bayes_factors(whole)
    order = sorted(whole.model.names, key=lambda name: -sizes[name].relative_to_error)
    rest = residual_fraction_of(first.chi2_per_dof, whole)
    min_share = max(state.limits.named_share, MIN_RATIO_OF_CAUSE_TO_RESIDUAL * rest)
    imitable = _imitable_share(first, whole)
    needed = state.needed if fitted_verdict(first, whole) != "unknown_remains" else frozenset[str]()
    absent = [name for name in possibly_absent(state.fitter, whole) if name not in needed]
    notes = dict.fromkeys(absent, "its 95 % interval contains no effect at all")
    notes |= {n: IMITABLE for n in order if sizes[n].share <= imitable}
    clear = [n for n in order if n not in notes]
    causes = [n for n in clear if sizes[n].share > min_share or is_material(sizes[n], whole)]
    if (smaller := _strongest_alone(state, causes)) is not None:
        return build_ladder(smaller, steps)
    for name in order:
        _record_name(state, name, sizes[name], min_share, taken=name in causes, note=notes.get(name, ""))
    below = tuple(n for n in order if n not in causes)
    rungs = _rungs(state, steps, causes, factors)
    return SearchResult(
        rungs, *_beside(state), view=state.view, below_materiality=below, contributions=sizes, needed=needed
    )


def _strongest_alone(state: SearchState, causes: Sequence[str]) -> SearchState | None:
    """The state with the strongest of several causes alone, where that explains the recording; None elsewhere.

    Beside a large effect small ones may be that one's other form, however much evidence there is for them, and two that
    balance each other turn the map.
    """
    fit = state.fit
    limit = 1.0 + fit.criteria.verdict.explained_excess_chi2
    if len(causes) < 2 or fit.chi2_per_dof > limit:
        return None
    rise = {a.name: loss_without(fit, a, a.candidate.amplitudes) for a in fit.model.active}
    strongest = max(causes, key=lambda name: rise[name])
    gone = tuple(name for name in causes if name != strongest)
    alone = state.minimum(fit.model.with_active([a for a in fit.model.active if a.name not in gone]))
    chi2 = alone.chi2_per_dof
    note = "the strongest one alone explains the recording" if chi2 <= limit else ""
    state.record("remove", gone, alone, chi2, limit, measure="chi2_per_dof", taken=chi2 <= limit, note=note)
    return replace(state, fit=alone, view=None, refused=(*state.refused, *gone)) if chi2 <= limit else None


def _rungs(
    state: SearchState, steps: Sequence[AcceptedModel], names: Sequence[str], evidence: Mapping[str, float]
) -> list[AcceptedModel]:
    """The first models, then one step for each of some effects; the last step has all effects of the model."""
    fit, rungs = state.fit, baseline_models(steps)
    known = {active.name: active for active in fit.model.active}
    for count, name in enumerate(names, 1):
        some = fit
        if count < len(names):
            fixed = [replace(known[n], free=()) for n in names[:count]]
            some = state.fitter.evaluate(fit.model.with_active(fixed), fit.linearisation)
        rungs.append(AcceptedModel(name, some, evidence[name]))
        state.fitter.tell(f"+ {plain_name(name)}: chi2 {number(some.chi2_per_dof)}")
    if not names:
        rungs[-1] = replace(rungs[-1], fit=fit)
    return rungs


def _beside(state: SearchState) -> tuple[list[str], dict[str, list[str]]]:
    """Effects detected but not named, and for each effect those that fit as well in its place."""
    present = state.fit.model.names
    shown = sub_threshold_effects(state, state.view) if state.view is not None else []
    detected = [n for n in dict.fromkeys([*state.refused, *shown]) if n not in present]
    return detected, {name: list(others) for name, others in state.indistinguishable.items() if name in present}


def drop_confounded(fitter: Fitter, search: SearchResult) -> SearchResult:
    """The search without doubtful causes of a joint fit.

    While something unknown remains, a cause is rejected if its size varies between blocks by more than the residual
    allows, if it explains less than the residual, if its interval contains its absence, or if it removes so much that
    another effect must balance it. All stay in the model. Where no effect is significant, all are rejected.
    """
    first, last = search.steps[0].fit, search.fit
    if search.contributions and not search.needed and is_none_significant(fitter, search.fit):
        fitter.trace.record("remove", last.model.names, before=last, taken=True, note="no effect is certain")
        # Where nothing was named, the last of the first models has all effects.
        steps, names = baseline_models(search.steps), last.model.names
        return SearchResult(steps, search.detected_not_named, below_materiality=names, doubtful=names)
    if not search.contributions or fitted_verdict(first, last) == "explained":
        return search
    drift, residual = block_scatter_ratio(search.fit), residual_fraction_of(first.chi2_per_dof, last)
    causes = [n for n in last.model.names if n not in search.below_materiality]
    absent = [name for name in possibly_absent(fitter, last) if name not in search.needed]
    contributed = search.contributions
    taken = {n: contributed[n].relative_to_error for n in causes}
    limit = MAX_RELATIVE_SCATTER
    unsteady = [n for n in causes if drift[n] > limit and residual > limit * min(taken[n], 1.0)]
    several = sum(share.relative_to_error > MAX_SHARE_OF_ERROR_OF_PAIR for share in search.contributions.values()) > 1
    max_share = MAX_SHARE_OF_ERROR_OF_PAIR if several else MAX_SHARE_OF_ERROR
    balanced = [n for n in causes if taken[n] > max_share]
    doubtful = [n for n in causes if n in unsteady or contributed[n].share < residual or n in absent or n in balanced]
    for name in doubtful:
        note = next(
            text
            for text, names in (
                ("its size varies between blocks of the recording", unsteady),
                ("its 95 % interval contains no effect at all", absent),
                ("another effect balances it", balanced),
                ("it takes away less than remains", doubtful),
            )
            if name in names
        )
        fitter.trace.record(
            "name", [name], after=last, measure="share", score=taken[name], threshold=residual, taken=False, note=note
        )
    steps = [s for s in search.steps[:-1] if s.added not in doubtful]
    added = next((n for n in reversed(causes) if n not in doubtful), None)
    steps = [s for s in steps if s.added != added or added is None]
    steps.append(replace(search.steps[-1], added=added))
    below = (*doubtful, *search.below_materiality)
    return replace(search, steps=steps, below_materiality=below, doubtful=tuple(doubtful))


MAX_CORRELATION: float = 0.995
"""Correlation above which two effects share a column in the joint fit; the priors separate similar ones below it."""
MIN_SIZE_EXCESS: float = 1.5
"""Ratio of the joint fit's first effect to the largest named one, in typical sizes, from which it is reported."""
CERTAIN_SIGMAS: float = 4.0
"""Standard deviations beyond which an effect is not due to chance."""


def joint_fit(fitter: Fitter, search: SearchResult, library: Library) -> tuple[JointEntry, ...]:
    """All effects at once, linearly around the model, under the priors; ranked by relative size."""
    view = search.view or linear_view(fitter, search.fit, library)
    which = _distinct(view)
    if not which:
        return ()
    fit, columns = view.fit, [view.columns[k] for k in which]
    normal, right = view.normal[np.ix_(which, which)], view.right[which]
    inflation = max(fit.chi2_per_dof, 1.0)
    x0 = np.array([a.standardised_value(n) for a, n in columns])
    precision = normal / inflation + np.eye(len(columns))
    off = np.array([a.prior_residual(n) for a, n in columns])
    x = x0 - np.linalg.solve(precision, right / inflation + off)
    spread = np.sqrt(np.diag(np.linalg.inv(precision)))
    entries: dict[str, JointEntry] = {}
    for (active, name), value, sigma in zip(columns, x, spread, strict=True):
        p = active.candidate.named(name)
        if name not in active.candidate.amplitudes:
            continue
        entry = JointEntry(
            name=active.name,
            relative_size=abs(float(value)) * p.prior_width / abs(p.typical),
            z=float(value / sigma),
            parameter=name,
            size=_joint_size(p, float(value), INTERVAL_SIGMAS * float(sigma)),
        )
        known = entries.get(active.name)
        if known is None or abs(entry.z or 0.0) > abs(known.z or 0.0):
            entries[active.name] = entry
    # Insignificant effects are ranked below all significant ones, whatever their size.
    certain = CERTAIN_SIGMAS
    return tuple(sorted(entries.values(), key=lambda e: (abs(e.z or 0.0) < certain, -(e.relative_size or 0.0))))


def _joint_size(p: EffectParameter, x: float, half: float) -> ParameterValue:
    """An amplitude at a standardised value with its interval; one that is strong when small has no upper end."""
    ends = sorted(value_at(p, end) for end in (x - half, x + half))
    return ParameterValue(value=value_at(p, x), low=ends[0], high=None if p.strong_when_small else ends[1], unit=p.unit)


def other_opinion(joint: Sequence[JointEntry], found: Sequence[FoundEffect]) -> list[Remark]:
    """A remark where the joint fit ranks an effect first that the search has not named."""
    if not joint or not found or joint[0].name in {name for e in found for name in (e.name, *e.twins)}:
        return []
    first, size, z = joint[0].name, joint[0].relative_size or 0.0, abs(joint[0].z or 0.0)
    largest = max(found, key=lambda e: e.relative_size or 0.0)
    named = largest.relative_size or 0.0
    if z < CERTAIN_SIGMAS or size < MIN_SIZE_EXCESS * named:
        return []
    text = (
        "with all effects fitted together {first} is the largest, {first_size:.2g} of its typical size; "
        "of those that were named, {named} is, {named_size:.2g} of its own"
    )
    return [Remark.of("joint_disagrees", text, first=first, first_size=size, named=largest.name, named_size=named)]


def _distinct(view: LinearView) -> list[int]:
    """The columns of a view without effects whose column is parallel to that of one with a larger gain."""
    # Two such columns would be fitted to large, meaningless values of opposite sign.
    scale = np.sqrt(np.maximum(np.diag(view.normal), 1e-300))
    like = np.abs(view.normal / np.outer(scale, scale))
    taken = list(range(len(view.fit.model.free)))
    for scored in score(view):
        columns = [k for k, (a, _) in enumerate(view.columns) if a.name == scored.candidate.name]
        if not taken or like[np.ix_(columns, taken)].max() < MAX_CORRELATION:
            taken += columns
    return taken
