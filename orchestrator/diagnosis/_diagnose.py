"""Diagnosis of a recording: compare, find what is missing, add it, take it out. Puts the parts together."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orchestrator._validation import suggestion
from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.experiment_design.proposal import next_experiment
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, freed_further
from orchestrator.diagnosis.fitting.candidates import CROSS_SATURATION, MAP_RUNGS, SATURATION, Candidate, scaled_library
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.reporting.ladder import (
    found_effects,
    left_fraction,
    noise_rms_v,
    rung,
    verdict_of,
)
from orchestrator.diagnosis.reporting.motor_model import flux_of, freed_by, kept_model, reduced, restored
from orchestrator.diagnosis.selection.forward_search import (
    Search,
    Step,
    with_effect,
)
from orchestrator.diagnosis.selection.joint_ranking import joint_fit, other_opinion
from orchestrator.diagnosis.selection.leftover import leftover_shape
from orchestrator.diagnosis.selection.sufficiency import solvable
from orchestrator.diagnosis.selection.workflow import (
    ModelChoice,
    baseline_of,
    converged,
    first_steps,
    map_steps,
    on_a_finer_map,
    pruned,
    search_effects,
    with_map_step,
    without_doubtful,
)
from orchestrator.recording import MODEL_NAME, Recording, has_model, read_model, write_model
from protocols import (
    AddReport,
    Baseline,
    DiagnosisReport,
    DiagnosisStep,
    Effect,
    FoundEffect,
    MotorModel,
    Nameplate,
    NextExperiment,
    NoiseFloor,
    ParameterValue,
    PluginError,
    Remark,
    Rung,
    Saturated,
    ShapeShare,
    StorageError,
    Unexplained,
    Verdict,
)


@dataclass(frozen=True)
class Diagnosis:
    """A diagnosis with the fits behind it, for pictures and words.

    Attributes
    ----------
    report : DiagnosisReport
    setup : DiagnosisSetup
    search : Search
        Its steps are the rungs of the ladder.
    library : sequence of Candidate
        What was looked for.
    """

    report: DiagnosisReport
    setup: DiagnosisSetup
    search: Search
    library: Sequence[Candidate]


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
    criteria: Criteria | None = None,
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
    criteria : Criteria, optional
        Thresholds other than the default ones.

    Raises
    ------
    RecordingError
        Where a capture cannot be read.
    NotMeasuredError
        Where the recording holds too little to be diagnosed.
    PluginError
        Where `without` names an effect that is not in the library.
    """
    began = time.monotonic()
    _known(without, effects)
    setup = open_for_diagnosis(recording, poll, criteria, pm_flux_wb=flux_of(model))
    library = scaled_library(effects, setup.prepared.manifest, without)
    if isinstance(model, MotorModel):
        model = reduced(model, without)
    search = search_effects(setup, map_steps(setup, model, {c.name: c for c in library}, without), library)
    search = on_a_finer_map(setup, search, library)
    search, spared = pruned(setup, converged(setup, search))
    search, doubtful = without_doubtful(setup, search)
    first, last = search.steps[0].fit, search.fit
    limits = last.criteria.selection
    unsteady = "{effect} resembles a part of what is left, but not steadily"
    remarks = [*setup.remarks, *(Remark.of("unsteady", unsteady, effect=n) for n in doubtful)]
    evidence = {step.added: step.log_evidence for step in search.steps if step.added is not None}
    freed = {name: gain for name, gain in evidence.items() if name in MAP_RUNGS}
    found = _magnetic_effects(last, freed) + found_effects(setup.fitter, last, evidence, search.rivals)
    periodic = any(not line.switching for line in setup.fitter.noise.lines)
    verdict = "unknown_remains" if periodic else verdict_of(first, last, len(found))
    left = _unexplained(setup, first.chi2_per_dof, last)
    if periodic and not left.shape:
        left = Unexplained(fraction=left.fraction, shape=(ShapeShare(group="periodic", share=1.0),))
    if verdict in ("explained", "mostly_explained") and last.chi2_per_dof > limits.noteworthy_chi2 and left.shape:
        text = "small beside what was found, but not noise: chi2 {chi2:.3g}, {shape}"
        remarks.append(Remark.of("not_noise", text, chi2=last.chi2_per_dof, shape=left.shape[0].group))
    if setup.fitter.effort.exhausted:
        remarks.append(Remark.of("cut_short", "the search was cut short: it took more computing than a diagnosis may"))
    if last.chi2_per_dof < limits.too_quiet_chi2:
        text = "chi2 {chi2:.2g} is too small for random noise: the readings err from one to the next"
        remarks.append(Remark.of("too_quiet", text, chi2=last.chi2_per_dof))
    joint = joint_fit(setup.fitter, search, library)
    remarks += other_opinion(joint, found, limits)
    ladder = (*(rung(step) for step in search.steps[:-1]), *_as_kept(setup, search.steps[-1:]))
    if on_step is not None:
        _show(setup, search, ladder, on_step)
    report = DiagnosisReport(
        recording=recording.manifest.name,
        noise_floor=NoiseFloor(rms_v=noise_rms_v(last)),
        verdict=verdict,
        effects=found,
        traces=tuple(dict.fromkeys([*doubtful, *spared, *search.traces])),
        joint=joint,
        ladder=ladder,
        unexplained=left,
        next_experiment=_proposal(setup, last, library, found, verdict, [*doubtful, *search.traces]),
        remarks=tuple(remarks),
        seconds=time.monotonic() - began,
        criteria=setup.prepared.criteria.model_dump(mode="json"),
    )
    baseline = baseline_of(model)
    if isinstance(baseline, Nameplate):
        baseline = Nameplate.model_validate({"freed": tuple(freed)})
    try:
        write_model(out or recording.path, kept_model(setup, last, baseline, found, ladder))
    except StorageError as error:
        report = report.with_remark(Remark.of("not_written", "{problem}", problem=str(error)))
    return Diagnosis(report, setup, search, library)


