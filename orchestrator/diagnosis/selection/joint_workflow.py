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
from orchestrator.diagnosis.uncertainty.model_error import with_model_error
from orchestrator.diagnosis.uncertainty.scatter import (
    MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH,
    as_much,
    beside_scatter,
    doubting_zeros,
    likelihood_of,
)
from orchestrator.formatting.names import plain as plain_name
from orchestrator.formatting.quantities import number
from protocols import ModelNoise

NAMED_OVER_RESIDUAL: float = 3.0
"""Times the part of the error left in the end that a cause has to explain: a wrong form's error is taken by another
effect."""
MAX_CHI2_RATIO_TO_CONTINUE: float = 3.0
"""Factor of chi2 with the scatter taken for noise up to which a descent without it continues where that one ended."""
MAX_FORM_ROUNDS: int = 3
"""How often all effects' forms and the scatter are estimated anew, each given the other."""
MAX_MODEL_ERROR_ROUNDS: int = 2
"""How often a large model error is estimated, and all is fitted again."""
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
    """The ladder of what the joint fit found; None where it has no more to say than the search one by one.

    What scatters beside all effects, or is their forms' error, is noise to the setup which comes back.
    """
    given = setup

    def begin(text: str, step: str) -> None:
        setup.fitter.begin(text, LEFT_PER_EFFECT[step] * len(library))

    begin(f"{len(library)} effects together", "together")
    fit = together(setup.coarse_fitter, quick.fit.model, library)
    begin("each effect's own form", "forms")
    setup, doubting, fit = formed_together(setup, fit, library)
    fit = on_a_sharper_map(doubting, fit)
    setup, doubting, fit = without_needless_scatter(setup, doubting, fit)
    part_alone, whole_alone = quick.steps[0].fit, steps[0].fit
    interim.reached_together(setup, steps, (part_alone, fit), quick, {}, is_part=True)
    begin("which of them do the data ask for?", "search")
    fit, rivals = joint_search(doubting.coarse_fitter, fit, library)
    setup, doubting, fit, rivals = timed_anew(setup, doubting, fit, rivals, library)
    if doubting is given and set(fit.model.names) <= set(quick.fit.model.names):
        return None
    interim.reached_together(setup, steps, (part_alone, fit), quick, rivals, is_part=True)
    before, limits = setup.fitter.noise.of_model, fit.criteria.selection
    if doubting is not setup or _formless(fit):
        setup, fit = with_its_noise(setup, fit, library)
        fit, rivals = exchanged(setup.coarse_fitter, fit, library)
    if setup.fitter.noise.of_model.scatters and setup.prepared.timer is None:
        # Behind a modulator's timer something does scatter.
        everything = with_everything(fit.model, library)
        setup, _, alone = without_needless_scatter(setup, setup, fit, everything)
        if alone is not fit:
            fit, rivals = exchanged(setup.coarse_fitter, downwards(setup.coarse_fitter, alone), library)
    begin("the same on the whole recording", "whole")
    whole = setup.fitter.fit(at_rest(fit.model))
    if whole.model.space.is_free:
        whole = with_finer_map(setup, setup.fitter, whole)
    whole = downwards(setup.fitter, refitted(setup.fitter, whole.model.with_active(fit.model.active)))
    interim.reached_together(setup, steps, (whole_alone, whole), quick, rivals, is_part=False)
    if as_much(setup.fitter.noise.of_model, before) and setup.judged(whole).chi2_per_dof > limits.detected_chi2:
        # What a part's wrong forms hid; with it as noise, the forms' error is not as large as it seemed.
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
    # All that scatters, and the map, were told since doubles were asked last.
    whole, doubles = without_doubles(setup.fitter, whole)
    rivals = {name: [*rivals.get(name, []), *doubles.get(name, [])] for name in {**rivals, **doubles}}
    if not whole.model.active:
        return None
    if setup.fitter.noise.of_model != before or setup.prepared.timer is not None:
        steps = refitted_steps(setup.unweighed, steps)
    begin("what does each take away?", "ladder")
    return setup, ladder_of(setup, steps, whole, rivals, quick.traces)


