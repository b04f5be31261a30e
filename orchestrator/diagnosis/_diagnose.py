"""Diagnosis of a recording: compare, find what is missing, add it, take it out. Puts the parts together."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orchestrator._validation import suggestion
from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.experiment_design.proposal import next_experiment
from orchestrator.diagnosis.fitting.baseline import Start
from orchestrator.diagnosis.fitting.candidates import CROSS_SATURATION, MAGNETIC, SATURATION, Candidate, scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.ladder import (
    found_effects,
    left_fraction,
    noise_rms_v,
    rung,
    verdict_of,
)
from orchestrator.diagnosis.reporting.model_file import SavedModel, read_model, saved_map, write_model
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
    converged,
    first_steps,
    map_steps,
    name_of,
    on_a_finer_map,
    pruned,
    search_effects,
    without_doubtful,
)
from orchestrator.recording import Recording
from protocols import (
    AddReport,
    DiagnosisReport,
    DiagnosisStep,
    Effect,
    FoundEffect,
    NextExperiment,
    NoiseFloor,
    ParameterValue,
    PluginError,
    Remark,
    Rung,
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
    start : Start
    search : Search
        Its steps are the rungs of the ladder.
    """

    report: DiagnosisReport
    start: Start
    search: Search


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
    model : {"saturated", "linear"} or FluxMap
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
    start = open_for_diagnosis(recording, poll, criteria)
    library = scaled_library(effects, start.prepared.manifest, without)
    search = search_effects(start, map_steps(start, model, without), library)
    search = on_a_finer_map(start, search, library)
    search, spared = pruned(start, converged(start, search))
    search, doubtful = without_doubtful(start, search)
    first, last = search.steps[0].fit, search.fit
    limits = last.criteria.selection
    unsteady = "{effect} resembles a part of what is left, but not steadily"
    remarks = [*start.remarks, *(Remark.of("unsteady", unsteady, effect=n) for n in doubtful)]
    found = _magnetic_rungs(search) + found_effects(start.fitter, last, search.steps, search.rivals)
    periodic = any(not line.switching for line in start.fitter.noise.lines)
    verdict = "unknown_remains" if periodic else verdict_of(first, last, len(found))
    left = _unexplained(start, first, last)
    if periodic and not left.shape:
        left = Unexplained(fraction=left.fraction, shape=(ShapeShare(group="periodic", share=1.0),))
    if verdict in ("explained", "mostly_explained") and last.chi2_per_dof > limits.noteworthy_chi2 and left.shape:
        text = "small beside what was found, but not noise: chi2 {chi2:.3g}, {shape}"
        remarks.append(Remark.of("not_noise", text, chi2=last.chi2_per_dof, shape=left.shape[0].group))
    if start.fitter.effort.exhausted:
        remarks.append(Remark.of("cut_short", "the search was cut short: it took more computing than a diagnosis may"))
    if last.chi2_per_dof < limits.too_quiet_chi2:
        text = "chi2 {chi2:.2g} is too small for random noise: the readings err from one to the next"
        remarks.append(Remark.of("too_quiet", text, chi2=last.chi2_per_dof))
    joint = joint_fit(start.fitter, search, library)
    remarks += other_opinion(joint, found, limits)
    ladder = tuple(rung(step) for step in search.steps)
    if on_step is not None:
        _show(start, search, ladder, on_step)
    report = DiagnosisReport(
        recording=recording.manifest.name,
        noise_floor=NoiseFloor(rms_v=noise_rms_v(last)),
        verdict=verdict,
        effects=found,
        traces=tuple(dict.fromkeys([*doubtful, *spared, *search.traces])),
        joint=joint,
        ladder=ladder,
        unexplained=left,
        next_experiment=_proposal(start, last, library, found, verdict, [*doubtful, *search.traces]),
        remarks=tuple(remarks),
        seconds=time.monotonic() - began,
        criteria=start.prepared.criteria.model_dump(mode="json"),
    )
    problem = _save(recording, start, search, name_of(model), found, ladder, out)
    if problem is not None:
        report = report.with_remark(Remark.of("not_written", "{problem}", problem=problem))
    return Diagnosis(report, start, search)


def add_effects(
    recording: Recording,
    names: Sequence[str],
    effects: Sequence[Effect],
    *,
    model: ModelChoice | None = None,
    out: Path | None = None,
) -> AddReport:
    """Refit with these effects beside those that `model.json` has already; the ladder grows.

    Parameters
    ----------
    model : optional
        Where the ladder starts; what `model.json` says by default, else ``saturated``.

    Raises
    ------
    PluginError
        Where a name is not in the library.
    """
    _known([n for n in names if n not in MAGNETIC], effects)
    kept = read_model(out or recording.path)
    before = [] if kept is None else [e.name for e in kept.effects]
    if model is None:
        model = kept.baseline if kept is not None and kept.baseline in ("linear", "saturated") else "saturated"
    return _refitted(recording, list(dict.fromkeys([*before, *names])), effects, model, out)


