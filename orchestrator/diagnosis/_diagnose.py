"""Diagnosis of a recording: what is missing, and what is left. Puts the parts together."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from orchestrator.config.time_constants import recording_notes
from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import (
    MAP_RUNGS,
    CandidateEffect,
    observable_effects,
    require_known,
    scaled_library,
)
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.fitting.priors import contradicts_fleet, require_same_motor, with_priors
from orchestrator.diagnosis.fitting.workers import Executor, executor_of
from orchestrator.diagnosis.judgement.contributions import (
    contributions,
    left_of_excitation,
    mean_currents,
    rated_flux_wb,
    unexplained_at_rest_v,
)
from orchestrator.diagnosis.judgement.judge import judge
from orchestrator.diagnosis.judgement.map_band import MapUncertainty
from orchestrator.diagnosis.judgement.sufficiency import solvable
from orchestrator.diagnosis.judgement.verdict import left_fraction, verdict_record
from orchestrator.diagnosis.nuisances.pwm_quantiser import own_leg_step_of
from orchestrator.diagnosis.nuisances.segment_scatter import quantiser_step_s
from orchestrator.diagnosis.reporting.convention import convention_report
from orchestrator.diagnosis.reporting.delivery import Delivery, delivery_of
from orchestrator.diagnosis.reporting.findings import (
    above_residual,
    effect_remarks,
    found_effects,
    map_effects,
    size_remarks,
    unexplained,
)
from orchestrator.diagnosis.reporting.ladder import current_error, held_out, noise_rms_v, rung
from orchestrator.diagnosis.reporting.motor_model import flux_of, kept_model, reduced
from orchestrator.diagnosis.reporting.own_effects import own_effect_remarks
from orchestrator.diagnosis.reporting.parameter_bounds import bound_remarks
from orchestrator.diagnosis.selection.ending_early import unfinished_search
from orchestrator.diagnosis.selection.forward_search import Search
from orchestrator.diagnosis.selection.initial_effects import include_expected, include_measured
from orchestrator.diagnosis.selection.interim import InterimRecorder, InterimResult
from orchestrator.diagnosis.selection.joint_ranking import joint_fit, other_opinion
from orchestrator.diagnosis.selection.joint_workflow import MAX_SHARE_OF_ERROR, drop_confounded
from orchestrator.diagnosis.selection.workflow import (
    EVALUATIONS_LEFT_FROM_REPORT,
    ModelChoice,
    baseline_of,
    coarsen_map,
    converged,
    map_steps,
    prune,
    search_effects,
)
from orchestrator.recording import Recording, write_model
from orchestrator.recording_checks import check_recording
from protocols import (
    DiagnosisReport,
    DiagnosisStep,
    Effect,
    EstimationReport,
    FoundEffect,
    Materiality,
    MotorModel,
    Nameplate,
    NextExperiment,
    NoiseFloor,
    Reason,
    Remark,
    Rung,
    ShapeShare,
    StorageError,
    Unexplained,
    Verdict,
)
from protocols.fleet_priors import FleetPriors

LEAST_CHI2_OF_RANDOM_NOISE: float = 0.8
"""chi2 per degree of freedom below which the readings' scatter is not the noise that it was taken for."""

Proposer = Callable[[DiagnosisSetup, Fit, Sequence[CandidateEffect], str, str], NextExperiment | None]
"""Chooses the experiment that separates two effects of the library, by the fit; None where no stage can."""

ENDED_EARLY = Remark.of("ended_early", "ended early by the user: the search was not finished")
REASON_ENDED_EARLY = Reason(quantity=ENDED_EARLY.code, value=None, limit=None, sentence=ENDED_EARLY.text)