def add_effects(
    recording: Recording,
    names: Sequence[str],
    effects: Sequence[Effect],
    *,
    model: ModelChoice | None = None,
    out: Path | None = None,
) -> AddReport:
    """Refit with these effects beside those that the model has already; the ladder grows.

    Parameters
    ----------
    model : optional
        Where the ladder starts; by default the model of `model.json` as it stands, else ``saturated``.

    Raises
    ------
    PluginError
        Where a name is not in the library.
    """
    _known([n for n in names if n not in MAP_RUNGS], effects)
    kept = read_model(out or recording.path) if model is None and has_model(out or recording.path) else None
    return _added(recording, names, effects, kept, model or "saturated", out)


@solvable
def _added(
    recording: Recording,
    names: Sequence[str],
    effects: Sequence[Effect],
    kept: MotorModel | None,
    model: ModelChoice,
    out: Path | None,
) -> AddReport:
    setup = open_for_diagnosis(recording, pm_flux_wb=flux_of(kept or model))
    library = {c.name: c for c in scaled_library(effects, setup.prepared.manifest)}
    baseline = kept.baseline if kept is not None else baseline_of(model)
    if kept is None:
        steps = first_steps(setup, model, library)
    else:
        fit = setup.fitter.fit(restored(setup, kept, baseline, library))
        steps = [Step(kept.ladder[-1].added, fit)]
    remarks = list(setup.remarks)
    for name in sorted(dict.fromkeys(names), key=lambda n: n not in MAP_RUNGS):
        fit = steps[-1].fit
        if name in fit.model.names:
            remarks.append(Remark.of("in_model", "{effect}: in the model already", effect=name))
        elif name in library:
            steps.append(Step(name, with_effect(setup.fitter, fit, library[name])))
        elif isinstance(baseline, Nameplate) and name not in baseline.freed:
            baseline = freed_by(baseline, name)
            steps.append(Step(name, with_map_step(setup, fit, baseline)))
        else:
            text = "{effect}: in the map {map} already"
            remarks.append(Remark.of("in_map", text, effect=name, map=baseline.title))
    ladder = (*(kept.ladder[:-1] if kept is not None else ()), *_as_kept(setup, steps))
    return _keep_refit(recording, setup, steps[-1].fit, baseline, kept, ladder, remarks, out)


def remove_effect(recording: Recording, name: str, effects: Sequence[Effect], *, out: Path | None = None) -> AddReport:
    """Refit without one of the effects that `model.json` has; what was added before it stays as it was.

    Raises
    ------
    PluginError
        Where the model has no such effect.
    """
    directory = out or recording.path
    kept = read_model(directory) if has_model(directory) else None
    have = [] if kept is None else [r.added for r in kept.ladder if r.added is not None]
    if kept is None or name not in have:
        raise PluginError(MODEL_NAME, name, f"not in the model; it has {', '.join(have) or 'no effects'}")
    return _removed(recording, name, effects, kept, out)


@solvable
def _removed(
    recording: Recording, name: str, effects: Sequence[Effect], kept: MotorModel, out: Path | None
) -> AddReport:
    setup = open_for_diagnosis(recording, pm_flux_wb=kept.pm_flux_wb)
    library = {c.name: c for c in scaled_library(effects, setup.prepared.manifest)}
    at = next(k for k, r in enumerate(kept.ladder) if r.added == name)
    left = [r.added for r in kept.ladder if r.added not in (None, name)]
    steps = []
    # From the rung below on, all is fitted anew: what was added later may take over what was taken out.
    for count in range(at - 1, len(left) + 1):
        baseline, model = _as_of(setup, reduced(kept, [name]), left[:count], library)
        if count == 0 and isinstance(baseline, Saturated):
            steps += first_steps(setup, "saturated", library)
        else:
            steps.append(Step(left[count - 1] if count else None, setup.fitter.fit(model)))
    ladder = (*kept.ladder[: at - 1], *_as_kept(setup, steps))
    return _keep_refit(recording, setup, steps[-1].fit, baseline, kept, ladder, setup.remarks, out)


