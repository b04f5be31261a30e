"""The models that a search starts from: the baseline, those that only free its map, and effects included before it.

These are effects that the readings establish, and those that the fleet expects: a search by the largest single gain may
explain the error of two effects by one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import (
    DiagnosisSetup,
    baseline_model,
    fit_baseline,
    given_model,
    with_freed_map,
)
from orchestrator.diagnosis.fitting.candidates import (
    CROSS_SATURATION,
    SATURATION,
    CandidateEffect,
    EffectTerm,
    Library,
    standardised,
)
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.motor_model import freed_by, held_baseline, restored
from orchestrator.diagnosis.selection.search_state import AcceptedModel, SearchState, evidence_gain
from orchestrator.diagnosis.selection.shape_moves import with_best_shapes
from protocols import (
    Baseline,
    FluxMap,
    GivenMap,
    MotorModel,
    Nameplate,
    ParameterRole,
    PluginError,
    Saturated,
    Signals,
    hook_of,
)

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


def first_models(
    setup: DiagnosisSetup, model: ModelChoice, every: Library, library: Library, excluded: Sequence[str]
) -> list[AcceptedModel]:
    """The models before a search; the budget is calibrated with the first of them.

    Parameters
    ----------
    every : sequence of CandidateEffect
        The effects of a whole model are among these.
    library : sequence of CandidateEffect
        The effects that are searched.
    excluded : sequence of str
        Effects, or steps that free the map, which no model has.
    """
    steps = map_steps(setup, model, {c.name: c for c in every}, excluded)
    setup.fitter.budget.calibrate()
    return include_expected(setup, include_measured(setup, steps, library), library)


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
        if _accept(setup, steps, AcceptedModel(name, fit, gain), setup.prepared.criteria.selection.log_evidence):
            baseline = freed
    return steps


def _accept(
    setup: DiagnosisSetup, steps: list[AcceptedModel], step: AcceptedModel, threshold: float | None, note: str = ""
) -> bool:
    """Extend the ladder by a step whose log evidence exceeds a threshold, or by any without one; whether it does."""
    assert step.added is not None
    taken = threshold is None or step.log_evidence > threshold
    setup.fitter.trace.record(
        "add",
        [step.added],
        before=steps[-1].fit,
        after=step.fit,
        measure="log_evidence",
        score=step.log_evidence,
        threshold=threshold,
        taken=taken,
        note=note,
    )
    if taken:
        steps.append(step)
    return taken


def include_expected(setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library) -> list[AcceptedModel]:
    """The ladder with each effect that the fleet's prior includes; the end of the search tests it."""
    given, steps = len(steps), list(steps)
    for candidate in library:
        before = steps[-1].fit
        if not candidate.included_a_priori or candidate.name in before.model.names:
            continue
        active = candidate.absent().release(*candidate.of_role(ParameterRole.SHAPE))
        for name, x in candidate.centres.items():
            active = active.moved(name, x)
        model = before.model.with_active([*before.model.active, active])
        fit = setup.fitter.fit(model, before.linearisation, relinearisations=0)
        step = AcceptedModel(candidate.name, fit, evidence_gain(fit, before))
        _accept(setup, steps, step, None, "the fleet has it nearly always")
    if len(steps) > given:
        # Refinements are released once all of these effects are present: a missing one would distort them.
        last = steps[-1]
        state = SearchState(setup, last.fit, last.fit.chi2_per_dof, is_part=False)
        steps[-1] = replace(last, fit=with_best_shapes(state).fit)
    return steps


def include_measured(setup: DiagnosisSetup, steps: Sequence[AcceptedModel], library: Library) -> list[AcceptedModel]:
    """The ladder extended by each effect that measures itself from the readings, where the evidence confirms it.

    Raises
    ------
    PluginError
        If an effect's `measured` fails.
    """
    signals, steps = [piece.signals for piece in setup.prepared.pieces], list(steps)
    for candidate in library:
        before = steps[-1].fit
        active = None if candidate.name in before.model.names else _from_readings(candidate, signals)
        if active is None:
            continue
        fit = setup.fitter.fit(before.model.with_active([*before.model.active, active]))
        gain = 0.5 * (before.chi2 - fit.chi2) / max(fit.chi2_per_dof, 1.0)
        note = "its size was measured by the readings alone"
        step = AcceptedModel(candidate.name, fit, gain)
        _accept(setup, steps, step, fit.criteria.selection.log_evidence, note)
    return steps


def _from_readings(candidate: CandidateEffect, signals: Sequence[Signals]) -> EffectTerm | None:
    measured = hook_of(candidate.effect, "measured")
    try:
        found = None if measured is None else measured(signals)
        values = {} if found is None else {name: float(getattr(found, name)) for name in candidate.amplitudes}
    except Exception as error:  # somebody else's code may raise anything
        raise PluginError("effects", candidate.name, f"measured: {type(error).__name__}: {error}") from error
    active = candidate.absent()
    for name, value in values.items():
        active = active.moved(name, standardised(candidate.named(name), value))
    return None if active.is_absent else active