@dataclass(frozen=True)
class Diagnosis:
    """A diagnosis with the fits behind it, for pictures and words.

    Attributes
    ----------
    report : DiagnosisReport
    setup : DiagnosisSetup or None
        None where the diagnosis ended with a convention: then nothing was fitted.
    search : Search
        Its steps are the rungs of the ladder.
    library : sequence of CandidateEffect
        What was looked for.
    delivery : Delivery or None
        The map and R_s that it ends with; None where nothing was fitted.
    estimates : EstimationReport or None
        The results that these have been put among.
    """

    report: DiagnosisReport
    setup: DiagnosisSetup | None
    search: Search
    library: Sequence[CandidateEffect]
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
    """Find the effects that a recording asks for, and judge what is left.

    Parameters
    ----------
    effects : sequence of Effect
        The library of candidates.
    model : {"saturated", "linear"}, FluxMap or MotorModel
        Where the ladder starts.
    without : sequence of str
        Names taken out of the library.
    out : Path, optional
        Where `model.json` goes; the recording's own directory by default.
    on_step : callable, optional
        Called with each rung of the ladder in order, once the search is over.
    poll : callable
        Called several times a second; what it raises ends the diagnosis.
    tell : callable
        Called with what is under way, in a few words.
    criteria : Criteria, optional
        Thresholds other than the default ones.
    priors : FleetPriors, optional
        What other motors of its kind let expect. Effects whose size is none of theirs are found without.
    propose : callable, optional
        Chooses the next experiment, as `orchestrator.experiment_design.proposal.next_experiment` does. Without it
        the report proposes none.
    workers : int
        Threads that work on it; the result is the same.
    on_interim : callable
        Called with what the search has found so far, whenever that has changed at the end of one of its steps.
    report_early : bool
        `KeyboardInterrupt` ends the search alone: the report is made from what was found so far, and says so. Where
        nothing was found yet, and the second time, it is raised. What else `poll` raises always is.

    Raises
    ------
    InputError
        Where the priors are another motor's, or of something that is no effect's amplitude.
    RecordingError
        Where a capture cannot be read.
    NotMeasuredError
        Where the recording holds too little to be diagnosed.
    PluginError
        Where `without` names an effect that is not in the library.
    """
    with executor_of(workers) as executor:
        request = _Request(
            effects, model, tuple(without), out, poll, tell, criteria, propose, executor, on_interim, report_early
        )
        if priors is None:
            return _diagnose(recording, request, on_step)
        return _diagnose_in_fleet(recording, request, on_step, priors)


def _diagnose_in_fleet(
    recording: Recording, request: _Request, on_step: Callable[[DiagnosisStep], None] | None, priors: FleetPriors
) -> Diagnosis:
    """The diagnosis by what other motors of its kind let expect, and once more without what is none of theirs."""
    require_same_motor(priors, recording.manifest)
    found = _diagnose(recording, request, None, priors)
    if found.setup is None:
        return found
    unlike = contradicts_fleet(found.search.fit)
    if unlike and ENDED_EARLY not in found.report.remarks:
        request.tell(f"unlike the fleet, found without it: {', '.join(sorted(unlike))}")
        found = _diagnose(recording, request, None, priors.without(unlike))
    if on_step is not None and found.setup is not None:
        _show(found.setup, found.search, found.report.ladder, on_step)
    remarks = (*found.report.remarks, *_fleet_remarks(priors, unlike, found.report))
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


@dataclass(frozen=True)
class _SearchResult:
    """What a search came to, and the effects that its end has set aside."""

    setup: DiagnosisSetup
    search: Search
    doubtful: Sequence[str]
    removed: Sequence[str] = ()
    is_early: bool = False


