"""Sequence of a diagnosis: first map, search in a part, fit to the whole, finer map, removal of redundant effects."""

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
from orchestrator.diagnosis.fitting.candidates import CROSS_SATURATION, SATURATION, CandidateEffect, EffectTerm, Library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.judgement.intervals import certainty
from orchestrator.diagnosis.nuisances.segment_scatter import likelihood_of, with_scatter_as_noise
from orchestrator.diagnosis.reporting.motor_model import freed_by, held_baseline, restored
from orchestrator.diagnosis.selection.forward_search import (
    MIN_EFFECT_SIZE,
    AcceptedModel,
    SearchResult,
    forward,
    refit_steps,
)
from orchestrator.diagnosis.selection.interim import InterimRecorder
from orchestrator.diagnosis.selection.joint_workflow import record_finest_map, search_jointly
from orchestrator.diagnosis.selection.quantiser import with_detected_quantiser
from orchestrator.diagnosis.selection.refining import converge, extend_earlier, refit_newest
from orchestrator.diagnosis.selection.scoring import keep_threshold, log_evidence, loss_without
from protocols import Baseline, FluxMap, GivenMap, MotorModel, Nameplate, PluginError, Saturated

NOTEWORTHY_CHI2: float = 1.5
"""chi2 per degree of freedom without an effect above which no refinement of another can replace it."""
FEW_EFFECTS: int = 2
"""Number of effects searched one by one; where they do not explain the error, all are fitted together."""
MINOR_EFFECT_SIZE: float = 0.15
"""Size of an effect, relative to its typical size, below which it is tested for redundancy."""
MAX_EXCESS_OF_REDUNDANT_EFFECTS: float = 0.03
"""Excess chi2 allowed without the minor effects, over the root of the excess before the first effect."""
OBVIOUS_EFFECT_FACTOR: float = 10.0
"""Factor of that excess from which an effect's linear loss exempts it from the test."""
MIN_UNDETECTED_SIZE: float = 0.03
"""Relative size from which an effect is named although the model fits without it."""
MIN_CERTAINTY: float = 5.0
"""Significance from which a minor effect is named, in standard deviations including the scatter between blocks."""

ModelChoice = str | FluxMap | MotorModel
"""``saturated`` (the free energy map), ``linear`` (the nameplate), a given map, or a whole model.

A whole model's map is held fixed, and its effects are refitted to the recording.
"""

# Expected remaining time, in evaluations of the first model; medians of benches of one and two effects.
EVALUATIONS_LEFT_IF_CLEAN = 45.0
"""At the start, where the first model leaves only noise."""
EVALUATIONS_LEFT_WITH_QUANTISER = 105.0
"""At the start of the detection of a modulator's timer."""
EVALUATIONS_LEFT_FROM_SEARCH = 80.0
"""At the start of the search for effects."""
EVALUATIONS_LEFT_FROM_WHOLE = 60.0
"""At the start of the fit to the whole recording."""
EVALUATIONS_LEFT_FROM_REPORT = 22.0
"""At the end of the search."""

MAX_CHI2_RATIO_WITH_QUANTISER = 1.2
"""Largest ratio of chi2 with a detected timer's rounding to that without; a false detection had a ratio of 3.2."""


def baseline_of(model: ModelChoice) -> Baseline:
    """The baseline of a model choice; raises `PluginError` for an unknown one."""
    if isinstance(model, FluxMap):
        return GivenMap(method=model.method)
    if isinstance(model, MotorModel):
        return held_baseline(model)
    if model not in ("linear", "saturated"):
        raise PluginError("--model", model, "expected linear, saturated, or the path of a flux map or model")
    return Nameplate() if model == "linear" else Saturated()


def first_steps(
    setup: DiagnosisSetup, model: ModelChoice, library: Mapping[str, CandidateEffect]
) -> list[AcceptedModel]:
    """First steps of the ladder: the baseline, and one for each effect of a whole model."""
    baseline = baseline_of(model)
    if isinstance(model, FluxMap):
        return [AcceptedModel(None, setup.fitter.fit(given_model(setup, model)))]
    if isinstance(model, MotorModel):
        whole = restored(setup, model, baseline, library)
        steps = [AcceptedModel(None, setup.fitter.fit(whole.with_active([])))]
        for active in whole.active:
            before = steps[-1].fit.model
            steps.append(AcceptedModel(active.name, setup.fitter.fit(before.with_active([*before.active, active]))))
        return steps
    if isinstance(baseline, Nameplate):
        return [AcceptedModel(None, setup.fitter.fit(baseline_model(setup, baseline)))]
    return [AcceptedModel(None, fit_baseline(setup))]


