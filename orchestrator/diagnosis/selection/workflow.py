"""The course of a diagnosis: first map, search in a part, fit to the whole, finer map, doubtful names out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from orchestrator.diagnosis.fitting.baseline import (
    Start,
    baseline_model,
    fitted_baseline,
    freed_further,
    given_model,
    with_detail,
)
from orchestrator.diagnosis.fitting.candidates import CROSS_SATURATION, MAGNETIC, SATURATION, Active, Candidate
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.ladder import verdict_of
from orchestrator.diagnosis.reporting.motor_model import freed_by, held_baseline, restored
from orchestrator.diagnosis.selection.forward_search import (
    Search,
    Step,
    forward,
    log_evidence,
    loss_without,
    settled,
)
from orchestrator.diagnosis.uncertainty.trust import certainty, foretold, inconstancy
from protocols import Baseline, FluxMap, GivenMap, MotorModel, Nameplate, PluginError, Saturated

ModelChoice = str | FluxMap | MotorModel
"""``saturated`` (the free energy map), ``linear`` (the nameplate), a map of one's own, or a whole model.

A whole model's map is held, and its effects are fitted anew to the recording at hand.
"""


def baseline_of(model: ModelChoice) -> Baseline:
    """The baseline that a choice stands for; raises `PluginError` where it is none."""
    if isinstance(model, FluxMap):
        return GivenMap(method=model.method)
    if isinstance(model, MotorModel):
        return held_baseline(model)
    if model not in ("linear", "saturated"):
        raise PluginError("--model", model, "expected linear, saturated, or the path of a flux map or model")
    return Nameplate() if model == "linear" else Saturated()


def first_steps(start: Start, model: ModelChoice, library: Mapping[str, Candidate]) -> list[Step]:
    """The ladder's first rungs: the baseline's, and one for each effect of a whole model."""
    baseline = baseline_of(model)
    if isinstance(model, FluxMap):
        return [Step(None, start.fitter.fit(given_model(start, model)))]
    if isinstance(model, MotorModel):
        whole = restored(start, model, baseline, library)
        steps = [Step(None, start.fitter.fit(whole.with_active([])))]
        for active in whole.active:
            before = steps[-1].fit.model
            steps.append(Step(active.name, start.fitter.fit(before.with_active([*before.active, active]))))
        return steps
    if isinstance(baseline, Nameplate):
        return [Step(None, start.fitter.fit(baseline_model(start, baseline)))]
    return [Step(None, fitted_baseline(start))]


def with_map_step(start: Start, fit: Fit, baseline: Nameplate) -> Fit:
    """The nameplate's model refitted with its map so far let go."""
    return start.fitter.fit(freed_further(start, fit.model, baseline))


def map_steps(start: Start, model: ModelChoice, library: Mapping[str, Candidate], without: Sequence[str]) -> list[Step]:
    """`first_steps`, and from a linear baseline the map's own, as far as the data ask for them."""
    steps = first_steps(start, model, library)
    if model != "linear":
        return steps
    baseline = Nameplate()
    for name in (SATURATION, CROSS_SATURATION):
        if name in without:
            break
        freed = freed_by(baseline, name)
        fit = with_map_step(start, steps[-1].fit, freed)
        gain = 0.5 * (steps[-1].fit.chi2 - fit.chi2) / max(fit.chi2_per_dof, 1.0)
        gain -= 0.5 * (steps[-1].fit.dof - fit.dof) * math.log(fit.dof)
        if gain > start.prepared.criteria.selection.log_evidence:
            steps.append(Step(name, fit, gain))
            baseline = freed
    return steps


def search_effects(start: Start, steps: Sequence[Step], library: Sequence[Candidate]) -> Search:
    """Search in a part of the recording, fit what was found to the whole, and look there for what is small."""
    part = start.coarse.fit(steps[-1].fit.model, renewals=0)
    quick = forward(start.coarse, [Step(None, part)], library)
    coarse_map = quick.fit.chi2_per_dof > start.criteria.finer_above_chi2 and quick.fit.model.space.is_free
    if quick.fit.model.active and coarse_map:
        quick = _finer(quick, with_detail(start, start.coarse, quick.fit), start.coarse, library)
    fits = list(steps)
    for step in quick.steps[1:]:
        last = step is quick.steps[-1]
        frame = start.fitter.frame(step.fit.model, fits[-1].fit.frame)
        fit = start.fitter.fit(step.fit.model, frame, steps=4 if last else 2, renewals=1 if last else 0, tolerance=3e-4)
        fits.append(Step(step.added, fit, step.log_evidence))
    found = forward(start.fitter, fits, library, rivals=quick.rivals)
    found.traces = [n for n in dict.fromkeys([*quick.traces, *found.traces]) if n not in found.fit.model.names]
    return found


def on_a_finer_map(start: Start, search: Search, library: Sequence[Candidate]) -> Search:
    """Whether what is left is the map's own detail, which big effects hid at first."""
    fit = search.fit
    detected = fit.criteria.selection.detected_chi2
    if not fit.model.active or fit.chi2_per_dof < detected or not fit.model.space.is_free:
        return search
    return _finer(search, with_detail(start, start.fitter, fit), start.fitter, library)


