"""The course of a diagnosis: first map, search in a part, fit to the whole, finer map, doubtful names out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import (
    LEAST_CHI2_FOR_FINER_MAP,
    DiagnosisSetup,
    baseline_model,
    fit_baseline,
    given_model,
    has_fine_grid,
    keep_fine_grid,
    on_usual_grid,
    with_freed_map,
)
from orchestrator.diagnosis.fitting.candidates import CROSS_SATURATION, SATURATION, CandidateEffect, EffectTerm
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import certainty
from orchestrator.diagnosis.nuisances.segment_scatter import likelihood_of, with_scatter_as_noise
from orchestrator.diagnosis.reporting.motor_model import freed_by, held_baseline, restored
from orchestrator.diagnosis.selection.forward_search import LEAST_EFFECT_SIZE, Search, Step, forward, refit_steps
from orchestrator.diagnosis.selection.interim import InterimRecorder
from orchestrator.diagnosis.selection.joint_workflow import record_finest_map, search_jointly
from orchestrator.diagnosis.selection.quantiser import with_detected_quantiser
from orchestrator.diagnosis.selection.refining import converge, extend_earlier, refit_newest
from orchestrator.diagnosis.selection.scoring import keep_threshold, log_evidence, loss_without
from protocols import Baseline, FluxMap, GivenMap, MotorModel, Nameplate, PluginError, Saturated

NOTEWORTHY_CHI2: float = 1.5
"""chi2 per degree of freedom without an effect above which the effect is no refinement of another's form."""
FEW_EFFECTS: int = 2
"""Effects that are searched one by one; where they do not explain the error, all are fitted together."""
MINOR_EFFECT_SIZE: float = 0.15
"""Effects smaller than this part of their typical size are tested for redundancy."""
MAX_EXCESS_OF_REDUNDANT_EFFECTS: float = 0.03
"""What minor effects may leave of chi2 - 1 when they go, over the root of its value before the first effect."""
OBVIOUS_EFFECT_FACTOR: float = 10.0
"""Factor of that excess which an effect has to be worth, to first order, not to be tested."""
LEAST_UNDETECTED_SIZE: float = 0.03
"""Relative size of an effect that is named though the model fits without it."""
LEAST_CERTAINTY: float = 5.0
"""Amplitude of a minor effect that is named, in standard deviations with the scatter between blocks."""

ModelChoice = str | FluxMap | MotorModel
"""``saturated`` (the free energy map), ``linear`` (the nameplate), a map of one's own, or a whole model.

A whole model's map is held, and its effects are fitted anew to the recording at hand.
"""

(
    EVALUATIONS_LEFT_IF_CLEAN,
    EVALUATIONS_LEFT_WITH_QUANTISER,
    EVALUATIONS_LEFT_FROM_SEARCH,
    EVALUATIONS_LEFT_FROM_WHOLE,
    EVALUATIONS_LEFT_FROM_REPORT,
) = 45.0, 105.0, 80.0, 60.0, 22.0
"""Evaluations of the first model that take as long as a diagnosis from there, where a few effects explain the error:
where nothing is missing, before a modulator's timer is looked for, before effects are, before they are fitted to the
whole, and when the search is over. Medians of benches of one and two effects."""

MAX_CHI2_RATIO_WITH_QUANTISER = 1.2
"""Times the first model's chi2, that no modulator's timer leaves once its rounding is taken out: a false one left
3.2 times as much on a simulated machine."""


def baseline_of(model: ModelChoice) -> Baseline:
    """The baseline that a choice stands for; raises `PluginError` where it is none."""
    if isinstance(model, FluxMap):
        return GivenMap(method=model.method)
    if isinstance(model, MotorModel):
        return held_baseline(model)
    if model not in ("linear", "saturated"):
        raise PluginError("--model", model, "expected linear, saturated, or the path of a flux map or model")
    return Nameplate() if model == "linear" else Saturated()


def first_steps(setup: DiagnosisSetup, model: ModelChoice, library: Mapping[str, CandidateEffect]) -> list[Step]:
    """The ladder's first rungs: the baseline's, and one for each effect of a whole model."""
    baseline = baseline_of(model)
    if isinstance(model, FluxMap):
        return [Step(None, setup.fitter.fit(given_model(setup, model)))]
    if isinstance(model, MotorModel):
        whole = restored(setup, model, baseline, library)
        steps = [Step(None, setup.fitter.fit(whole.with_active([])))]
        for active in whole.active:
            before = steps[-1].fit.model
            steps.append(Step(active.name, setup.fitter.fit(before.with_active([*before.active, active]))))
        return steps
    if isinstance(baseline, Nameplate):
        return [Step(None, setup.fitter.fit(baseline_model(setup, baseline)))]
    return [Step(None, fit_baseline(setup))]


