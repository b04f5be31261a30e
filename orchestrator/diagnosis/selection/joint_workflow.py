"""The course where effects are many: all fitted together, a ladder made of them, doubtful causes set aside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import (
    DiagnosisSetup,
    has_fine_grid,
    keep_fine_grid,
    on_usual_grid,
    with_finest_map,
)
from orchestrator.diagnosis.fitting.candidates import CandidateEffect
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.judgement.contributions import contributions, is_material
from orchestrator.diagnosis.judgement.intervals import block_scatter_ratio, is_none_significant, possibly_absent
from orchestrator.diagnosis.judgement.verdict import fitted_verdict, left_fraction
from orchestrator.diagnosis.nuisances.segment_scatter import MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH, with_scatter_beside
from orchestrator.diagnosis.selection.forward_search import Search, Step, refit_steps
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

LEAST_RATIO_OF_CAUSE_TO_RESIDUAL: float = 3.0
"""Times the part of the error left in the end that a cause has to explain: a wrong form's error is taken by another
effect."""
MAX_SHARE_OF_ERROR: float = 10.0
"""Factor of the first model's whole error that an effect may remove while something unknown remains; an effect that
removes more is balanced by another. Sound ones removed 1.7 times at most, a confounded one alone 3.6, balanced ones
28 to 236."""
MAX_SHARE_OF_ERROR_OF_PAIR: float = 2.0
"""The same factor for two or more effects that remove as much each: these balance each other. Such pairs removed 2.0
to 3.6 each."""
MAX_RELATIVE_SCATTER: float = 0.2
"""Largest scatter, relative to itself, of an effect that is named while something unknown remains."""

EVALUATIONS_LEFT_PER_EFFECT = {"together": 25.0, "forms": 23.0, "search": 17.0, "whole": 13.5, "ladder": 5.0}
"""Evaluations of the first model that take as long as the rest of a diagnosis from where its steps begin, per effect of
the library; medians of benches of many effects. Where no form explains the error it may be three times that."""

LEAST_RELATIVE_CHANGE_FOR_NEW_SEARCH = 0.05
"""Change of the objective over chi2, by a new quantiser estimate, from which all effects are searched again."""


def search_jointly(
    setup: DiagnosisSetup,
    steps: Sequence[Step],
    quick: Search,
    library: Sequence[CandidateEffect],
    interim: InterimRecorder,
) -> tuple[DiagnosisSetup, Search] | None:
    """The ladder of what the joint fit found; None where that is nothing.

    The setup which comes back has the modulator's timer as all effects leave it, where there is one.
    """

    def begin(text: str, step: str) -> None:
        setup.fitter.begin(text, EVALUATIONS_LEFT_PER_EFFECT[step] * len(library))

    begin(f"{len(library)} effects together", "together")
    fit = fit_full_model(setup.coarse_fitter, quick.fit.model, library)
    begin("each effect's own form", "forms")
    if is_large_misfit(fit):
        setup = with_quantiser_of_dwells(setup, fit, library)
    fit = refine_joint_map(setup, free_own_shapes(setup.coarse_fitter, fit))
    part_alone, whole_alone = quick.steps[0].fit, steps[0].fit
    interim.record_joint(setup, steps, (part_alone, fit), quick, {}, is_part=True)
    begin("which of them do the data ask for?", "search")
    fit, indistinguishable = joint_search(setup.coarse_fitter, fit, library)
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
        # A voltage that the quantiser cannot resolve, or a zero that wanders, may be all that is left beside effects.
        wider = with_scatter_beside(setup, setup.fitter, whole, library)
        setup.fitter.trace.record("noise", before=whole, taken=wider is not None)
        if wider is not None:
            setup, whole = wider, backward_elimination(wider.fitter, refit(wider.fitter, whole.model))
    # The whole shows what a part of it was too little for.
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
    """The fit on as sharp a map as it asks for now that all effects have their forms, and these anew on each.

    This comes before backward elimination: the error of a coarse map looks like one or another effect. The grid is
    chosen with the effects fixed, for there are many maps to try. A finer map that leaves more is not taken.
    """
    while is_large_misfit(fit) and fit.model.space.is_free:
        fixed = setup.coarse_fitter.fit(with_fixed_effects(fit.model), fit.frame)
        finer = record_finest_map(setup, setup.coarse_fitter, fixed)
        if finer is fixed:
            break
        trial = free_own_shapes(
            setup.coarse_fitter, setup.coarse_fitter.renewed(finer.model.with_active(fit.model.active))
        )
        if trial.objective >= fit.objective:
            break
        fit = trial
    return fit


def with_fixed_effects(model: Model) -> Model:
    """The model with its effects held as they are."""
    return model.with_active([replace(active, free=()) for active in model.active])


def coarsen_joint_map(setup: DiagnosisSetup, fit: Fit) -> Fit:
    """The fit on a usual map, where a sharp one does hardly better now that all forms and what scatters are known.

    It was made sharp for what these took away later.
    """
    if not has_fine_grid(fit):
        return fit
    usual = refit(setup.fitter, on_usual_grid(setup, fit))
    keeps = keep_fine_grid(fit, usual)
    setup.fitter.trace.record("coarser_map", before=fit, after=usual, taken=not keeps)
    return fit if keeps else backward_elimination(setup.fitter, usual)


def with_quantiser_of_fit(
    setup: DiagnosisSetup, fit: Fit, indistinguishable: dict[str, list[str]], library: Sequence[CandidateEffect]
) -> tuple[DiagnosisSetup, Fit, dict[str, list[str]]]:
    """All three with the timer as the fit shows it, all effects searched once more where that changes much.

    As they were, where they do no better so.
    """
    timed = refine_quantiser_by_fit(setup, fit, library)
    if timed is None:
        return setup, fit, indistinguishable
    before, others = fit, indistinguishable
    anew, fit = timed
    if abs(before.objective - fit.objective) > LEAST_RELATIVE_CHANGE_FOR_NEW_SEARCH * before.chi2:
        fit, others = _search_again(anew, fit, library)
        more = refine_quantiser_by_fit(anew, fit, library)
        if more is not None and more[-1].objective < fit.objective:
            anew, fit = more
    gain = before.objective - fit.objective
    anew.coarse_fitter.trace.record(
        "quantiser", before=before, after=fit, measure="objective", score=gain, threshold=0.0, taken=gain > 0.0
    )
    return (anew, fit, others) if gain > 0.0 else (setup, before, indistinguishable)


def _search_again(
    setup: DiagnosisSetup, fit: Fit, library: Sequence[CandidateEffect]
) -> tuple[Fit, dict[str, list[str]]]:
    """The joint search from all effects once more, after the quantiser has changed."""
    everything = setup.coarse_fitter.renewed(with_all_effects(fit.model, library))
    return joint_search(setup.coarse_fitter, free_own_shapes(setup.coarse_fitter, everything), library)


def is_large_misfit(fit: Fit) -> bool:
    """Whether so much is left beside all effects that a form must be wrong."""
    return fit.chi2_per_dof > 1.0 + MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH


def build_ladder(
    setup: DiagnosisSetup,
    steps: Sequence[Step],
    whole: Fit,
    indistinguishable: Mapping[str, Sequence[str]],
    detected_not_named: Sequence[str],
) -> Search:
    """The rungs of a joint fit: its causes by what each takes away, largest first; all the rest is in the last rung.

    On each rung effects are as large as in the end, the noise is the last rung's, and R_s and the map follow.
    """
    sizes, factors = contributions(setup, steps[0].fit, whole), log_bayes_factors(whole)
    known = {active.name: active for active in whole.model.active}
    order = sorted(known, key=lambda name: -sizes[name].relative_to_error)
    limits = whole.criteria.selection
    least = max(limits.named_share, LEAST_RATIO_OF_CAUSE_TO_RESIDUAL * left_fraction(steps[0].fit.chi2_per_dof, whole))
    # What nothing else could take away, in the same measure as what is left: less may be the form of another.
    rest = 0.5 * max(whole.chi2 - whole.dof, 0.0)
    clear = [n for n in order if factors[n] > rest]
    causes = [n for n in clear if sizes[n].relative_to_error > least or is_material(sizes[n], whole)] or order[:1]
    below_materiality = [n for n in order if n not in causes]
    for name in order:
        setup.fitter.trace.record(
            "name",
            [name],
            after=whole,
            measure="share",
            score=sizes[name].relative_to_error,
            threshold=least,
            taken=name in causes,
            note="" if name in clear else "its evidence does not exceed half of what is left",
        )
    # What was measured beforehand is in the first steps, and has its place among the causes.
    rungs = [step for step in steps if step.added not in known]
    for count, name in enumerate(causes[:-1], 1):
        still = whole.model.with_active([replace(known[n], free=()) for n in causes[:count]])
        rungs.append(Step(name, setup.fitter.evaluate(still, whole.frame), factors[name]))
        setup.fitter.tell(f"+ {plain_name(name)}: chi2 {number(rungs[-1].fit.chi2_per_dof)}")
    rungs.append(Step(causes[-1], whole, factors[causes[-1]]))
    setup.fitter.tell(f"+ {plain_name(causes[-1])}: chi2 {number(whole.chi2_per_dof)}")
    tied = {name: list(other) for name, other in indistinguishable.items() if name in known}
    view = LinearView(whole, (), tuple(whole.model.free), *whole.projected())
    left = [name for name in detected_not_named if name not in known]
    return Search(rungs, left, tied, view, below_materiality=tuple(below_materiality), contributions=sizes)


def drop_confounded(fitter: Fitter, search: Search) -> tuple[Search, list[str]]:
    """While something unknown remains, a cause of the joint fit that is unsteady, or smaller than the rest, is none.

    Nor is one whose interval holds nothing at all: it may be balanced by another, as is one that takes away many times
    what there is to take away, or twice that where another does as well. All stay in the model. What drifts by a part
    leaves that part of what it takes away: where less is left, the blocks disagree on something else. Where no effect
    at all is sure, nothing has been found, however little is left.
    """
    first, last = search.steps[0].fit, search.fit
    if search.contributions and is_none_significant(fitter, search.fit):
        fitter.trace.record("remove", last.model.names, before=last, taken=True, note="no effect is certain")
        return Search(search.bare_steps, search.detected_not_named), list(last.model.names)
    if not search.contributions or fitted_verdict(first, last) == "explained":
        return search, []
    drift, left = block_scatter_ratio(search.fit), left_fraction(first.chi2_per_dof, last)
    steady = MAX_RELATIVE_SCATTER
    causes, absent = (
        [n for n in last.model.names if n not in search.below_materiality],
        possibly_absent(fitter, search.fit),
    )
    taken = {n: search.contributions[n].relative_to_error for n in causes}
    unsteady = [n for n in causes if drift[n] > steady and left > steady * min(taken[n], 1.0)]
    several = sum(share.relative_to_error > MAX_SHARE_OF_ERROR_OF_PAIR for share in search.contributions.values()) > 1
    most = MAX_SHARE_OF_ERROR_OF_PAIR if several else MAX_SHARE_OF_ERROR
    balanced = [n for n in causes if taken[n] > most]
    doubtful = [n for n in causes if n in unsteady or taken[n] < left or n in absent or n in balanced]
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
            "name", [name], after=last, measure="share", score=taken[name], threshold=left, taken=False, note=note
        )
    steps = [s for s in search.steps[:-1] if s.added not in doubtful]
    added = next((n for n in reversed(causes) if n not in doubtful), None)
    steps = [s for s in steps if s.added != added or added is None]
    steps.append(replace(search.steps[-1], added=added))
    return replace(search, steps=steps, below_materiality=(*doubtful, *search.below_materiality)), doubtful


def record_finest_map(setup: DiagnosisSetup, fitter: Fitter, fit: Fit) -> Fit:
    """The same model on the finest map that is worth its freedom; the fit itself where none is."""
    finer = with_finest_map(setup, fitter, fit)
    if finer is fit:
        fitter.trace.record("finer_map", before=fit, taken=False)
    else:
        gain = fit.objective - finer.objective
        fitter.trace.record("finer_map", before=fit, after=finer, measure="objective", score=gain, taken=True)
    return finer