def _diagnose(
    recording: Recording,
    request: _Request,
    on_step: Callable[[DiagnosisStep], None] | None,
    priors: FleetPriors | None = None,
) -> Diagnosis:
    began = time.monotonic()
    model, without, poll, tell, criteria = request.model, request.without, request.poll, request.tell, request.criteria
    require_known(without, request.effects)
    tell("does the recording keep its manifest's conventions?")
    checked = check_recording(recording, poll)
    if checked.convention is not None:
        seconds = time.monotonic() - began
        report = convention_report(recording.manifest.name, checked.convention, criteria or Criteria(), seconds)
        return Diagnosis(report, None, Search([]), ())
    setup = open_for_diagnosis(recording, poll, criteria, pm_flux_wb=flux_of(model), fleet=priors, tell=tell)
    setup = replace(setup, remarks=(*checked.remarks, *setup.remarks)).with_executor(request.executor)
    every = scaled_library(request.effects, setup.prepared.manifest, without)
    if priors is not None:
        every = with_priors(every, priors, setup.prepared.criteria.selection)
    library = observable_effects(every, [p.signals for p in setup.prepared.pieces])
    if isinstance(model, MotorModel):
        model = reduced(model, without)

    interim = InterimRecorder(request.on_interim)
    try:
        found = _search(setup, request, model, every, library, interim)
    except KeyboardInterrupt:
        if not request.report_early or interim.checkpoint is None:
            raise
        tell("ended early: what was found so far is fitted to the whole recording")
        search, doubtful = unfinished_search(interim.checkpoint)
        found = _SearchResult(interim.checkpoint.setup, search, doubtful, is_early=True)
    found.setup.fitter.begin("how sure is what was found?", EVALUATIONS_LEFT_FROM_REPORT)
    try:
        return _report(recording, request, on_step, found, model, every, library, began)
    except KeyboardInterrupt:
        if not request.report_early or found.is_early:
            raise
        # The search is over: whoever stops it now gets its report.
        return _report(recording, request, on_step, found, model, every, library, began)


def _search(
    setup: DiagnosisSetup,
    request: _Request,
    model: ModelChoice,
    every: Sequence[CandidateEffect],
    library: Sequence[CandidateEffect],
    interim: InterimRecorder,
) -> _SearchResult:
    """Everything that the data ask for, looked for to the end."""

    steps = map_steps(setup, model, {c.name: c for c in every}, request.without)
    setup.fitter.budget.calibrate()
    steps = include_measured(setup, steps, library)
    setup, search = search_effects(setup, include_expected(setup, steps, library), library, interim)
    if search.contributions:
        search, doubtful = drop_confounded(setup.fitter, search)
        return _SearchResult(setup, search, doubtful)
    first = search.bare_steps
    search, removed = prune(setup, coarsen_map(setup, converged(setup, search)))
    interim.record(setup, first, search, is_part=False)
    return _SearchResult(setup, search, [], removed)