def with_map_step(setup: DiagnosisSetup, fit: Fit, baseline: Nameplate) -> Fit:
    """The nameplate's model refitted with its map so far let go."""
    return setup.fitter.fit(with_freed_map(setup, fit.model, baseline))


def map_steps(
    setup: DiagnosisSetup, model: ModelChoice, library: Mapping[str, CandidateEffect], without: Sequence[str]
) -> list[Step]:
    """`first_steps`, and from a linear baseline the map's own, as far as the data ask for them."""
    steps = first_steps(setup, model, library)
    setup.fitter.trace.record("baseline", steps[-1].fit.model.names, after=steps[-1].fit, taken=True)
    if model != "linear":
        return steps
    baseline = Nameplate()
    for name in (SATURATION, CROSS_SATURATION):
        if name in without:
            break
        freed = freed_by(baseline, name)
        fit = with_map_step(setup, steps[-1].fit, freed)
        gain = 0.5 * (steps[-1].fit.chi2 - fit.chi2) / max(fit.chi2_per_dof, 1.0)
        gain -= 0.5 * (steps[-1].fit.dof - fit.dof) * math.log(fit.dof)
        least = setup.prepared.criteria.selection.log_evidence
        setup.fitter.trace.record(
            "add",
            [name],
            before=steps[-1].fit,
            after=fit,
            measure="log_evidence",
            score=gain,
            threshold=least,
            taken=gain > least,
        )
        if gain > least:
            steps.append(Step(name, fit, gain))
            baseline = freed
    return steps


def search_effects(
    setup: DiagnosisSetup, steps: Sequence[Step], library: Sequence[CandidateEffect], interim: InterimRecorder
) -> tuple[DiagnosisSetup, Search]:
    """Look for a modulator's timer where the baseline leaves something, then for effects with its rounding known."""
    first = steps[-1].fit
    is_clean = first.chi2_per_dof <= first.criteria.selection.detected_chi2
    setup.fitter.begin(
        "search for a few missing effects", EVALUATIONS_LEFT_IF_CLEAN if is_clean else EVALUATIONS_LEFT_WITH_QUANTISER
    )
    if setup.prepared.quantiser is None and first.chi2_per_dof > first.criteria.selection.detected_chi2:
        timed = with_detected_quantiser(setup, first, library)
        if timed is not setup:
            beside = refit_steps(timed, steps)
            # Beside large effects a timer's rounding shows in none of it; where it leaves far more, it is none.
            reached = beside[-1].fit
            setup.fitter.trace.record(
                "quantiser",
                before=first,
                after=reached,
                measure="chi2_per_dof",
                score=reached.chi2_per_dof,
                threshold=MAX_CHI2_RATIO_WITH_QUANTISER * first.chi2_per_dof,
                taken=reached.chi2_per_dof <= MAX_CHI2_RATIO_WITH_QUANTISER * first.chi2_per_dof,
            )
            if reached.chi2_per_dof <= MAX_CHI2_RATIO_WITH_QUANTISER * first.chi2_per_dof:
                setup, steps = timed, beside
    return _search(setup, steps, library, interim)


def _search(
    setup: DiagnosisSetup, steps: Sequence[Step], library: Sequence[CandidateEffect], interim: InterimRecorder
) -> tuple[DiagnosisSetup, Search]:
    """Search in a part of the recording, fit what was found to the whole, and look there for what is small.

    Where a few effects, found one by one, do not explain that part, their readings' zero may differ from segment to
    segment: then that is noise to the setup which comes back. Else all are fitted together.
    """
    if not _explains(steps[-1].fit):
        setup.fitter.begin("search for a few missing effects", EVALUATIONS_LEFT_FROM_SEARCH)
    quick = _quick_search(setup, steps, library)
    interim.record(setup, steps, quick, is_part=True)
    if _explains(quick.fit) or (wider := with_estimated_scatter(setup, quick.fit, library)) is None:
        return _after(quick, setup, steps, library, interim)
    steps = refit_steps(wider, steps)
    beside = wider.coarse_fitter.fit(quick.fit.model, renewals=1)
    wider.coarse_fitter.trace.record("noise", before=quick.fit, after=beside, taken=True)
    if _explains(beside):
        return _search(wider, steps, library, interim)
    # A few effects will not do beside what scatters either.
    quick = replace(quick, steps=[*quick.steps[:-1], replace(quick.steps[-1], fit=beside)])
    return _after(quick, wider, steps, library, interim)


def _explains(fit: Fit) -> bool:
    return fit.chi2_per_dof <= fit.criteria.selection.detected_chi2


