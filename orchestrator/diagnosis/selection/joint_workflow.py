"""The course where effects are many: all fitted together, a ladder made of them, doubtful causes set aside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import (
    DiagnosisSetup,
    earns_its_sharpness,
    is_sharp,
    on_usual_map,
)
from orchestrator.diagnosis.fitting.candidates import Candidate
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.selection.forward_search import Search, Step, refitted_steps
from orchestrator.diagnosis.selection.interim import InterimRecorder
from orchestrator.diagnosis.selection.joint_search import (
    downwards,
    exchanged,
    in_own_forms,
    joint_search,
    log_bayes_factors,
    refitted,
    together,
    with_everything,
    with_overlooked,
    without_doubles,
)
from orchestrator.diagnosis.selection.map_detail import with_finer_map
from orchestrator.diagnosis.selection.modulator_timer import with_sharper_timer, with_timer_of_fit
from orchestrator.diagnosis.selection.scoring import LinearView
from orchestrator.diagnosis.selection.shares import is_material, shares
from orchestrator.diagnosis.selection.verdict import fitted_verdict, left_fraction
from orchestrator.diagnosis.uncertainty.block_scatter import block_scatter_ratio
from orchestrator.diagnosis.uncertainty.intervals import nothing_is_sure, perhaps_absent
from orchestrator.diagnosis.uncertainty.scatter import MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH, beside_scatter
from orchestrator.formatting.names import plain as plain_name
from orchestrator.formatting.quantities import number

NAMED_OVER_RESIDUAL: float = 3.0
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

LEFT_PER_EFFECT = {"together": 25.0, "forms": 23.0, "search": 17.0, "whole": 13.5, "ladder": 5.0}
"""Evaluations of the first model that take as long as the rest of a diagnosis from where its steps begin, per effect of
the library; medians of benches of many effects. Where no form explains the error it may be three times that."""

TIMED_ANEW = 0.05
"""Of chi2, by which a modulator's timer changes a fit for which all effects are asked once more."""


def all_together(
    setup: DiagnosisSetup,
    steps: Sequence[Step],
    quick: Search,
    library: Sequence[Candidate],
    interim: InterimRecorder,
) -> tuple[DiagnosisSetup, Search] | None:
    """The ladder of what the joint fit found; None where that is nothing.

    The setup which comes back has the modulator's timer as all effects leave it, where there is one.
    """

    def begin(text: str, step: str) -> None:
        setup.fitter.begin(text, LEFT_PER_EFFECT[step] * len(library))

    begin(f"{len(library)} effects together", "together")
    fit = together(setup.coarse_fitter, quick.fit.model, library)
    begin("each effect's own form", "forms")
    if _formless(fit):
        setup = with_sharper_timer(setup, fit, library)
    fit = on_a_sharper_map(setup, in_own_forms(setup.coarse_fitter, fit))
    part_alone, whole_alone = quick.steps[0].fit, steps[0].fit
    interim.reached_together(setup, steps, (part_alone, fit), quick, {}, is_part=True)
    begin("which of them do the data ask for?", "search")
    fit, rivals = joint_search(setup.coarse_fitter, fit, library)
    setup, fit, rivals = timed_anew(setup, fit, rivals, library)
    if not fit.model.active:
        return None
    interim.reached_together(setup, steps, (part_alone, fit), quick, rivals, is_part=True)
    begin("the same on the whole recording", "whole")
    whole = setup.fitter.fit(at_rest(fit.model))
    if whole.model.space.is_free:
        whole = with_finer_map(setup, setup.fitter, whole)
    whole = downwards(setup.fitter, refitted(setup.fitter, whole.model.with_active(fit.model.active)))
    interim.reached_together(setup, steps, (whole_alone, whole), quick, rivals, is_part=False)
    if whole.chi2_per_dof > whole.criteria.selection.detected_chi2 and not setup.fitter.noise.of_model.scatters:
        # Beside all effects, a voltage that the timer cannot resolve, or a zero that wanders, may be all that is left.
        wider = beside_scatter(setup, setup.fitter, whole, library)
        setup.fitter.trace.record("noise", before=whole, taken=wider is not None)
        if wider is not None:
            setup, whole = wider, downwards(wider.fitter, refitted(wider.fitter, whole.model))
    # The whole tells what a part of it was too little for.
    whole = downwards(setup.fitter, with_overlooked(setup.fitter, whole, library))
    if late := [name for name in whole.model.names if name not in fit.model.names]:
        whole, others = exchanged(setup.fitter, whole, library, late)
        whole = downwards(setup.fitter, whole)
        rivals = {**rivals, **others}
    whole = no_sharper_than_asked(setup, whole)
    # The map was refined since doubles were asked last.
    whole, doubles = without_doubles(setup.fitter, whole)
    rivals = {name: [*rivals.get(name, []), *doubles.get(name, [])] for name in {**rivals, **doubles}}
    if not whole.model.active:
        return None
    if setup.prepared.timer is not None or setup.fitter.noise.of_model.scatters:
        steps = refitted_steps(setup, steps)
    begin("what does each take away?", "ladder")
    return setup, ladder_of(setup, steps, whole, rivals, quick.traces)


def on_a_sharper_map(setup: DiagnosisSetup, fit: Fit) -> Fit:
    """The fit on as sharp a map as it asks for now that all effects have their forms, and these anew on each.

    Before any of them is asked to stay: what a map is too coarse for looks like one or another of them. How sharp it
    has to be is asked with the effects at rest, for there are many maps to try; where a sharper one leaves more, not.
    """
    while _formless(fit) and fit.model.space.is_free:
        resting = setup.coarse_fitter.fit(at_rest(fit.model), fit.frame)
        sharper = with_finer_map(setup, setup.coarse_fitter, resting)
        if sharper is resting:
            break
        trial = in_own_forms(
            setup.coarse_fitter, setup.coarse_fitter.renewed(sharper.model.with_active(fit.model.active))
        )
        if trial.objective >= fit.objective:
            break
        fit = trial
    return fit