def _report(
    recording: Recording,
    request: _Request,
    on_step: Callable[[DiagnosisStep], None] | None,
    result: _SearchResult,
    model: ModelChoice,
    every: Sequence[CandidateEffect],
    library: Sequence[CandidateEffect],
    began: float,
) -> Diagnosis:
    """The report of what a search came to, its model written to `model.json`."""
    setup, search, doubtful, removed = result.setup, result.search, result.doubtful, result.removed
    first, last = search.steps[0].fit, search.fit
    evidence = {step.added: step.log_evidence for step in search.steps if step.added is not None}
    freed = {name: gain for name, gain in evidence.items() if name in MAP_RUNGS}
    sizes = search.contributions or contributions(setup, first, last)
    active = found_effects(setup.fitter, last, evidence, search.indistinguishable, sizes)
    of_map = map_effects(last, freed)
    found = of_map + tuple(e for e in active if e.name not in search.below_materiality)
    periodic = sum(not line.switching for line in setup.fitter.noise.lines)
    error = current_error(last)
    # As whoever reads the model back will find it, not as the search left it.
    held = setup.fitter.hold(last.model)
    uncertainty = MapUncertainty.of(setup.fitter, last, library)
    map_error = uncertainty.band_wb(mean_currents(last)) / rated_flux_wb(setup)
    record = verdict_record(
        first,
        held,
        len(found),
        periodic_lines=periodic,
        noise_v=noise_rms_v(last),
        current_error=error,
        map_error=map_error,
    )
    judgement = judge(record)
    verdict = judgement.verdict
    left = unexplained(setup, first.chi2_per_dof, last)
    if periodic and not left.shape:
        left = Unexplained(fraction=left.fraction, shape=(ShapeShare(group="periodic", share=1.0),))
    rest = left_fraction(first.chi2_per_dof, last) if verdict == "unknown_remains" else 0.0
    joint = joint_fit(setup.fitter, search, library)
    ladder = tuple(rung(step) for step in [*search.steps[:-1], replace(search.steps[-1], fit=held)])
    if on_step is not None:
        _show(setup, search, ladder, on_step)
    report = DiagnosisReport(
        recording=recording.manifest.name,
        noise_floor=NoiseFloor(rms_v=noise_rms_v(last), heldout_rms_v=noise_rms_v(last, held_out)),
        verdict=verdict,
        reasons=(*([REASON_ENDED_EARLY] if result.is_early else []), *judgement.reasons),
        verdict_record=record,
        effects=found,
        minor=above_residual((e for e in active if e.name in search.below_materiality), rest, MAX_SHARE_OF_ERROR),
        traces=tuple(dict.fromkeys([*search.below_materiality, *doubtful, *removed, *search.detected_not_named])),
        joint=joint,
        ladder=ladder,
        unexplained=left,
        next_experiment=_proposal(
            request.propose, setup, last, library, found, verdict, [*doubtful, *search.detected_not_named]
        ),
        remarks=(
            *([ENDED_EARLY] if result.is_early else []),
            *_remarks(setup, search, verdict, left, doubtful),
            *effect_remarks(last, {effect.name for effect in found}),
            *size_remarks(last),
            *bound_remarks(last),
            *own_effect_remarks(every, library, last, setup.fitter.trace.events),
            *other_opinion(joint, active),
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
    baseline = baseline_of(model)
    if isinstance(baseline, Nameplate):
        baseline = Nameplate.model_validate({"freed": tuple(freed)})
    kept = kept_model(setup, last, baseline, (*of_map, *active), ladder)
    try:
        write_model(request.out or recording.path, kept)
    except StorageError as error:
        report = report.with_remark(Remark.of("not_written", "{problem}", problem=str(error)))
    moved = {name: share.relative_to_flux for name, share in sizes.items()}
    delivery = delivery_of(uncertainty, last, kept, verdict, 100.0 * map_error, moved)
    return Diagnosis(report, setup, search, library, delivery)


def _fleet_remarks(priors: FleetPriors, unlike: frozenset[str], report: DiagnosisReport) -> list[Remark]:
    """That a fleet was believed, and where this motor is none of it."""
    text = "with what {count} recordings of a fleet let expect ({table})"
    remarks = [Remark.of("fleet", text, count=priors.recordings, table=priors.table)]
    for name in sorted(unlike):
        text = "{effect}: its size is none of the fleet's, which had no say in it"
        remarks.append(Remark.of("unlike_the_fleet", text, effect=name))
    here = {name for effect in (*report.effects, *report.minor) for name in (effect.name, *effect.twins)}
    for name, prior in priors.effects.items():
        if prior.probability > 0.9 and name not in here:
            text = "{effect}: in {found} of {asked} recordings of the fleet, not found here"
            remarks.append(Remark.of("not_found_here", text, effect=name, found=prior.found, asked=prior.asked))
    return remarks


def _remarks(
    setup: DiagnosisSetup, search: Search, verdict: Verdict, left: Unexplained, doubtful: Sequence[str]
) -> list[Remark]:
    """Remarks beside the findings."""
    limits, chi2 = search.fit.criteria.verdict, search.fit.chi2_per_dof
    remarks = list(setup.remarks)
    scatter = setup.fitter.noise.of_model
    if scatter.offset_scatter_a > 0.0:
        text = "as if the readings' zero differed by {scatter_ma:.2g} mA rms from segment to segment: taken for noise"
        remarks.append(Remark.of("offset_scatter", text, scatter_ma=1e3 * scatter.offset_scatter_a))
    timer = setup.prepared.quantiser
    if timer is not None:
        text = "the modulator's timer rounds edges to {step_ns:.4g} ns, a leg by up to {leg_mv:.2g} mV: taken out"
        sizes = {
            "step_ns": 1e9 * timer.step_s,
            "leg_mv": 0.5e3 * own_leg_step_of(timer.step_s, setup.prepared.manifest.drive),
        }
        remarks.append(Remark.of("timer", text, **sizes))
    if scatter.voltage_scatter_v > 0.0 and timer is not None:
        text = "as if held voltages were off by another {scatter_mv:.2g} mV rms each: taken for noise"
        remarks.append(Remark.of("voltage_scatter", text, scatter_mv=1e3 * scatter.voltage_scatter_v))
    elif scatter.voltage_scatter_v > 0.0:
        text = (
            "as if a timer's step of {step_ns:.2g} ns put held voltages off by {scatter_mv:.2g} mV rms: taken for noise"
        )
        sizes = {"scatter_mv": 1e3 * scatter.voltage_scatter_v, "step_ns": 1e9 * quantiser_step_s(scatter, setup)}
        remarks.append(Remark.of("voltage_scatter", text, **sizes))
    if verdict in ("unknown_remains", "cannot_tell"):
        notes = recording_notes(setup.prepared.manifest)
        remarks += [Remark.of("time_constant", "{note}", note=note) for note in notes]
    unsteady = "{effect} resembles a part of what is left, but not steadily"
    remarks += [Remark.of("unsteady", unsteady, effect=n) for n in doubtful]
    if verdict in ("explained", "mostly_explained") and chi2 - 1.0 > limits.noise_accuracy_excess_chi2 and left.shape:
        text = "small beside what was found, but not noise: chi2 {chi2:.3g}, {shape}"
        remarks.append(Remark.of("not_noise", text, chi2=chi2, shape=left.shape[0].group))
    if verdict == "clean" and chi2 > limits.noise_chi2:
        text = "chi2 {chi2:.3g} is more than noise, but immaterial: {left_percent:.2g} % of the voltage"
        remarks.append(Remark.of("immaterial", text, chi2=chi2, left_percent=100.0 * left_of_excitation(search.fit)))
    # What fits all together takes what it takes.
    if setup.fitter.budget.is_spent and not search.contributions:
        remarks.append(Remark.of("cut_short", "the search was cut short: it took more computing than a diagnosis may"))
    if (at_rest := unexplained_at_rest_v(search.fit)) > 0.0:
        text = "with the gates off the sensors read what the model denies: {reading_ma:.2g} mA rms"
        remarks.append(Remark.of("gates_off", text, reading_ma=1e3 * at_rest / search.fit.model.r_s))
    if chi2 < LEAST_CHI2_OF_RANDOM_NOISE:
        text = "chi2 {chi2:.2g} is too small for random noise: the readings err from one to the next"
        remarks.append(Remark.of("too_quiet", text, chi2=chi2))
    return remarks


def _show(
    setup: DiagnosisSetup, search: Search, ladder: Sequence[Rung], on_step: Callable[[DiagnosisStep], None]
) -> None:
    from orchestrator.diagnosis.reporting.pictures import diagnosis_step

    for index, (step, numbers) in enumerate(zip(search.steps, ladder, strict=True)):
        on_step(diagnosis_step(index, step, setup, known=numbers))


def _proposal(
    propose: Proposer | None,
    setup: DiagnosisSetup,
    fit: Fit,
    library: Sequence[CandidateEffect],
    found: Sequence[FoundEffect],
    verdict: Verdict,
    suspects: Sequence[str],
) -> NextExperiment | None:
    if propose is None:
        return None
    for effect in found:
        for twin in effect.twins:
            return propose(setup, fit, library, effect.name, twin)
    if verdict == "unknown_remains" and len(suspects) >= 2:
        return propose(setup, fit, library, *suspects[:2])
    return None