def _after(
    quick: Search,
    setup: DiagnosisSetup,
    steps: Sequence[Step],
    library: Sequence[CandidateEffect],
    interim: InterimRecorder,
) -> tuple[DiagnosisSetup, Search]:
    """All effects fitted together where a quick search has not explained its part, else what it found to the whole."""
    if not _explains(quick.fit) and len(library) > 1:
        joint = search_jointly(setup, steps, quick, library, interim)
        if joint is not None:
            return joint
    found = quick.steps[1:]
    if found:
        setup.fitter.begin("the same on the whole recording", EVALUATIONS_LEFT_FROM_WHOLE)
        # What a form does not need costs most on the whole.
        found = [*found[:-1], replace(found[-1], fit=converge(setup.coarse_fitter, found[-1].fit))]
    fits = fit_to_whole(setup, steps, found)
    interim.record(setup, steps, Search(fits, quick.detected_not_named, quick.indistinguishable), is_part=False)
    search = forward(setup.fitter, fits, library, indistinguishable=quick.indistinguishable)
    search.detected_not_named = [
        n
        for n in dict.fromkeys([*quick.detected_not_named, *search.detected_not_named])
        if n not in search.fit.model.names
    ]
    return setup, search


def fit_to_whole(setup: DiagnosisSetup, first: Sequence[Step], found: Sequence[Step]) -> list[Step]:
    """The first steps, fitted to the whole recording already, and those that were found in a part of it."""
    steps = list(first)
    for step in found:
        last = step is found[-1]
        frame = setup.fitter.frame(step.fit.model, steps[-1].fit.frame)
        fit = setup.fitter.fit(step.fit.model, frame, steps=4 if last else 2, renewals=2 if last else 0, tolerance=3e-4)
        steps.append(Step(step.added, fit, step.log_evidence))
    return steps


def with_estimated_scatter(
    setup: DiagnosisSetup, fit: Fit, library: Sequence[CandidateEffect]
) -> DiagnosisSetup | None:
    """The setup with what scatters as noise; None where that does not help."""
    if setup.fitter.noise.of_model.scatters:
        return None
    return with_scatter_as_noise(setup, likelihood_of(setup.coarse_fitter, fit, library))


def _quick_search(setup: DiagnosisSetup, steps: Sequence[Step], library: Sequence[CandidateEffect]) -> Search:
    """The first few effects of a part of the recording, on a finer map where that is what is missing.

    The largest effect is found on a map that it has not bent; what is small may be that map's own detail.
    """
    part = setup.coarse_fitter.fit(steps[-1].fit.model, renewals=0)
    before = len(part.model.active)
    quick = forward(setup.coarse_fitter, [Step(None, part)], library, most=before + 1)
    quick = _with_last(quick, _detailed(setup, quick.fit))
    most = before + FEW_EFFECTS
    quick = _continue_search(quick, setup.coarse_fitter, library, most)
    return _finer(quick, _detailed(setup, quick.fit), setup.coarse_fitter, library, most=most)


def _detailed(setup: DiagnosisSetup, fit: Fit) -> Fit:
    """A part's fit on a finer map, where effects leave more than noise on its own."""
    coarse_map = fit.chi2_per_dof > LEAST_CHI2_FOR_FINER_MAP and fit.model.space.is_free
    return record_finest_map(setup, setup.coarse_fitter, fit) if fit.model.active and coarse_map else fit


def _finer(
    search: Search, fit: Fit, fitter: Fitter, library: Sequence[CandidateEffect], most: int | None = None
) -> Search:
    """The search gone on from its last step on a finer map; as it was where the map is the same."""
    if fit is search.fit:
        return search
    return _continue_search(_with_last(search, fit), fitter, library, most)


def _continue_search(search: Search, fitter: Fitter, library: Sequence[CandidateEffect], most: int | None) -> Search:
    """The search continued from its last step."""
    again = forward(fitter, search.steps, library, indistinguishable=search.indistinguishable, most=most)
    again.detected_not_named = [*search.detected_not_named, *again.detected_not_named]
    return again


def _with_last(search: Search, fit: Fit) -> Search:
    """The search with this fit at its last step."""
    return replace(search, steps=[*search.steps[:-1], replace(search.steps[-1], fit=fit)])


def without(setup: DiagnosisSetup, search: Search, name: str, *, last: Fit | None = None) -> Search:
    """The search with one effect taken out and the rest fitted again; `last` where that fit is there already."""
    others = [a for a in search.fit.model.active if a.name != name]
    steps = search.bare_steps
    for active in others:
        gain = next(s.log_evidence for s in search.steps if s.added == active.name)
        if last is not None and active is others[-1]:
            fit = last
        else:
            model = steps[-1].fit.model
            fit = setup.fitter.fit(model.with_active([*model.active, active]), steps=4, renewals=0, tolerance=1e-3)
        steps.append(Step(active.name, fit, gain))
    return Search(steps, search.detected_not_named, search.indistinguishable)