def at_rest(model: Model) -> Model:
    """The model with its effects held as they are."""
    return model.with_active([replace(active, free=()) for active in model.active])


def no_sharper_than_asked(setup: DiagnosisSetup, fit: Fit) -> Fit:
    """The fit on a usual map, where a sharp one does hardly better now that all forms and what scatters are known.

    It was made sharp for what these took away later.
    """
    if not is_sharp(fit):
        return fit
    usual = refitted(setup.fitter, on_usual_map(setup, fit))
    keeps = earns_its_sharpness(fit, usual)
    setup.fitter.trace.record("coarser_map", before=fit, after=usual, taken=not keeps)
    return fit if keeps else downwards(setup.fitter, usual)


def timed_anew(
    setup: DiagnosisSetup, fit: Fit, rivals: dict[str, list[str]], library: Sequence[Candidate]
) -> tuple[DiagnosisSetup, Fit, dict[str, list[str]]]:
    """All three with the timer as the fit shows it, all effects searched once more where that changes much.

    As they were, where they do no better so.
    """
    timed = with_timer_of_fit(setup, fit, library)
    if timed is None:
        return setup, fit, rivals
    before, others = fit, rivals
    anew, fit = timed
    if abs(before.objective - fit.objective) > TIMED_ANEW * before.chi2:
        fit, others = _asked_again(anew, fit, library)
        more = with_timer_of_fit(anew, fit, library)
        if more is not None and more[-1].objective < fit.objective:
            anew, fit = more
    gain = before.objective - fit.objective
    anew.coarse_fitter.trace.record(
        "quantiser", before=before, after=fit, measure="objective", score=gain, threshold=0.0, taken=gain > 0.0
    )
    return (anew, fit, others) if gain > 0.0 else (setup, before, rivals)


def _asked_again(setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]) -> tuple[Fit, dict[str, list[str]]]:
    """The joint fit with every effect asked once more, after what was no effect has changed."""
    everything = setup.coarse_fitter.renewed(with_everything(fit.model, library))
    return joint_search(setup.coarse_fitter, in_own_forms(setup.coarse_fitter, everything), library)


def _formless(fit: Fit) -> bool:
    """Whether so much is left beside all effects that a form must be wrong."""
    return fit.chi2_per_dof > 1.0 + MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH


def ladder_of(
    setup: DiagnosisSetup, steps: Sequence[Step], whole: Fit, rivals: Mapping[str, Sequence[str]], traces: Sequence[str]
) -> Search:
    """The rungs of a joint fit: its causes by what each takes away, largest first; all the rest is in the last rung.

    On each rung effects are as large as in the end, the noise is the last rung's, and R_s and the map follow.
    """
    sizes, factors = shares(setup, steps[0].fit, whole), log_bayes_factors(whole)
    known = {active.name: active for active in whole.model.active}
    order = sorted(known, key=lambda name: -sizes[name].of_error)
    limits = whole.criteria.selection
    least = max(limits.named_share, NAMED_OVER_RESIDUAL * left_fraction(steps[0].fit.chi2_per_dof, whole))
    # What nothing else could take away, in the same measure as what is left: less may be the form of another.
    rest = 0.5 * max(whole.chi2 - whole.dof, 0.0)
    clear = [n for n in order if factors[n] > rest]
    causes = [n for n in clear if sizes[n].of_error > least or is_material(sizes[n], whole)] or order[:1]
    minor = [n for n in order if n not in causes]
    for name in order:
        setup.fitter.trace.record(
            "name",
            [name],
            after=whole,
            measure="share",
            score=sizes[name].of_error,
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
    tied = {name: list(other) for name, other in rivals.items() if name in known}
    view = LinearView(whole, (), tuple(whole.model.free), *whole.projected())
    left = [name for name in traces if name not in known]
    return Search(rungs, left, tied, view, minor=tuple(minor), shares=sizes)


def without_stand_ins(fitter: Fitter, search: Search) -> tuple[Search, list[str]]:
    """While something unknown remains, a cause of the joint fit that is unsteady, or smaller than the rest, is none.

    Nor is one whose interval holds nothing at all: it may be balanced by another, as is one that takes away many times
    what there is to take away, or twice that where another does as well. All stay in the model. What drifts by a part
    leaves that part of what it takes away: where less is left, the blocks disagree on something else. Where no effect
    at all is sure, nothing has been found, however little is left.
    """
    first, last = search.steps[0].fit, search.fit
    if search.shares and nothing_is_sure(fitter, search.fit):
        fitter.trace.record("remove", last.model.names, before=last, taken=True, note="no effect is certain")
        return Search(search.bare_steps, search.traces), list(last.model.names)
    if not search.shares or fitted_verdict(first, last) == "explained":
        return search, []
    drift, left = block_scatter_ratio(search.fit), left_fraction(first.chi2_per_dof, last)
    steady = MAX_RELATIVE_SCATTER
    causes, absent = [n for n in last.model.names if n not in search.minor], perhaps_absent(fitter, search.fit)
    taken = {n: search.shares[n].of_error for n in causes}
    unsteady = [n for n in causes if drift[n] > steady and left > steady * min(taken[n], 1.0)]
    several = sum(share.of_error > MAX_SHARE_OF_ERROR_OF_PAIR for share in search.shares.values()) > 1
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
    return replace(search, steps=steps, minor=(*doubtful, *search.minor)), doubtful