def without_needless_scatter(
    setup: DiagnosisSetup, doubting: DiagnosisSetup, fit: Fit, model: Model | None = None
) -> tuple[DiagnosisSetup, DiagnosisSetup, Fit]:
    """All three without what scatters, where the effects in their own forms are likelier so: the fit's, or a model's.

    It was told beside forms that were wrong, and would hide what is steady: an offset of all readings is one of each.
    """
    if not doubting.fitter.noise.of_model.scatters:
        return setup, doubting, fit
    plain = setup.with_noise(ModelNoise()) if setup.fitter.noise.of_model.scatters else setup
    alone = in_own_forms(plain.coarse_fitter, plain.coarse_fitter.renewed(model or fit.model))
    near = MAX_CHI2_RATIO_TO_CONTINUE * fit.chi2_per_dof
    if alone.objective >= fit.objective and alone.chi2_per_dof < near:
        # From far off a descent may end on its way: its steps have become short.
        alone = in_own_forms(plain.coarse_fitter, alone)
    plain.coarse_fitter.trace.record(
        "noise",
        before=fit,
        after=alone,
        measure="objective",
        score=fit.objective - alone.objective,
        threshold=0.0,
        taken=alone.objective < fit.objective,
        note="a fit without variance components",
    )
    return (plain, plain, alone) if alone.objective < fit.objective else (setup, doubting, fit)


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
    setup: DiagnosisSetup,
    doubting: DiagnosisSetup,
    fit: Fit,
    rivals: dict[str, list[str]],
    library: Sequence[Candidate],
) -> tuple[DiagnosisSetup, DiagnosisSetup, Fit, dict[str, list[str]]]:
    """All four with the timer as the fit tells it, all effects asked once more where that changes much.

    As they were, where they do no better so.
    """
    told = with_timer_of_fit(setup, doubting, fit, library)
    if told is None:
        return setup, doubting, fit, rivals
    untold = setup, doubting, fit, rivals
    before, (setup, doubting, fit) = fit, told
    if abs(before.objective - fit.objective) > TIMED_ANEW * before.chi2:
        fit, rivals = _asked_again(doubting, fit, library)
        more = with_timer_of_fit(setup, doubting, fit, library)
        if more is not None and more[-1].objective < fit.objective:
            setup, doubting, fit = more
    gain = before.objective - fit.objective
    doubting.coarse_fitter.trace.record(
        "quantiser", before=before, after=fit, measure="objective", score=gain, threshold=0.0, taken=gain > 0.0
    )
    return (setup, doubting, fit, rivals) if fit.objective < before.objective else untold


def _asked_again(setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]) -> tuple[Fit, dict[str, list[str]]]:
    """The joint fit with every effect asked once more, after what was no effect has changed."""
    everything = setup.coarse_fitter.renewed(with_everything(fit.model, library))
    return joint_search(setup.coarse_fitter, in_own_forms(setup.coarse_fitter, everything), library)


def formed_together(
    setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]
) -> tuple[DiagnosisSetup, DiagnosisSetup, Fit]:
    """All effects in their own forms, and what scatters beside them as noise, each in the light of the other.

    Returns
    -------
    setup : DiagnosisSetup
        With the modulator's timer, where there is one, as the rests tell it.
    doubting : DiagnosisSetup
        That with what scatters as noise.
    fit : Fit
    """
    doubting, start = setup, setup
    for turn in range(MAX_FORM_ROUNDS):
        before = doubting
        if _formless(fit) or before is not start:
            doubting = doubting_zeros(setup, likelihood_of(setup.coarse_fitter, fit, library))
            note = "variance components beside all effects"
            setup.coarse_fitter.trace.record("noise", before=fit, taken=doubting is not setup, note=note)
            setup, doubting = with_sharper_timer(setup, doubting, fit, library)
        if turn:
            if as_much(doubting.fitter.noise.of_model, before.fitter.noise.of_model):
                break
            fit = doubting.coarse_fitter.renewed(fit.model)
            if fit.chi2_per_dof <= fit.criteria.selection.detected_chi2:
                break
        fit = in_own_forms(doubting.coarse_fitter, fit)
    return setup, doubting, fit


def _formless(fit: Fit) -> bool:
    """Whether so much is left beside all effects that a form must be wrong."""
    return fit.chi2_per_dof > 1.0 + MAX_EXCESS_CHI2_OF_COMPLETE_SEARCH


