"""Diagnosis of a recording: compare, find what is missing, add it, take it out. Puts the parts together."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orchestrator._validation import suggestion
from orchestrator.diagnosis._baseline import (
    INTERVALS,
    MAP_STEPS,
    Start,
    finer_map,
    fitted_baseline,
    given_model,
    linear_model,
    open_for_diagnosis,
)
from orchestrator.diagnosis._fit import Fit, absent_columns
from orchestrator.diagnosis._ladder import (
    DETECTED,
    found_effects,
    left_fraction,
    noise_rms_v,
    rung,
    verdict_of,
)
from orchestrator.diagnosis._library import CROSS_SATURATION, MAGNETIC, SATURATION, Candidate, scaled_library, value_at
from orchestrator.diagnosis._model_file import SavedModel, read_model, saved_map, write_model
from orchestrator.diagnosis._next import next_experiment
from orchestrator.diagnosis._reports import (
    AddReport,
    DiagnosisReport,
    FoundEffect,
    JointEntry,
    NextExperiment,
    NoiseFloor,
    ParameterValue,
    Rung,
    ShapeShare,
    Unexplained,
    Verdict,
)
from orchestrator.diagnosis._search import LOG_EVIDENCE, Search, Step, forward, with_effect
from orchestrator.diagnosis._shape import leftover_shape
from orchestrator.diagnosis._trust import inconstancy
from orchestrator.recording import Recording
from protocols import Effect, FluxMap, PluginError

ModelChoice = str | FluxMap
"""``saturated`` (the free energy map), ``linear`` (the nameplate), or a map of one's own."""
STEADY = 0.2
"""Largest inconstancy of an effect that is named while something unknown remains."""


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


