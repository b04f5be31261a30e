"""Diagnosis of a recording: the search for missing effects, the verdict on the residual, and the report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from orchestrator.config.time_constants import recording_notes
from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import (
    MAP_RUNGS,
    Library,
    observable_effects,
    require_known,
    scaled_library,
)
from orchestrator.diagnosis.fitting.guarded import is_own
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.fitting.priors import contradicts_fleet, fleet_remarks, require_same_motor, with_priors
from orchestrator.diagnosis.fitting.workers import Executor, executor_of
from orchestrator.diagnosis.judgement.contributions import (
    contributions,
    left_of_excitation,
    mean_currents,
    rated_flux_wb,
)
from orchestrator.diagnosis.judgement.form_mixture import mix_forms
from orchestrator.diagnosis.judgement.judge import judge
from orchestrator.diagnosis.judgement.map_band import MapUncertainty
from orchestrator.diagnosis.judgement.sufficiency import solvable
from orchestrator.diagnosis.judgement.verdict import residual_fraction_of, verdict_record
from orchestrator.diagnosis.nuisances.segment_scatter import nuisance_remarks
from orchestrator.diagnosis.reporting.convention import convention_report
from orchestrator.diagnosis.reporting.delivery import Delivery, delivery_of
from orchestrator.diagnosis.reporting.findings import (
    credible_effects,
    effect_remarks,
    found_effects,
    map_effects,
    size_remarks,
    unexplained,
)
from orchestrator.diagnosis.reporting.ladder import current_error, held_out, noise_rms_v, rung, training
from orchestrator.diagnosis.reporting.motor_model import flux_of, kept_model, reduced
from orchestrator.diagnosis.reporting.own_effects import contract_remarks, own_effect_remarks
from orchestrator.diagnosis.reporting.parameter_bounds import bound_remarks
from orchestrator.diagnosis.reporting.resemblance import (
    alternative_remarks,
    inseparable_remark,
    needed_remarks,
    own_alternatives,
    pair_remarks,
    refitted_ties,
    resembling_pairs,
    separated_remarks,
    separately_needed,
    with_tied,
)
from orchestrator.diagnosis.selection.first_models import ModelChoice, baseline_of, first_models
from orchestrator.diagnosis.selection.naming import MAX_SHARE_OF_ERROR, joint_fit, other_opinion
from orchestrator.diagnosis.selection.search import EVALUATIONS_LEFT_FROM_REPORT, search_effects, unfinished_search
from orchestrator.diagnosis.selection.search_state import InterimRecorder, InterimResult, SearchResult
from orchestrator.recording import Recording, write_model
from orchestrator.recording_checks import check_recording
from protocols import (
    DiagnosisReport,
    DiagnosisStep,
    Effect,
    EstimationReport,
    FoundEffect,
    Inseparable,
    Judgement,
    Materiality,
    MotorModel,
    Nameplate,
    NextExperiment,
    NoiseFloor,
    Reason,
    Remark,
    ShapeShare,
    StorageError,
    Unexplained,
)
from protocols.fleet_priors import FleetPriors

LEAST_CHI2_OF_RANDOM_NOISE: float = 0.8
"""chi2 per degree of freedom below which the noise estimated from the readings' scatter is too large."""

Proposer = Callable[[DiagnosisSetup, Fit, Library, str, str], NextExperiment | Inseparable | None]
"""Proposes an experiment that separates two effects of the library, given the fit; None where no stage can."""

ENDED_EARLY = Remark.of("ended_early", "ended early by the user: the search was not finished")


@dataclass(frozen=True)
class Diagnosis:
    """A diagnosis with the fits behind it.

    Attributes
    ----------
    report : DiagnosisReport
    setup : DiagnosisSetup or None
        None where inconsistent metadata ended the diagnosis before any fit.
    search : SearchResult
        Its models are the steps of the ladder.
    library : sequence of CandidateEffect
        The effects that were searched.
    delivery : Delivery or None
        Final map and R_s; None where nothing was fitted.
    estimates : EstimationReport or None
        The estimators' results, with the delivered map and R_s added.
    """

    report: DiagnosisReport
    setup: DiagnosisSetup | None
    search: SearchResult
    library: Library
    delivery: Delivery | None = None
    estimates: EstimationReport | None = None