def converged(setup: DiagnosisSetup, search: Search) -> Search:
    """The search with its last fit taken to its end, in those forms that the whole asks for."""
    if not search.fit.model.active or search.fit.model.names[-1] != search.steps[-1].added:
        return search
    last, fit = search.steps[-1], search.fit
    if not _explains(fit):
        fit = refit_newest(setup.fitter, extend_earlier(setup.fitter, fit), 1.0)
    steps = [*search.steps[:-1], Step(last.added, converge(setup.fitter, fit), last.log_evidence)]
    return Search(steps, search.detected_not_named, search.indistinguishable, search.view)


def coarsen_map(setup: DiagnosisSetup, search: Search) -> Search:
    """The search with its last fit on a usual map, where a sharp one does hardly better now that all is known."""
    fit = search.fit
    if not fit.model.active or not has_fine_grid(fit):
        return search
    usual = setup.fitter.fit(on_usual_grid(setup, fit), steps=8, renewals=2, tolerance=3e-4)
    keeps = keep_fine_grid(fit, usual)
    setup.fitter.trace.record("coarser_map", before=fit, after=usual, taken=not keeps)
    return search if keeps else _with_last(search, usual)


def prune(setup: DiagnosisSetup, search: Search) -> tuple[Search, list[str]]:
    """The search without those effects that can be spared: what they took away may be the others' shape, or chance."""
    removed: list[str] = []
    first = search.steps[0].fit
    while search.fit.model.active:
        full = search.fit
        doubted = sorted((a for a in full.model.active if _is_minor(first, full, a)), key=lambda a: a.relative_size)
        for active in doubted:
            others = full.model.with_active([a for a in full.model.active if a.name != active.name])
            less = setup.fitter.fit(others, steps=4, renewals=0, tolerance=3e-3)
            spare = _is_redundant(first, less, full, active.name)
            setup.fitter.trace.record(
                "remove",
                [active.name],
                before=full,
                after=less,
                measure="log_evidence",
                score=-_evidence_lost(full, less),
                threshold=-keep_threshold(full, active.candidate),
                taken=spare,
                note="small, uncertain, or what another effect's form makes" if spare else "",
            )
            if spare:
                removed.append(active.name)
                search = without(setup, search, active.name, last=less)
                break
        else:
            break
    return search, removed


def _is_minor(first: Fit, full: Fit, active: EffectTerm) -> bool:
    """Whether an effect is small, and not one that obviously nothing else could stand in for."""
    lost = loss_without(full, active, active.candidate.amplitudes) / full.dof
    return active.relative_size < MINOR_EFFECT_SIZE and lost < OBVIOUS_EFFECT_FACTOR * _redundancy_limit(first)


def _redundancy_limit(first: Fit) -> float:
    """What minor effects may leave of chi2 - 1 when they go."""
    limits = first.criteria.selection
    return max(
        limits.detected_chi2 - 1.0, MAX_EXCESS_OF_REDUNDANT_EFFECTS * math.sqrt(max(first.chi2_per_dof - 1.0, 0.0))
    )


def _evidence_lost(full: Fit, less: Fit) -> float:
    """By how much the log evidence falls without an effect, noise as large as all effects leave it."""
    inflation = max(1.0, full.chi2_per_dof)
    return log_evidence(full, inflation) - log_evidence(less, inflation)


def _is_redundant(first: Fit, without: Fit, full: Fit, name: str) -> bool:
    limits, active = full.criteria.selection, next(a for a in full.model.active if a.name == name)
    size = active.relative_size
    gained = _evidence_lost(full, without)
    if active.candidate.included_a_priori:
        return gained < keep_threshold(full, active.candidate)
    if size < LEAST_EFFECT_SIZE or certainty(full)[name] < LEAST_CERTAINTY:
        return True
    if gained < keep_threshold(full, active.candidate):
        return True
    if without.chi2_per_dof < limits.detected_chi2 and size < LEAST_UNDETECTED_SIZE:
        return True
    # Another effect's slightly wrong form leaves something; what takes all of it away is itself.
    to_the_noise = full.chi2_per_dof <= limits.detected_chi2 and without.chi2_per_dof > NOTEWORTHY_CHI2
    if len(full.model.active) < 2 or to_the_noise:
        return False
    return without.chi2_per_dof - 1.0 < _redundancy_limit(first)