def _as_of(
    setup: DiagnosisSetup, kept: MotorModel, names: Sequence[str | None], library: Mapping[str, Candidate]
) -> tuple[Baseline, Model]:
    """The model with no more than these rungs, as free as its map was then."""
    baseline = kept.baseline
    if isinstance(baseline, Nameplate):
        baseline = Nameplate(freed=tuple(n for n in baseline.freed if n in names))
    model = restored(setup, kept, baseline, library)
    if isinstance(baseline, Nameplate):
        model = freed_further(setup, model, baseline)
    return baseline, model.with_active([a for a in model.active if a.name in names])


def _keep_refit(
    recording: Recording,
    setup: DiagnosisSetup,
    fit: Fit,
    baseline: Baseline,
    before: MotorModel | None,
    ladder: Sequence[Rung],
    remarks: Sequence[Remark],
    out: Path | None,
) -> AddReport:
    """The model written to `model.json`, and what there is to say of it; raises `StorageError`."""
    evidence = {e.name: e.log_evidence for e in before.effects} if before is not None else {}
    twins = {e.name: e.twins for e in before.effects} if before is not None else {}
    found = found_effects(setup.fitter, fit, evidence, twins)
    write_model(out or recording.path, kept_model(setup, fit, baseline, found, ladder))
    freed: tuple[str, ...] = baseline.freed if isinstance(baseline, Nameplate) else ()
    return AddReport(
        effects=_magnetic_effects(fit, dict.fromkeys(freed, 0.0)) + found,
        ladder=tuple(ladder),
        unexplained=_unexplained(setup, ladder[0].chi2 or math.inf, fit),
        remarks=tuple(remarks),
    )


def _as_kept(setup: DiagnosisSetup, steps: Sequence[Step]) -> tuple[Rung, ...]:
    """The rungs of some steps with their models as they would be kept, so that a comparison finds them again."""
    return tuple(rung(Step(step.added, setup.fitter.hold(step.fit.model))) for step in steps)


def _show(
    setup: DiagnosisSetup, search: Search, ladder: Sequence[Rung], on_step: Callable[[DiagnosisStep], None]
) -> None:
    from orchestrator.diagnosis.reporting.pictures import diagnosis_step

    for index, (step, numbers) in enumerate(zip(search.steps, ladder, strict=True)):
        on_step(diagnosis_step(index, step, setup, known=numbers))


def _known(names: Sequence[str], effects: Sequence[Effect]) -> None:
    have = [e.name for e in effects] + list(MAP_RUNGS)
    for name in names:
        if name not in have:
            raise PluginError("effects", name, f"no such effect; {suggestion(name, have)}")


def _magnetic_effects(fit: Fit, evidence: Mapping[str, float]) -> tuple[FoundEffect, ...]:
    """Saturation and cross-saturation as effects, where the map was let go: by how much the inductances vary."""
    grid = fit.model.space.grid
    d = np.linspace(grid.low, grid.high, 25)
    q = np.linspace(-grid.reach, grid.reach, 25)
    nodes = np.stack([g.ravel() for g in np.meshgrid(d, q)], axis=1)
    inductance = fit.model.magnetics.flux_and_inductance(nodes)[1]
    mean = inductance[:, [0, 2]].mean()
    sizes = {
        SATURATION: (float(np.ptp(inductance[:, [0, 2]], axis=0).max() / mean), 0.4),
        CROSS_SATURATION: (float(np.abs(inductance[:, 1]).max() / mean), 0.1),
    }
    return tuple(
        FoundEffect(
            name=name,
            parameters={"relative_change": ParameterValue(value=sizes[name][0], low=None, high=None, unit="1")},
            twins=(),
            relative_size=sizes[name][0] / sizes[name][1],
            log_evidence=gain,
        )
        for name, gain in evidence.items()
    )


def _unexplained(setup: DiagnosisSetup, first_chi2: float, last: Fit) -> Unexplained:
    detected = last.chi2_per_dof > last.criteria.selection.detected_chi2
    shape = leftover_shape(setup.fitter, last, setup.current_a) if detected else []
    return Unexplained(
        fraction=left_fraction(first_chi2, last),
        shape=tuple(ShapeShare(group=group, share=share) for group, share in shape),
    )


def _proposal(
    setup: DiagnosisSetup,
    fit: Fit,
    library: Sequence[Candidate],
    found: Sequence[FoundEffect],
    verdict: Verdict,
    suspects: Sequence[str],
) -> NextExperiment | None:
    for effect in found:
        for twin in effect.twins:
            return next_experiment(setup, fit, library, effect.name, twin)
    if verdict == "unknown_remains" and len(suspects) >= 2:
        return next_experiment(setup, fit, library, *suspects[:2])
    return None
