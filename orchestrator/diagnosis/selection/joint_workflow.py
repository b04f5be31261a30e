"""Diagnosis with many effects: a joint fit, a ladder built from it, and removal of confounded causes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import (
    DiagnosisSetup,
    has_fine_grid,
    keep_fine_grid,
    on_usual_grid,
    with_finest_map,
)
from orchestrator.diagnosis.fitting.candidates import Library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.judgement.contributions import contributions, is_material
from orchestrator.diagnosis.judgement.intervals import block_scatter_ratio, is_none_significant, possibly_absent
from orchestrator.diagnosis.judgement.verdict import fitted_verdict, residual_fraction_of
from orchestrator.diagnosis.nuisances.segment_scatter import MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH, with_scatter_beside
from orchestrator.diagnosis.selection.forward_search import AcceptedModel, SearchResult, refit_steps
from orchestrator.diagnosis.selection.interim import InterimRecorder
from orchestrator.diagnosis.selection.joint_search import (
    backward_elimination,
    fit_full_model,
    forward_step,
    free_own_shapes,
    joint_search,
    log_bayes_factors,
    merge_indistinguishable,
    refit,
    swap_step,
    with_all_effects,
)
from orchestrator.diagnosis.selection.quantiser import refine_quantiser_by_fit, with_quantiser_of_dwells
from orchestrator.diagnosis.selection.scoring import LinearView
from orchestrator.formatting.names import plain as plain_name
from orchestrator.formatting.quantities import number

MIN_RATIO_OF_CAUSE_TO_RESIDUAL: float = 3.0
"""Factor of the final residual fraction that a cause has to explain: less may be due to another's wrong form."""
MAX_SHARE_OF_ERROR: float = 10.0
"""Factor of the first model's error that an effect may remove while something unknown remains; one that removes more
is balanced by another. Correct effects removed up to 1.7, a single confounded one 3.6, balanced ones 28 to 236."""
MAX_SHARE_OF_ERROR_OF_PAIR: float = 2.0
"""`MAX_SHARE_OF_ERROR` where two or more effects exceed this value; such balanced pairs removed 2.0 to 3.6 each."""
MAX_RELATIVE_SCATTER: float = 0.2
"""Largest scatter between blocks, relative to its size, of an effect named while something unknown remains."""

EVALUATIONS_LEFT_PER_EFFECT = {"together": 25.0, "forms": 23.0, "search": 17.0, "whole": 13.5, "ladder": 5.0}
"""Evaluations of the first model that take as long as the rest of a diagnosis from where its steps begin, per effect of
the library; medians of benches of many effects. Where no form explains the error it may be three times that."""

MIN_RELATIVE_CHANGE_FOR_NEW_SEARCH = 0.05
"""Change of the objective over chi2, by a new quantiser estimate, from which all effects are searched again."""


def search_jointly(
    setup: DiagnosisSetup,
    steps: Sequence[AcceptedModel],
    quick: SearchResult,
    library: Library,
    interim: InterimRecorder,
) -> tuple[DiagnosisSetup, SearchResult] | None:
    """The setup and ladder of a joint search; None where it finds no effect.

    The setup returned has the modulator's timer as estimated beside all effects.
    """

    def begin(text: str, step: str) -> None:
        setup.fitter.begin(text, EVALUATIONS_LEFT_PER_EFFECT[step] * len(library))

    begin(f"{len(library)} effects together", "together")
    fit = fit_full_model(setup.part_fitter, quick.fit.model, library)
    begin("each effect's own form", "forms")
    if is_large_misfit(fit):
        setup = with_quantiser_of_dwells(setup, fit, library)
    fit = refine_joint_map(setup, free_own_shapes(setup.part_fitter, fit))
    part_alone, whole_alone = quick.steps[0].fit, steps[0].fit
    interim.record_joint(setup, steps, (part_alone, fit), quick, {}, is_part=True)
    begin("which of them do the data ask for?", "search")
    fit, indistinguishable = joint_search(setup.part_fitter, fit, library)
    setup, fit, indistinguishable = with_quantiser_of_fit(setup, fit, indistinguishable, library)
    if not fit.model.active:
        return None
    interim.record_joint(setup, steps, (part_alone, fit), quick, indistinguishable, is_part=True)
    begin("the same on the whole recording", "whole")
    whole = setup.fitter.fit(with_fixed_effects(fit.model))
    if whole.model.space.is_free:
        whole = record_finest_map(setup, setup.fitter, whole)
    whole = backward_elimination(setup.fitter, refit(setup.fitter, whole.model.with_active(fit.model.active)))
    interim.record_joint(setup, steps, (whole_alone, whole), quick, indistinguishable, is_part=False)
    if whole.chi2_per_dof > whole.criteria.selection.detected_chi2 and not setup.fitter.noise.of_model.scatters:
        # An unresolved quantiser or drifting sensor offsets may be the only misfit beside the effects.
        wider = with_scatter_beside(setup, setup.fitter, whole, library)
        setup.fitter.trace.record("noise", before=whole, taken=wider is not None)
        if wider is not None:
            setup, whole = wider, backward_elimination(wider.fitter, refit(wider.fitter, whole.model))
    # The whole recording may show effects that its part was too short for.
    whole = backward_elimination(setup.fitter, forward_step(setup.fitter, whole, library))
    if late := [name for name in whole.model.names if name not in fit.model.names]:
        whole, others = swap_step(setup.fitter, whole, library, late)
        whole = backward_elimination(setup.fitter, whole)
        indistinguishable = {**indistinguishable, **others}
    whole = coarsen_joint_map(setup, whole)
    # The map was refined since indistinguishable effects were merged last.
    whole, doubles = merge_indistinguishable(setup.fitter, whole)
    indistinguishable = {
        name: [*indistinguishable.get(name, []), *doubles.get(name, [])] for name in {**indistinguishable, **doubles}
    }
    if not whole.model.active:
        return None
    if setup.prepared.quantiser is not None or setup.fitter.noise.of_model.scatters:
        steps = refit_steps(setup, steps)
    begin("what does each take away?", "ladder")
    return setup, build_ladder(setup, steps, whole, indistinguishable, quick.detected_not_named)