def diagnose_recording(
    recording: Recording,
    effects: Sequence[Effect],
    *,
    model: ModelChoice = "saturated",
    without: Sequence[str] = (),
    out: Path | None = None,
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
    start = open_for_diagnosis(recording)
    library = scaled_library(effects, start.prepared.manifest, without)
    search = _search(start, _map_steps(start, model, without), library)
    search = _on_a_finer_map(start, search, library)
    search, doubtful = _without_doubtful(start, search)
    first, last = search.steps[0].fit, search.fit
    notes = [*start.notes, *(f"{n} resembles a part of what is left, but not steadily" for n in doubtful)]
    found = _magnetic_rungs(search) + found_effects(last, search.steps, search.rivals)
    verdict = verdict_of(first, last, len(found))
    ladder = tuple(rung(step) for step in search.steps)
    report = DiagnosisReport(
        recording=recording.manifest.name,
        noise_floor=NoiseFloor(rms_v=noise_rms_v(last)),
        verdict=verdict,
        effects=found,
        traces=tuple(dict.fromkeys([*doubtful, *search.traces])),
        joint=_joint(start, last, library),
        ladder=ladder,
        unexplained=_unexplained(start, first, last),
        next_experiment=_proposal(start, found, verdict, [*doubtful, *search.traces]),
        notes=tuple(notes),
        seconds=time.monotonic() - began,
    )
    problem = _save(recording, start, search, _name_of(model), found, ladder, out)
    if problem is not None:
        report = report.model_copy(update={"notes": (*report.notes, problem)})
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


def _refitted(
    recording: Recording, names: Sequence[str], effects: Sequence[Effect], model: ModelChoice, out: Path | None
) -> AddReport:
    start = open_for_diagnosis(recording)
    library = {c.name: c for c in scaled_library(effects, start.prepared.manifest)}
    steps = _first_steps(start, model, [n for n in names if n in MAGNETIC])
    for name in names:
        if name in library:
            steps.append(Step(name, with_effect(start.fitter, steps[-1].fit, library[name])))
    search = Search(steps)
    found = _magnetic_rungs(search) + found_effects(search.fit, steps, {})
    ladder = tuple(rung(step) for step in steps)
    notes = list(start.notes)
    problem = _save(recording, start, search, _name_of(model), found, ladder, out)
    if problem is not None:
        notes.append(problem)
    left = _unexplained(start, steps[0].fit, search.fit)
    return AddReport(effects=found, ladder=ladder, unexplained=left, notes=tuple(notes))


def _known(names: Sequence[str], effects: Sequence[Effect]) -> None:
    have = [e.name for e in effects] + list(MAGNETIC)
    for name in names:
        if name not in have:
            raise PluginError("effects", name, f"no such effect{suggestion(name, have)}")


def _first_steps(start: Start, model: ModelChoice, magnetic: Sequence[str]) -> list[Step]:
    if isinstance(model, FluxMap):
        return [Step(None, start.fitter.fit(given_model(start, model)))]
    if model == "saturated":
        return [Step(None, fitted_baseline(start))]
    if model != "linear":
        raise PluginError("--model", str(model), "expected linear, saturated, or the path of a flux map")
    steps = [Step(None, start.fitter.fit(linear_model(start)))]
    for name in magnetic:
        steps.append(Step(name, start.fitter.fit(MAP_STEPS[name](start, steps[-1].fit.model))))
    return steps


def _map_steps(start: Start, model: ModelChoice, without: Sequence[str]) -> list[Step]:
    """The ladder's first rungs: the baseline, and from a linear one the map's own, as far as the data ask for them."""
    steps = _first_steps(start, model, [])
    if model != "linear":
        return steps
    for name in (SATURATION, CROSS_SATURATION):
        if name in without:
            break
        fit = start.fitter.fit(MAP_STEPS[name](start, steps[-1].fit.model))
        gain = 0.5 * (steps[-1].fit.chi2 - fit.chi2) / max(fit.chi2_per_dof, 1.0)
        gain -= 0.5 * (steps[-1].fit.dof - fit.dof) * math.log(fit.dof)
        if gain > LOG_EVIDENCE:
            steps.append(Step(name, fit, gain))
    return steps


def _search(start: Start, steps: Sequence[Step], library: Sequence[Candidate]) -> Search:
    """Search in a part of the recording, fit what was found to the whole, and look there for what is small."""
    model = steps[-1].fit.model
    quick = forward(start.coarse, [Step(None, start.coarse.fit(model, renewals=0))], library)
    fits = list(steps)
    for step in quick.steps[1:]:
        last = fits[-1].fit
        fit = start.fitter.fit(step.fit.model, last.frame if not last.model.active else None, steps=3, renewals=1)
        fits.append(Step(step.added, fit, step.log_evidence))
    found = forward(start.fitter, fits, library)
    found.rivals = {**quick.rivals, **found.rivals}
    found.traces = [n for n in dict.fromkeys([*quick.traces, *found.traces]) if n not in found.fit.model.names]
    return found


def _on_a_finer_map(start: Start, search: Search, library: Sequence[Candidate]) -> Search:
    """Whether what is left is the map's own detail, which big effects hid at first."""
    fit = search.fit
    if not fit.model.active or fit.chi2_per_dof < DETECTED or fit.model.space.directions.shape[1] < 20:
        return search
    for intervals in INTERVALS[1:]:
        finer = finer_map(start, start.fitter, fit, intervals)
        if finer is None:
            break
        fit = finer
    if fit is search.fit:
        return search
    steps = [*search.steps[:-1], Step(search.steps[-1].added, fit, search.steps[-1].log_evidence)]
    again = forward(start.fitter, steps, library)
    again.rivals = {**search.rivals, **again.rivals}
    return again


def _without_doubtful(start: Start, search: Search) -> tuple[Search, list[str]]:
    """While something unknown remains, an effect whose size drifts is a stand-in for it and is not named."""
    doubtful: list[str] = []
    first = search.steps[0].fit
    while search.fit.model.active and verdict_of(first, search.fit, 1) != "explained":
        drift = inconstancy(search.fit)
        worst = max(drift, key=lambda name: drift[name])
        if drift[worst] <= STEADY:
            break
        doubtful.append(worst)
        kept = [a for a in search.fit.model.active if a.name != worst]
        steps = [s for s in search.steps if s.added is None or s.added in MAGNETIC]
        for active in kept:
            model = steps[-1].fit.model
            fit = start.fitter.fit(model.with_active([*model.active, active]), steps[-1].fit.frame)
            gain = next(s.log_evidence for s in search.steps if s.added == active.name)
            steps.append(Step(active.name, fit, gain))
        search = Search(steps, search.traces, search.rivals)
    return search, doubtful


def _magnetic_rungs(search: Search) -> tuple[FoundEffect, ...]:
    """Saturation and cross-saturation as effects: by how much the inductances vary."""
    found = []
    grid = search.fit.model.space.grid
    d = np.linspace(grid.d_low, grid.d_high, 25)
    q = np.linspace(-grid.q_high, grid.q_high, 25)
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


def _joint(start: Start, fit: Fit, library: Sequence[Candidate]) -> tuple[JointEntry, ...]:
    """All effects at once, linearly around the model, under the priors; ranked by relative size."""
    absent = [c for c in library if c.name not in fit.model.names]
    columns = [*fit.model.free, *absent_columns(absent)]
    if not columns:
        return ()
    normal, right = start.fitter.evaluate(fit.model, fit.frame, absent_columns(absent)).projected()
    inflation = max(fit.chi2_per_dof, 1.0)
    x0 = np.array([a.coordinate(n) for a, n in columns])
    precision = normal / inflation + np.eye(len(columns))
    x = x0 - np.linalg.solve(precision, right / inflation + x0)
    spread = np.sqrt(np.diag(np.linalg.inv(precision)))
    entries: dict[str, JointEntry] = {}
    for (active, name), value, sigma in zip(columns, x, spread, strict=True):
        p = active.candidate.named(name)
        if name not in active.candidate.amplitudes:
            continue
        size = abs(value * p.prior_width / (p.typical * (p.typical if p.strong_when_small else 1.0)))
        if not p.strong_when_small:
            size = abs((value_at(p, float(value)) - p.neutral) / p.typical)
        entry = JointEntry(name=active.name, relative_size=size, z=float(value / sigma))
        known = entries.get(active.name)
        if known is None or abs(entry.z or 0.0) > abs(known.z or 0.0):
            entries[active.name] = entry
    # An effect that chance could have made is ranked below all that it could not, whatever its size.
    return tuple(sorted(entries.values(), key=lambda e: (abs(e.z or 0.0) < 4.0, -(e.relative_size or 0.0))))


def _unexplained(start: Start, first: Fit, last: Fit) -> Unexplained:
    shape = leftover_shape(start.fitter, last, start.current_a) if last.chi2_per_dof > DETECTED else []
    return Unexplained(
        fraction=left_fraction(first, last),
        shape=tuple(ShapeShare(group=group, share=share) for group, share in shape),
    )


def _proposal(
    start: Start, found: Sequence[FoundEffect], verdict: Verdict, suspects: Sequence[str]
) -> NextExperiment | None:
    for effect in found:
        for twin in effect.twins:
            return next_experiment(start, effect.name, twin)
    if verdict == "unknown_remains" and len(suspects) >= 2:
        return next_experiment(start, suspects[0], suspects[1])
    return None


def _name_of(model: ModelChoice) -> str:
    return model if isinstance(model, str) else f"map:{model.method}"


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