def with_map_step(setup: DiagnosisSetup, fit: Fit, baseline: Nameplate) -> Fit:
    """The nameplate's model refitted with its map freed as far as the baseline says."""
    return setup.fitter.fit(with_freed_map(setup, fit.model, baseline))


def map_steps(
    setup: DiagnosisSetup, model: ModelChoice, library: Mapping[str, CandidateEffect], excluded: Sequence[str]
) -> list[AcceptedModel]:
    """`first_steps`; from a linear baseline also those that free the map, as far as the data require them."""
    steps = first_steps(setup, model, library)
    setup.fitter.trace.record("baseline", steps[-1].fit.model.names, after=steps[-1].fit, taken=True)
    if model != "linear":
        return steps
    baseline = Nameplate()
    for name in (SATURATION, CROSS_SATURATION):
        if name in excluded:
            break
        freed = freed_by(baseline, name)
        fit = with_map_step(setup, steps[-1].fit, freed)
        gain = 0.5 * (steps[-1].fit.chi2 - fit.chi2) / max(fit.chi2_per_dof, 1.0)
        gain -= 0.5 * (steps[-1].fit.dof - fit.dof) * math.log(fit.dof)
        min_gain = setup.prepared.criteria.selection.log_evidence
        setup.fitter.trace.record(
            "add",
            [name],
            before=steps[-1].fit,
            after=fit,
            measure="log_evidence",
            score=gain,
            threshold=min_gain,
            taken=gain > min_gain,
        )
        if gain > min_gain:
            steps.append(AcceptedModel(name, fit, gain))
            baseline = freed
    return steps


def search_effects(
    setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library, interim: InterimRecorder
) -> tuple[DiagnosisSetup, SearchResult]:
    """Detect a modulator's timer where the baseline leaves a misfit, then search effects with its rounding applied."""
    first = steps[-1].fit
    is_clean = first.chi2_per_dof <= first.criteria.selection.detected_chi2
    setup.fitter.begin(
        "search for a few missing effects", EVALUATIONS_LEFT_IF_CLEAN if is_clean else EVALUATIONS_LEFT_WITH_QUANTISER
    )
    if setup.prepared.quantiser is None and first.chi2_per_dof > first.criteria.selection.detected_chi2:
        timed = with_detected_quantiser(setup, first, library)
        if timed is not setup:
            beside = refit_steps(timed, steps)
            # Large effects hide a true timer's rounding, but only a false one raises chi2 much.
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
    setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library, interim: InterimRecorder
) -> tuple[DiagnosisSetup, SearchResult]:
    """Search in a part of the recording, refit its effects to the whole, and search there for small ones."""
    # Where a few effects do not explain the part, sensor offsets may vary between segments, which then count as noise;
    # otherwise all effects are fitted together.
    if not _explains(steps[-1].fit):
        setup.fitter.begin("search for a few missing effects", EVALUATIONS_LEFT_FROM_SEARCH)
    quick = _quick_search(setup, steps, library)
    interim.record(setup, steps, quick, is_part=True)
    if _explains(quick.fit) or (wider := with_estimated_scatter(setup, quick.fit, library)) is None:
        return _after(quick, setup, steps, library, interim)
    steps = refit_steps(wider, steps)
    beside = wider.part_fitter.fit(quick.fit.model, relinearisations=1)
    wider.part_fitter.trace.record("noise", before=quick.fit, after=beside, taken=True)
    if _explains(beside):
        return _search(wider, steps, library, interim)
    # A few effects do not suffice with the segment scatter as noise either.
    quick = replace(quick, steps=[*quick.steps[:-1], replace(quick.steps[-1], fit=beside)])
    return _after(quick, wider, steps, library, interim)


def _explains(fit: Fit) -> bool:
    return fit.chi2_per_dof <= fit.criteria.selection.detected_chi2