@solvable
def diagnose_recording(
    recording: Recording,
    effects: Sequence[Effect],
    *,
    model: ModelChoice = "saturated",
    without: Sequence[str] = (),
    out: Path | None = None,
    on_step: Callable[[DiagnosisStep], None] | None = None,
    poll: Callable[[], None] = lambda: None,
    tell: Callable[[str], None] = lambda _: None,
    criteria: Criteria | None = None,
    priors: FleetPriors | None = None,
    propose: Proposer | None = None,
    workers: int = 1,
    on_interim: Callable[[InterimResult], None] = lambda _: None,
    report_early: bool = False,
) -> Diagnosis:
    """Find the effects that a recording requires, and judge the residual.

    Parameters
    ----------
    effects : sequence of Effect
        The library of candidates.
    model : {"saturated", "linear"}, FluxMap or MotorModel
        Baseline of the ladder.
    without : sequence of str
        Effects excluded from the library.
    out : Path, optional
        Directory for `model.json`; the recording's by default.
    on_step : callable, optional
        Called with each step of the ladder in order, after the search.
    poll : callable
        Called several times a second; an exception that it raises ends the diagnosis.
    tell : callable
        Called with a short description of the current operation.
    criteria : Criteria, optional
        Thresholds; the defaults where omitted.
    priors : FleetPriors, optional
        Priors from other motors of this type. Effects whose size contradicts them are searched without them.
    propose : callable, optional
        Chooses the next experiment, as `experiment_design.proposal.next_experiment` does; None for no proposal.
    workers : int
        Number of workers; the result does not depend on it.
    on_interim : callable
        Called with the interim result of the search whenever it has changed.
    report_early : bool
        `KeyboardInterrupt` only ends the search: the report covers what was found so far, and says so. It is raised
        where nothing was found yet, and the second time. Other exceptions of `poll` are always raised.

    Raises
    ------
    InputError
        If the priors are another motor's, or name something that is no effect's amplitude.
    RecordingError
        If a capture cannot be read.
    NotMeasuredError
        If the recording is too short or incomplete to be diagnosed.
    PluginError
        If `without` names an effect that is not in the library.
    """
    require_known(without, effects)
    if isinstance(model, MotorModel):
        model = reduced(model, without)
    with executor_of(workers) as executor:
        request = _Request(
            effects, model, tuple(without), out, poll, tell, criteria, propose, executor, on_interim, report_early
        )
        found = _diagnose(recording, request) if priors is None else _diagnose_in_fleet(recording, request, priors)
        if on_step is not None and found.setup is not None:
            from orchestrator.diagnosis.reporting.pictures import diagnosis_step

            for index, (step, numbers) in enumerate(zip(found.search.steps, found.report.ladder, strict=True)):
                on_step(diagnosis_step(index, step, known=numbers))
    return found


def _diagnose_in_fleet(recording: Recording, request: _Request, priors: FleetPriors) -> Diagnosis:
    """The diagnosis with the fleet's priors, repeated without those that this motor contradicts."""
    require_same_motor(priors, recording.manifest)
    found = _diagnose(recording, request, priors)
    if found.setup is None:
        return found
    unlike = contradicts_fleet(found.search.fit)
    if unlike and ENDED_EARLY not in found.report.remarks:
        request.tell(f"unlike the fleet, found without it: {', '.join(sorted(unlike))}")
        found = _diagnose(recording, request, priors.without(unlike))
    remarks = (*found.report.remarks, *fleet_remarks(priors, unlike, found.report))
    used = {**found.report.criteria, "fleet": priors.without(unlike).model_dump(mode="json")}
    return replace(found, report=found.report.model_copy(update={"remarks": remarks, "criteria": used}))


@dataclass(frozen=True)
class _Request:
    """The arguments of `diagnose_recording`."""

    effects: Sequence[Effect]
    model: ModelChoice
    without: tuple[str, ...]
    out: Path | None
    poll: Callable[[], None]
    tell: Callable[[str], None]
    criteria: Criteria | None
    propose: Proposer | None
    executor: Executor
    on_interim: Callable[[InterimResult], None]
    report_early: bool