def refine_joint_map(setup: DiagnosisSetup, fit: Fit) -> Fit:
    """Refit on the finest map that the evidence requires, now that all effects have their forms.

    This comes before backward elimination: the error of a coarse map looks like one or another effect. The grid is
    chosen with the effects fixed, for there are many maps to try. A finer map that leaves more is not taken.
    """
    while is_large_misfit(fit) and fit.model.space.is_free:
        fixed = setup.part_fitter.fit(with_fixed_effects(fit.model), fit.linearisation)
        finer = record_finest_map(setup, setup.part_fitter, fixed)
        if finer is fixed:
            break
        trial = free_own_shapes(
            setup.part_fitter, setup.part_fitter.relinearise(finer.model.with_active(fit.model.active))
        )
        if trial.objective >= fit.objective:
            break
        fit = trial
    return fit


def with_fixed_effects(model: Model) -> Model:
    """The model with all effect parameters fixed."""
    return model.with_active([replace(active, free=()) for active in model.active])


def coarsen_joint_map(setup: DiagnosisSetup, fit: Fit) -> Fit:
    """Refit on the usual map where a fine one no longer gains: effects found later may explain what it was for."""
    if not has_fine_grid(fit):
        return fit
    usual = refit(setup.fitter, on_usual_grid(setup, fit))
    keeps = keep_fine_grid(fit, usual)
    setup.fitter.trace.record("coarser_map", before=fit, after=usual, taken=not keeps)
    return fit if keeps else backward_elimination(setup.fitter, usual)


def with_quantiser_of_fit(
    setup: DiagnosisSetup, fit: Fit, indistinguishable: dict[str, list[str]], library: Library
) -> tuple[DiagnosisSetup, Fit, dict[str, list[str]]]:
    """Setup, fit and alternatives with the timer estimated from the fit; a large change repeats the search.

    All are returned unchanged where that does not improve the fit.
    """
    timed = refine_quantiser_by_fit(setup, fit, library)
    if timed is None:
        return setup, fit, indistinguishable
    before, others = fit, indistinguishable
    anew, fit = timed
    if abs(before.objective - fit.objective) > MIN_RELATIVE_CHANGE_FOR_NEW_SEARCH * before.chi2:
        fit, others = _search_again(anew, fit, library)
        more = refine_quantiser_by_fit(anew, fit, library)
        if more is not None and more[-1].objective < fit.objective:
            anew, fit = more
    gain = before.objective - fit.objective
    anew.part_fitter.trace.record(
        "quantiser", before=before, after=fit, measure="objective", score=gain, threshold=0.0, taken=gain > 0.0
    )
    return (anew, fit, others) if gain > 0.0 else (setup, before, indistinguishable)


def _search_again(setup: DiagnosisSetup, fit: Fit, library: Library) -> tuple[Fit, dict[str, list[str]]]:
    """Repeat the joint search after the quantiser has changed."""
    everything = setup.part_fitter.relinearise(with_all_effects(fit.model, library))
    return joint_search(setup.part_fitter, free_own_shapes(setup.part_fitter, everything), library)


def is_large_misfit(fit: Fit) -> bool:
    """Whether the residual beside all effects is so large that a form must be wrong."""
    return fit.chi2_per_dof > 1.0 + MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH


def build_ladder(
    setup: DiagnosisSetup,
    steps: Sequence[AcceptedModel],
    whole: Fit,
    indistinguishable: Mapping[str, Sequence[str]],
    detected_not_named: Sequence[str],
) -> SearchResult:
    """Ladder of a joint fit: one step per cause, the largest first; the last step has all effects.

    All steps use the final effect parameters and noise; R_s and the map are refitted.
    """
    sizes, factors = contributions(setup, steps[0].fit, whole), log_bayes_factors(whole)
    known = {active.name: active for active in whole.model.active}
    order = sorted(known, key=lambda name: -sizes[name].relative_to_error)
    limits, residual = whole.criteria.selection, residual_fraction_of(steps[0].fit.chi2_per_dof, whole)
    min_share = max(limits.named_share, MIN_RATIO_OF_CAUSE_TO_RESIDUAL * residual)
    # What a cause takes away, over the noise inflated to the residual, must exceed the residual over the noise itself:
    # less may be the form of another effect.
    imitable = residual * math.sqrt(max(whole.chi2_per_dof, 1.0))
    clear = [n for n in order if factors[n] > limits.log_evidence and sizes[n].relative_to_error > imitable]
    causes = [n for n in clear if sizes[n].relative_to_error > min_share or is_material(sizes[n], whole)] or order[:1]
    below_materiality = [n for n in order if n not in causes]
    for name in order:
        setup.fitter.trace.record(
            "name",
            [name],
            after=whole,
            measure="share",
            score=sizes[name].relative_to_error,
            threshold=min_share,
            taken=name in causes,
            note="" if name in clear else "what is left could imitate it",
        )
    # Effects measured from the readings are in the first models; they are ranked among the causes instead.
    rungs = [step for step in steps if step.added not in known]
    for count, name in enumerate(causes[:-1], 1):
        still = whole.model.with_active([replace(known[n], free=()) for n in causes[:count]])
        rungs.append(AcceptedModel(name, setup.fitter.evaluate(still, whole.linearisation), factors[name]))
        setup.fitter.tell(f"+ {plain_name(name)}: chi2 {number(rungs[-1].fit.chi2_per_dof)}")
    rungs.append(AcceptedModel(causes[-1], whole, factors[causes[-1]]))
    setup.fitter.tell(f"+ {plain_name(causes[-1])}: chi2 {number(whole.chi2_per_dof)}")
    tied = {name: list(other) for name, other in indistinguishable.items() if name in known}
    view = LinearView(whole, (), tuple(whole.model.free), *whole.projected())
    unnamed = [name for name in detected_not_named if name not in known]
    return SearchResult(rungs, unnamed, tied, view, below_materiality=tuple(below_materiality), contributions=sizes)


def drop_confounded(fitter: Fitter, search: SearchResult) -> tuple[SearchResult, list[str]]:
    """Reject doubtful causes of a joint fit; returns the search and the names rejected.

    While something unknown remains, a cause is rejected if its size varies between blocks by more than the residual
    allows, if it explains less than the residual, if its interval contains its absence, or if it removes so much that
    another effect must balance it. All stay in the model. Where no effect is significant, all are rejected.
    """
    first, last = search.steps[0].fit, search.fit
    if search.contributions and is_none_significant(fitter, search.fit):
        fitter.trace.record("remove", last.model.names, before=last, taken=True, note="no effect is certain")
        return SearchResult(search.baseline_models, search.detected_not_named), list(last.model.names)
    if not search.contributions or fitted_verdict(first, last) == "explained":
        return search, []
    drift, residual = block_scatter_ratio(search.fit), residual_fraction_of(first.chi2_per_dof, last)
    causes, absent = (
        [n for n in last.model.names if n not in search.below_materiality],
        possibly_absent(fitter, search.fit),
    )
    taken = {n: search.contributions[n].relative_to_error for n in causes}
    limit = MAX_RELATIVE_SCATTER
    unsteady = [n for n in causes if drift[n] > limit and residual > limit * min(taken[n], 1.0)]
    several = sum(share.relative_to_error > MAX_SHARE_OF_ERROR_OF_PAIR for share in search.contributions.values()) > 1
    max_share = MAX_SHARE_OF_ERROR_OF_PAIR if several else MAX_SHARE_OF_ERROR
    balanced = [n for n in causes if taken[n] > max_share]
    doubtful = [n for n in causes if n in unsteady or taken[n] < residual or n in absent or n in balanced]
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
    return replace(search, steps=steps, below_materiality=(*doubtful, *search.below_materiality)), doubtful


def record_finest_map(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    """`with_finest_map`, recorded in the trace."""
    finer = with_finest_map(setup, fitter, fit)
    if finer is fit:
        fitter.trace.record("finer_map", before=fit, taken=False)
    else:
        gain = fit.objective - finer.objective
        fitter.trace.record("finer_map", before=fit, after=finer, measure="objective", score=gain, taken=True)
    return finer