def _after(
    quick: SearchResult,
    setup: DiagnosisSetup,
    steps: Sequence[AcceptedModel],
    library: Library,
    interim: InterimRecorder,
) -> tuple[DiagnosisSetup, SearchResult]:
    """Joint search where the quick search has not explained its part, else its effects refitted to the whole."""
    if not _explains(quick.fit) and len(library) > 1:
        joint = search_jointly(setup, steps, quick, library, interim)
        if joint is not None:
            return joint
    found = quick.steps[1:]
    if found:
        setup.fitter.begin("the same on the whole recording", EVALUATIONS_LEFT_FROM_WHOLE)
        # Superfluous refinements are most expensive on the whole recording.
        found = [*found[:-1], replace(found[-1], fit=converge(setup.part_fitter, found[-1].fit))]
    fits = fit_to_whole(setup, steps, found)
    interim.record(setup, steps, SearchResult(fits, quick.detected_not_named, quick.indistinguishable), is_part=False)
    search = forward(setup.fitter, fits, library, indistinguishable=quick.indistinguishable)
    search.detected_not_named = [
        n
        for n in dict.fromkeys([*quick.detected_not_named, *search.detected_not_named])
        if n not in search.fit.model.names
    ]
    return setup, search


def fit_to_whole(
    setup: DiagnosisSetup, first: Sequence[AcceptedModel], found: Sequence[AcceptedModel]
) -> list[AcceptedModel]:
    """The first models, and those found in a part refitted to the whole recording."""
    steps = list(first)
    for step in found:
        last = step is found[-1]
        linearisation = setup.fitter.linearise(step.fit.model, steps[-1].fit.linearisation)
        count, again = (4, 2) if last else (2, 0)
        fit = setup.fitter.fit(step.fit.model, linearisation, steps=count, relinearisations=again, tolerance=3e-4)
        steps.append(AcceptedModel(step.added, fit, step.log_evidence))
    return steps


def with_estimated_scatter(setup: DiagnosisSetup, fit: Fit, library: Library) -> DiagnosisSetup | None:
    """The setup with estimated segment scatter as noise; None where that does not help."""
    if setup.fitter.noise.of_model.scatters:
        return None
    return with_scatter_as_noise(setup, likelihood_of(setup.part_fitter, fit, library))


def _quick_search(setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library) -> SearchResult:
    """Search the first few effects in a part of the recording, on a finer map where the data require it."""
    # The largest effect is found before a finer map can adapt to it; small ones may be due to a coarse map.
    part = setup.part_fitter.fit(steps[-1].fit.model, relinearisations=0)
    before = len(part.model.active)
    quick = forward(setup.part_fitter, [AcceptedModel(None, part)], library, max_effects=before + 1)
    quick = _with_last(quick, _detailed(setup, quick.fit))
    max_effects = before + FEW_EFFECTS
    quick = _continue_search(quick, setup.part_fitter, library, max_effects)
    return _finer(quick, _detailed(setup, quick.fit), setup.part_fitter, library, max_effects=max_effects)


def _detailed(setup: DiagnosisSetup, fit: Fit) -> Fit:
    """A part's fit on a finer map, where its effects leave more than noise."""
    coarse_map = fit.chi2_per_dof > LEAST_CHI2_FOR_FINER_MAP and fit.model.space.is_free
    return record_finest_map(setup, setup.part_fitter, fit) if fit.model.active and coarse_map else fit


def _finer(
    search: SearchResult, fit: Fit, fitter: Fitter, library: Library, max_effects: int | None = None
) -> SearchResult:
    """The search continued on a finer map; unchanged where the map is the same."""
    if fit is search.fit:
        return search
    return _continue_search(_with_last(search, fit), fitter, library, max_effects)


def _continue_search(search: SearchResult, fitter: Fitter, library: Library, max_effects: int | None) -> SearchResult:
    """The search continued from its last step."""
    again = forward(fitter, search.steps, library, indistinguishable=search.indistinguishable, max_effects=max_effects)
    again.detected_not_named = [*search.detected_not_named, *again.detected_not_named]
    return again


def _with_last(search: SearchResult, fit: Fit) -> SearchResult:
    """The search with its last fit replaced."""
    return replace(search, steps=[*search.steps[:-1], replace(search.steps[-1], fit=fit)])


def without_effect(setup: DiagnosisSetup, search: SearchResult, name: str, *, last: Fit | None = None) -> SearchResult:
    """The search with one effect removed and the others refitted; `last` is that fit where it is known already."""
    others = [a for a in search.fit.model.active if a.name != name]
    steps = search.baseline_models
    for active in others:
        gain = next(s.log_evidence for s in search.steps if s.added == active.name)
        if last is not None and active is others[-1]:
            fit = last
        else:
            model = steps[-1].fit.model
            fit = setup.fitter.fit(
                model.with_active([*model.active, active]), steps=4, relinearisations=0, tolerance=1e-3
            )
        steps.append(AcceptedModel(active.name, fit, gain))
    return SearchResult(steps, search.detected_not_named, search.indistinguishable)