def _diagnose(recording: Recording, request: _Request, priors: FleetPriors | None = None) -> Diagnosis:
    began = time.monotonic()
    model, without, poll, tell, criteria = request.model, request.without, request.poll, request.tell, request.criteria
    tell("checking signs, units and axes of the recording")
    checked = check_recording(recording, poll)
    if checked.convention is not None:
        seconds = time.monotonic() - began
        report = convention_report(recording.manifest.name, checked.convention, criteria or Criteria(), seconds)
        return Diagnosis(report, None, SearchResult([]), ())
    setup = open_for_diagnosis(recording, poll, criteria, pm_flux_wb=flux_of(model), fleet=priors, tell=tell)
    setup = replace(setup, remarks=(*checked.remarks, *setup.remarks)).with_executor(request.executor)
    every = scaled_library(request.effects, setup.prepared.manifest, without)
    if priors is not None:
        every = with_priors(every, priors, setup.prepared.criteria.selection)
    library = observable_effects(every, [p.signals for p in setup.prepared.pieces])
    interim, early = InterimRecorder(request.on_interim), list[Remark]()
    try:
        # Only the search holds the first models: their memory is free once a timer's rounding replaces them.
        setup, search = search_effects(setup, first_models(setup, model, every, library, without), library, interim)
    except KeyboardInterrupt:
        if not request.report_early or interim.checkpoint is None:
            raise
        tell("ended early: what was found so far is fitted to the whole recording")
        early.append(ENDED_EARLY)
        setup, search = interim.checkpoint.state.setup, unfinished_search(interim.checkpoint)
    setup.fitter.begin("computing the intervals", EVALUATIONS_LEFT_FROM_REPORT)
    finish = partial(_report, recording, request, setup, search, every, library, began, early)
    try:
        return finish()
    except KeyboardInterrupt:
        if not request.report_early or early:
            raise
        # The search is over: an interrupt from here on still yields its report.
        return finish()


def _report(
    recording: Recording,
    request: _Request,
    setup: DiagnosisSetup,
    search: SearchResult,
    every: Library,
    library: Library,
    began: float,
    early: Sequence[Remark],
) -> Diagnosis:
    """The report of a finished search; its model is written to `model.json`."""
    first, last = search.steps[0].fit, search.fit
    evidence = {step.added: step.log_evidence for step in search.steps if step.added is not None}
    freed = {name: gain for name, gain in evidence.items() if name in MAP_RUNGS}
    sizes = search.contributions or contributions(setup, first, last)
    alternatives = own_alternatives(setup, last, library)
    alike = resembling_pairs(setup.fitter, last, [c.name for c in library if is_own(c.effect)])
    pairs, needed = separately_needed(setup.fitter, last, alike)
    refitted = refitted_ties(setup, last, search.indistinguishable, library, alternatives)
    tied = with_tied(search.indistinguishable, (*alternatives, *refitted), pairs)
    active = found_effects(setup.fitter, last, evidence, tied, sizes)
    of_map = map_effects(last, freed)
    found = of_map + tuple(e for e in active if e.name not in search.below_materiality)
    periodic = sum(not line.switching for line in setup.fitter.noise.lines)
    error = current_error(last)
    # The model is reported as read back from the file, not as the search left it.
    held = setup.fitter.hold(last.model)
    # Immaterial effects explain a part of what is left; only the form of a material one could explain most of it.
    material = [effect.name for effect in found if effect.material is not False]
    is_beyond_noise = last.chi2_per_dof - 1.0 > last.criteria.verdict.noise_accuracy_excess_chi2
    mixture = mix_forms(setup.fitter, last, material) if is_beyond_noise else None
    uncertainty = MapUncertainty.of(setup.fitter, last, library).with_mixture(mixture)
    points, rated_wb = mean_currents(last), rated_flux_wb(setup)
    map_error = uncertainty.band_wb(points) / rated_wb
    record = verdict_record(
        first,
        held,
        len(found),
        periodic_lines=periodic,
        noise_v=noise_rms_v(last),
        current_error=error,
        map_error=map_error,
        hidden_map_error=uncertainty.hidden_wb(points) / rated_wb,
        mixture=mixture,
    )
    judgement = judge(record)
    verdict = judgement.verdict
    ended = [Reason(quantity=one.code, value=None, limit=None, sentence=one.text) for one in early]
    residual = unexplained(setup, first.chi2_per_dof, last)
    if periodic and not residual.shape:
        residual = Unexplained(fraction=residual.fraction, shape=(ShapeShare(group="periodic", share=1.0),))
    rest = residual_fraction_of(first.chi2_per_dof, last) if verdict == "unknown_remains" else 0.0
    joint = joint_fit(setup.fitter, search, library)
    ladder = tuple(rung(step) for step in [*search.steps[:-1], replace(search.steps[-1], fit=held)])
    suspects = (*search.doubtful, *search.detected_not_named)
    confused = [(effect.name, twin) for effect in found for twin in effect.twins]
    if verdict == "unknown_remains" and len(suspects) >= 2:
        confused.append((suspects[0], suspects[1]))
    proposal = request.propose(setup, last, library, *confused[0]) if request.propose and confused else None
    report = DiagnosisReport(
        recording=recording.manifest.name,
        noise_floor=NoiseFloor(rms_v=noise_rms_v(last, training), heldout_rms_v=noise_rms_v(last, held_out)),
        verdict=verdict,
        reasons=(*ended, *judgement.reasons),
        verdict_record=record,
        effects=found,
        minor=credible_effects((e for e in active if e.name in search.below_materiality), rest, MAX_SHARE_OF_ERROR),
        traces=tuple(dict.fromkeys([*search.below_materiality, *suspects])),
        joint=joint,
        ladder=ladder,
        unexplained=residual,
        next_experiment=proposal if isinstance(proposal, NextExperiment) else None,
        remarks=(
            *early,
            *_remarks(setup, search, judgement, residual),
            *effect_remarks(last, {effect.name for effect in found}),
            *size_remarks(last),
            *bound_remarks(last),
            *contract_remarks(last, every),
            *alternative_remarks(alternatives),
            *separated_remarks(refitted),
            *pair_remarks(pairs),
            *needed_remarks(needed),
            *own_effect_remarks(
                setup.fitter, every, library, last, setup.fitter.trace.events, {one.other for one in alternatives}
            ),
            *other_opinion(joint, active),
            *([inseparable_remark(proposal)] if isinstance(proposal, Inseparable) else []),
        ),
        reproduces_current_percent=None if error is None else 100.0 * error,
        map_error_percent=100.0 * map_error,
        materiality=Materiality(
            flux_percent=100.0 * last.criteria.materiality.material_flux,
            voltage_percent=100.0 * last.criteria.materiality.material_voltage,
        ),
        seconds=time.monotonic() - began,
        criteria=setup.prepared.criteria.model_dump(mode="json"),
        search=tuple(setup.fitter.trace.events),
    )
    baseline = baseline_of(request.model)
    if isinstance(baseline, Nameplate):
        baseline = Nameplate.model_validate({"freed": tuple(freed)})
    if report.leaves_most:
        # A probability holds among models of which one fits; none does.
        report = report.model_copy(update={"effects": tuple(_without_probability(e) for e in report.effects)})
    kept = kept_model(setup, last, baseline, (*of_map, *active), ladder)
    try:
        write_model(request.out or recording.path, kept)
    except StorageError as error:
        report = report.with_remark(Remark.of("not_written", "{problem}", problem=str(error)))
    moved = {name: share.relative_to_flux for name, share in sizes.items()}
    delivery = delivery_of(uncertainty, last, kept, verdict, 100.0 * map_error, moved)
    return Diagnosis(report, setup, search, library, delivery)