def with_its_noise(setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]) -> tuple[DiagnosisSetup, Fit]:
    """A part's joint fit with what scatters as noise, and then the model's own error, by stage and mode.

    All effects are asked once more, for what errs most had the say in what there is; then the errors are.
    """
    everything = with_everything(fit.model, library)
    wider = beside_scatter(setup, setup.coarse_fitter, fit, library)
    setup.coarse_fitter.trace.record("noise", before=fit, taken=wider is not None)
    setup = wider or setup
    if fit.frame.noise is not setup.coarse_fitter.noise:
        if wider is None:
            # What scattered is none that a sound sensor or modulator has: it is a form's error, which it hid.
            fit = in_own_forms(setup.coarse_fitter, setup.coarse_fitter.renewed(everything))
            # And that form had a say in the timer's phases.
            setup, fit = with_timer_without_scatter(setup, fit, library)
            everything = with_everything(fit.model, library)
        fit = downwards(setup.coarse_fitter, refitted(setup.coarse_fitter, everything))
    if _formless(fit):
        model = everything if wider is None else fit.model
        for _ in range(MAX_MODEL_ERROR_ROUNDS):
            setup = setup.with_noise(with_model_error(setup.fitter.noise.of_model, fit))
            note = "the model's own error by stage and mode"
            setup.coarse_fitter.trace.record("noise", before=fit, taken=True, note=note)
            fit = downwards(setup.coarse_fitter, refitted(setup.coarse_fitter, model))
            model = fit.model
    return setup, fit


def with_timer_without_scatter(
    setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]
) -> tuple[DiagnosisSetup, Fit]:
    """Setup and fit with the timer as all equations tell it, where it does better without what scatters beside it."""
    told = with_timer_of_fit(setup, setup, fit, library)
    if told is None:
        return setup, fit
    timed, _, beside = told
    trial = timed.coarse_fitter.renewed(beside.model)
    return (timed, trial) if trial.objective < fit.objective else (setup, fit)


def ladder_of(
    setup: DiagnosisSetup, steps: Sequence[Step], whole: Fit, rivals: Mapping[str, Sequence[str]], traces: Sequence[str]
) -> Search:
    """The rungs of a joint fit: its causes by what each takes away, largest first; all the rest is in the last rung.

    On each rung effects are as large as in the end, the noise is the last rung's, and R_s and the map follow. The
    model's own error is no noise there: it is what remains.
    """
    plain, judged = setup.unweighed, setup.judged(whole)
    sizes, factors = shares(setup, steps[0].fit, whole), log_bayes_factors(whole)
    known = {active.name: active for active in whole.model.active}
    order = sorted(known, key=lambda name: -sizes[name].of_error)
    limits = whole.criteria.selection
    least = max(limits.named_share, NAMED_OVER_RESIDUAL * left_fraction(steps[0].fit.chi2_per_dof, judged))
    # What nothing else could take away, in the same measure as what is left: less may be the form of another.
    rest = 0.5 * max(whole.chi2 - whole.dof, judged.chi2 - judged.dof, 0.0)
    clear = [n for n in order if factors[n] > rest]
    causes = [n for n in clear if sizes[n].of_error > least or is_material(sizes[n], whole)] or order[:1]
    minor = [n for n in order if n not in causes]
    for name in order:
        setup.fitter.trace.record(
            "name",
            [name],
            after=judged,
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
        rungs.append(Step(name, plain.fitter.evaluate(still, judged.frame), factors[name]))
        setup.fitter.tell(f"+ {plain_name(name)}: chi2 {number(rungs[-1].fit.chi2_per_dof)}")
    rungs.append(Step(causes[-1], judged, factors[causes[-1]]))
    setup.fitter.tell(f"+ {plain_name(causes[-1])}: chi2 {number(judged.chi2_per_dof)}")
    tied = {name: list(other) for name, other in rivals.items() if name in known}
    view = LinearView(whole, (), tuple(whole.model.free), *whole.projected())
    left = [name for name in traces if name not in known]
    own = None if judged is whole else whole
    return Search(rungs, left, tied, view, minor=tuple(minor), shares=sizes, weighed=own)


def without_stand_ins(fitter: Fitter, search: Search) -> tuple[Search, list[str]]:
    """While something unknown remains, a cause of the joint fit that is unsteady, or smaller than the rest, is none.

    Nor is one whose interval holds nothing at all: it may be balanced by another, as is one that takes away many times
    what there is to take away, or twice that where another does as well. All stay in the model. What drifts by a part
    leaves that part of what it takes away: where less is left, the blocks disagree on something else. Where no effect
    at all is sure, nothing has been found, however little is left.
    """
    first, last = search.steps[0].fit, search.fit
    if search.shares and nothing_is_sure(fitter, search.sized):
        fitter.trace.record("remove", last.model.names, before=last, taken=True, note="no effect is certain")
        return Search(search.bare_steps, search.traces), list(last.model.names)
    if not search.shares or fitted_verdict(first, last) == "explained":
        return search, []
    drift, left = block_scatter_ratio(search.sized), left_fraction(first.chi2_per_dof, last)
    steady = MAX_RELATIVE_SCATTER
    causes, absent = [n for n in last.model.names if n not in search.minor], perhaps_absent(fitter, search.sized)
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