def converged(setup: DiagnosisSetup, search: SearchResult) -> SearchResult:
    """The search with its last fit converged, in the forms that the whole recording requires."""
    if not search.fit.model.active or search.fit.model.names[-1] != search.steps[-1].added:
        return search
    last, fit = search.steps[-1], search.fit
    if not _explains(fit):
        fit = refit_newest(setup.fitter, extend_earlier(setup.fitter, fit), 1.0)
    steps = [*search.steps[:-1], AcceptedModel(last.added, converge(setup.fitter, fit), last.log_evidence)]
    return SearchResult(steps, search.detected_not_named, search.indistinguishable, search.view)


def coarsen_map(setup: DiagnosisSetup, search: SearchResult) -> SearchResult:
    """The search with its last fit on the usual map, where a fine one no longer gains."""
    fit = search.fit
    if not fit.model.active or not has_fine_grid(fit):
        return search
    usual = setup.fitter.fit(on_usual_grid(setup, fit), steps=8, relinearisations=2, tolerance=3e-4)
    keeps = keep_fine_grid(fit, usual)
    setup.fitter.trace.record("coarser_map", before=fit, after=usual, taken=not keeps)
    return search if keeps else _with_last(search, usual)


def prune(setup: DiagnosisSetup, search: SearchResult) -> tuple[SearchResult, list[str]]:
    """The search without redundant effects, whose gain may be the others' shape or chance, and their names."""
    removed: list[str] = []
    first = search.steps[0].fit
    while search.fit.model.active:
        full = search.fit
        doubted = sorted((a for a in full.model.active if _is_minor(first, full, a)), key=lambda a: a.relative_size)
        for active in doubted:
            others = full.model.with_active([a for a in full.model.active if a.name != active.name])
            less = setup.fitter.fit(others, steps=4, relinearisations=0, tolerance=3e-3)
            is_redundant = _is_redundant(first, less, full, active.name)
            setup.fitter.trace.record(
                "remove",
                [active.name],
                before=full,
                after=less,
                measure="log_evidence",
                score=-_evidence_lost(full, less),
                threshold=-keep_threshold(full, active.candidate),
                taken=is_redundant,
                note="small, uncertain, or what another effect's form makes" if is_redundant else "",
            )
            if is_redundant:
                removed.append(active.name)
                search = without_effect(setup, search, active.name, last=less)
                break
        else:
            break
    return search, removed


def _is_minor(first: Fit, full: Fit, active: EffectTerm) -> bool:
    """Whether an effect is small and its linear loss does not make it obviously necessary."""
    lost = loss_without(full, active, active.candidate.amplitudes) / full.dof
    return active.relative_size < MINOR_EFFECT_SIZE and lost < OBVIOUS_EFFECT_FACTOR * _redundancy_limit(first)


def _redundancy_limit(first: Fit) -> float:
    """Largest chi2 - 1 allowed without the minor effects."""
    limits = first.criteria.selection
    return max(
        limits.detected_chi2 - 1.0, MAX_EXCESS_OF_REDUNDANT_EFFECTS * math.sqrt(max(first.chi2_per_dof - 1.0, 0.0))
    )


def _evidence_lost(full: Fit, less: Fit) -> float:
    """Loss of log evidence without an effect, with the noise inflated to the full model's residual."""
    inflation = max(1.0, full.chi2_per_dof)
    return log_evidence(full, inflation) - log_evidence(less, inflation)


def _is_redundant(first: Fit, reduced: Fit, full: Fit, name: str) -> bool:
    limits, active = full.criteria.selection, next(a for a in full.model.active if a.name == name)
    size = active.relative_size
    gained = _evidence_lost(full, reduced)
    if active.candidate.included_a_priori:
        return gained < keep_threshold(full, active.candidate)
    if size < MIN_EFFECT_SIZE or certainty(full)[name] < MIN_CERTAINTY:
        return True
    if gained < keep_threshold(full, active.candidate):
        return True
    if reduced.chi2_per_dof < limits.detected_chi2 and size < MIN_UNDETECTED_SIZE:
        return True
    # Another effect's slightly wrong form would leave a misfit; an effect that removes all of it is real.
    to_the_noise = full.chi2_per_dof <= limits.detected_chi2 and reduced.chi2_per_dof > NOTEWORTHY_CHI2
    if len(full.model.active) < 2 or to_the_noise:
        return False
    return reduced.chi2_per_dof - 1.0 < _redundancy_limit(first)