def _without_probability(effect: FoundEffect) -> FoundEffect:
    return effect.model_copy(update={"probability": None})


def _remarks(setup: DiagnosisSetup, search: SearchResult, judgement: Judgement, residual: Unexplained) -> list[Remark]:
    """Remarks beside the findings."""
    limits, chi2, verdict = search.fit.criteria.verdict, search.fit.chi2_per_dof, judgement.verdict
    remarks = [*setup.remarks, *nuisance_remarks(setup)]
    if verdict in ("unknown_remains", "cannot_tell"):
        notes = recording_notes(setup.prepared.manifest)
        remarks += [Remark.of("time_constant", "{note}", note=note) for note in notes]
    unsteady = "{effect} resembles a part of what is left, but not steadily"
    remarks += [Remark.of("unsteady", unsteady, effect=n) for n in search.doubtful]
    is_beyond_noise = chi2 - 1.0 > limits.noise_accuracy_excess_chi2
    if verdict in ("explained", "explained_in_another_form", "mostly_explained") and is_beyond_noise and residual.shape:
        text = "small beside what was found, but not noise: chi2 {chi2:.3g}, {shape}"
        remarks.append(Remark.of("not_noise", text, chi2=chi2, shape=residual.shape[0].group))
    if verdict == "clean" and chi2 > limits.noise_chi2:
        text = "chi2 {chi2:.3g} is more than noise, but immaterial: {left_percent:.2g} % of the voltage"
        remarks.append(Remark.of("immaterial", text, chi2=chi2, left_percent=100.0 * left_of_excitation(search.fit)))
    # A joint fit has no limit on its number of effects.
    if setup.fitter.budget.is_spent and not search.contributions:
        remarks.append(Remark.of("cut_short", "the search was cut short: it took more computing than a diagnosis may"))
    text = "with the gates off the sensors read what the model denies: {reading_ma:.2g} mA rms"
    at_rest = [reason.value for reason in judgement.reasons if reason.quantity == "gates_off_v" and reason.value]
    remarks += [Remark.of("gates_off", text, reading_ma=1e3 * volts / search.fit.model.r_s) for volts in at_rest]
    if chi2 < LEAST_CHI2_OF_RANDOM_NOISE:
        text = "chi2 {chi2:.2g} is too small for random noise: the readings err from one to the next"
        remarks.append(Remark.of("too_quiet", text, chi2=chi2))
    return remarks