def remove_effect(recording: Recording, name: str, effects: Sequence[Effect], *, out: Path | None = None) -> AddReport:
    """Refit without one of the effects that `model.json` has.

    Raises
    ------
    PluginError
        Where the model has no such effect.
    """
    kept = read_model(out or recording.path)
    have = [] if kept is None else [e.name for e in kept.effects]
    if kept is None or name not in have:
        raise PluginError("model.json", name, f"not in the model; it has {', '.join(have) or 'no effects'}")
    model = kept.baseline if kept.baseline in ("linear", "saturated") else "saturated"
    return _refitted(recording, [n for n in have if n != name], effects, model, out)


@solvable
def _refitted(
    recording: Recording, names: Sequence[str], effects: Sequence[Effect], model: ModelChoice, out: Path | None
) -> AddReport:
    start = open_for_diagnosis(recording)
    library = {c.name: c for c in scaled_library(effects, start.prepared.manifest)}
    steps = first_steps(start, model, [n for n in names if n in MAGNETIC])
    remarks = list(start.remarks)
    for name in names:
        if name in library:
            steps.append(Step(name, with_effect(start.fitter, steps[-1].fit, library[name])))
        elif name in MAGNETIC and model != "linear":
            remarks.append(Remark.of("in_map", "{effect}: in the map {map} already", effect=name, map=name_of(model)))
        elif name not in MAGNETIC:
            text = "{effect}: in model.json, but not among the installed effects: left out"
            remarks.append(Remark.of("not_installed", text, effect=name))
    search = Search(steps)
    found = _magnetic_rungs(search) + found_effects(start.fitter, search.fit, steps, {})
    ladder = tuple(rung(step) for step in steps)
    problem = _save(recording, start, search, name_of(model), found, ladder, out)
    if problem is not None:
        raise StorageError(problem)
    left = _unexplained(start, steps[0].fit, search.fit)
    return AddReport(effects=found, ladder=ladder, unexplained=left, remarks=tuple(remarks))


def _show(start: Start, search: Search, ladder: Sequence[Rung], on_step: Callable[[DiagnosisStep], None]) -> None:
    from orchestrator.diagnosis.reporting.pictures import diagnosis_step

    for index, (step, numbers) in enumerate(zip(search.steps, ladder, strict=True)):
        on_step(diagnosis_step(index, step, start, known=numbers))


def _known(names: Sequence[str], effects: Sequence[Effect]) -> None:
    have = [e.name for e in effects] + list(MAGNETIC)
    for name in names:
        if name not in have:
            raise PluginError("effects", name, f"no such effect; {suggestion(name, have)}")


def _magnetic_rungs(search: Search) -> tuple[FoundEffect, ...]:
    """Saturation and cross-saturation as effects: by how much the inductances vary."""
    found = []
    grid = search.fit.model.space.grid
    d = np.linspace(grid.low, grid.high, 25)
    q = np.linspace(-grid.reach, grid.reach, 25)
    here = np.stack([g.ravel() for g in np.meshgrid(d, q)], axis=1)
    inductance = search.fit.model.magnetics.flux_and_inductance(here)[1]
    mean = inductance[:, [0, 2]].mean()
    sizes = {
        SATURATION: (float(np.ptp(inductance[:, [0, 2]], axis=0).max() / mean), 0.4),
        CROSS_SATURATION: (float(np.abs(inductance[:, 1]).max() / mean), 0.1),
    }
    for step in search.steps:
        if step.added in MAGNETIC:
            size, typical = sizes[step.added]
            value = ParameterValue(value=size, low=None, high=None, unit="1")
            found.append(
                FoundEffect(
                    name=step.added,
                    parameters={"relative_change": value},
                    twins=(),
                    relative_size=size / typical,
                    log_evidence=step.log_evidence,
                )
            )
    return tuple(found)


def _unexplained(start: Start, first: Fit, last: Fit) -> Unexplained:
    detected = last.chi2_per_dof > last.criteria.selection.detected_chi2
    shape = leftover_shape(start.fitter, last, start.current_a) if detected else []
    return Unexplained(
        fraction=left_fraction(first, last),
        shape=tuple(ShapeShare(group=group, share=share) for group, share in shape),
    )


def _proposal(
    start: Start,
    fit: Fit,
    library: Sequence[Candidate],
    found: Sequence[FoundEffect],
    verdict: Verdict,
    suspects: Sequence[str],
) -> NextExperiment | None:
    for effect in found:
        for twin in effect.twins:
            return next_experiment(start, effect.name, twin, fit, library)
    if verdict == "unknown_remains" and len(suspects) >= 2:
        return next_experiment(start, suspects[0], suspects[1])
    return None


def _save(
    recording: Recording,
    start: Start,
    search: Search,
    baseline: str,
    found: Sequence[FoundEffect],
    ladder: Sequence[Rung],
    out: Path | None,
) -> str | None:
    saved = SavedModel(
        recording=recording.manifest.name,
        baseline=baseline,
        r_s_ohm=search.fit.model.r_s,
        pm_flux_wb=start.fitter.pm_flux_wb,
        magnetics=saved_map(search.fit.model),
        effects=tuple(found),
        ladder=tuple(ladder),
    )
    return write_model(out or recording.path, saved)