def _finer(search: Search, fit: Fit, fitter: Fitter, library: Sequence[Candidate]) -> Search:
    """The search gone on from its last step on a finer map; as it was where the map is the same."""
    if fit is search.fit:
        return search
    steps = [*search.steps[:-1], Step(search.steps[-1].added, fit, search.steps[-1].log_evidence)]
    again = forward(fitter, steps, library, rivals=search.rivals)
    again.traces = [*search.traces, *again.traces]
    return again


def without_doubtful(start: Start, search: Search) -> tuple[Search, list[str]]:
    """While something unknown remains, an effect whose size drifts is a stand-in for it and is not named.

    Nor is one that takes away less than remains.
    """
    doubtful: list[str] = []
    first, steady = search.steps[0].fit, start.prepared.criteria.selection.least_constancy
    while search.fit.model.active and verdict_of(first, search.fit, 1) != "explained":
        drift = inconstancy(search.fit)
        if verdict_of(first, search.fit, 1) == "unknown_remains":
            drift = {name: max(size, steady * _left_over_own(search, name)) for name, size in drift.items()}
        worst = max(drift, key=lambda name: drift[name])
        if drift[worst] <= steady:
            break
        doubtful.append(worst)
        search = without(start, search, worst)
    return search, doubtful


def _left_over_own(search: Search, name: str) -> float:
    """What is left of chi2 over what one effect took away of it when it was added, as amplitudes."""
    at = next(k for k, step in enumerate(search.steps) if step.added == name)
    own = search.steps[at - 1].fit.chi2_per_dof - search.steps[at].fit.chi2_per_dof
    left = search.fit.chi2_per_dof - 1.0
    return math.sqrt(max(left, 0.0) / own) if own > 0.0 else math.inf


def without(start: Start, search: Search, name: str, *, last: Fit | None = None) -> Search:
    """The search with one effect taken out and the rest fitted again; `last` where that fit is there already."""
    kept = [a for a in search.fit.model.active if a.name != name]
    steps = [s for s in search.steps if s.added is None or s.added in MAGNETIC]
    for active in kept:
        gain = next(s.log_evidence for s in search.steps if s.added == active.name)
        if last is not None and active is kept[-1]:
            fit = last
        else:
            model = steps[-1].fit.model
            fit = start.fitter.fit(model.with_active([*model.active, active]), steps=4, renewals=0, tolerance=1e-3)
        steps.append(Step(active.name, fit, gain))
    return Search(steps, search.traces, search.rivals)


def converged(start: Start, search: Search) -> Search:
    """The search with its last fit taken to its end."""
    if not search.fit.model.active or search.fit.model.names[-1] != search.steps[-1].added:
        return search
    last = search.steps[-1]
    steps = [*search.steps[:-1], Step(last.added, settled(start.fitter, last.fit), last.log_evidence)]
    return Search(steps, search.traces, search.rivals, search.view)


def pruned(start: Start, search: Search) -> tuple[Search, list[str]]:
    """The search without those effects that can be spared: what they took away may be the others' shape, or chance."""
    spared: list[str] = []
    first = search.steps[0].fit
    while search.fit.model.active:
        full = search.fit
        doubted = sorted((a for a in full.model.active if _is_minor(first, full, a)), key=lambda a: a.relative_size)
        for active in doubted:
            others = full.model.with_active([a for a in full.model.active if a.name != active.name])
            less = start.fitter.fit(others, steps=4, renewals=0, tolerance=3e-3)
            if _can_be_spared(first, less, full, active.name):
                spared.append(active.name)
                search = without(start, search, active.name, last=less)
                break
        else:
            break
    return search, spared


def _is_minor(first: Fit, full: Fit, active: Active) -> bool:
    """Whether an effect is small, and not one that obviously nothing else could stand in for."""
    lost = loss_without(full, active, active.candidate.amplitudes) / full.dof
    limits = full.criteria.selection
    return active.relative_size < limits.minor_size and lost < limits.obvious * _spare(first)


def _spare(first: Fit) -> float:
    """What minor effects may leave of chi2 - 1 when they go."""
    limits = first.criteria.selection
    return max(limits.detected_chi2 - 1.0, limits.spare * math.sqrt(max(first.chi2_per_dof - 1.0, 0.0)))


def _can_be_spared(first: Fit, without: Fit, full: Fit, name: str) -> bool:
    limits, size = full.criteria.selection, next(a.relative_size for a in full.model.active if a.name == name)
    if size < limits.least_size or certainty(full)[name] < limits.least_certainty:
        return True
    inflation = max(1.0, full.chi2_per_dof)
    if log_evidence(full, inflation) - log_evidence(without, inflation) < limits.log_evidence:
        return True
    undetected = without.chi2_per_dof < limits.detected_chi2
    if undetected and (size < limits.undetected_size or not foretold(without, full)):
        return True
    if len(full.model.active) < 2:
        return False
    return without.chi2_per_dof - 1.0 < _spare(first)
