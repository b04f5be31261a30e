"""The models that a search starts from: the baseline, and those that only free its map."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from orchestrator.diagnosis.fitting.baseline import (
    DiagnosisSetup,
    baseline_model,
    fit_baseline,
    given_model,
    with_freed_map,
)
from orchestrator.diagnosis.fitting.candidates import CROSS_SATURATION, SATURATION, CandidateEffect
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.motor_model import freed_by, held_baseline, restored
from orchestrator.diagnosis.selection.search_result import AcceptedModel
from protocols import Baseline, FluxMap, GivenMap, MotorModel, Nameplate, PluginError, Saturated

ModelChoice = str | FluxMap | MotorModel
"""``saturated`` (the free energy map), ``linear`` (the nameplate), a given map, or a whole model.

A whole model's map is held fixed, and its effects are refitted to the recording.
"""


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
