"""A kept model refitted with one more effect, or with one less; the ladder goes on from where it was."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from orchestrator.diagnosis._prepare import open_for_refit
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, with_finest_map, with_freed_map
from orchestrator.diagnosis.fitting.candidates import (
    MAP_RUNGS,
    CandidateEffect,
    EffectTerm,
    require_known,
    scaled_library,
)
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.judgement.contributions import mean_currents, rated_flux_wb
from orchestrator.diagnosis.judgement.map_band import MapUncertainty
from orchestrator.diagnosis.judgement.sufficiency import solvable
from orchestrator.diagnosis.reporting.benefit import added_remark, removed_remark
from orchestrator.diagnosis.reporting.delivery import delivery_of
from orchestrator.diagnosis.reporting.findings import found_effects, map_effects, unexplained
from orchestrator.diagnosis.reporting.keeping import deliver
from orchestrator.diagnosis.reporting.ladder import kept_rungs
from orchestrator.diagnosis.reporting.motor_model import freed_by, kept_model, reduced, require_effects_of, restored
from orchestrator.diagnosis.reporting.parameter_bounds import bound_remarks
from orchestrator.diagnosis.selection.forward_search import Step, with_effect
from orchestrator.diagnosis.selection.workflow import ModelChoice, baseline_of, first_steps, with_map_step
from orchestrator.formatting.names import plain
from orchestrator.formatting.sentences import listed
from orchestrator.recording import MODEL_NAME, Recording, has_model, read_model, write_model
from protocols import (
    AddReport,
    Baseline,
    Effect,
    MotorModel,
    Nameplate,
    ParameterRole,
    PluginError,
    Remark,
    Rung,
    Saturated,
)


def add_effects(
    recording: Recording,
    names: Sequence[str],
    effects: Sequence[Effect],
    *,
    model: ModelChoice | None = None,
    out: Path | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> AddReport:
    """Refit with these effects beside those that the model has already; the ladder grows.

    Parameters
    ----------
    model : optional
        Where the ladder starts; by default the model of `model.json` as it stands, else ``saturated``.
    tell : callable
        Called with what is under way, in a few words.

    Raises
    ------
    PluginError
        Where a name is not in the library.
    """
    kept = read_model(out or recording.path) if model is None and has_model(out or recording.path) else None
    if kept is not None:
        require_effects_of(kept, {effect.name for effect in effects})
    require_known([n for n in names if n not in MAP_RUNGS], effects)
    return _added(recording, names, effects, kept, model or "saturated", out, tell)


@solvable
def _added(
    recording: Recording,
    names: Sequence[str],
    effects: Sequence[Effect],
    kept: MotorModel | None,
    model: ModelChoice,
    out: Path | None,
    tell: Callable[[str], None],
) -> AddReport:
    setup = open_for_refit(recording, kept or model, tell)
    library = {c.name: c for c in scaled_library(effects, setup.prepared.manifest)}
    baseline = kept.baseline if kept is not None else baseline_of(model)
    tell("the model without them")
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
            tell(f"the model with {plain(name)}")
            steps.append(Step(name, setup.fitter.fit(_with_effect(setup.fitter, fit, library[name]).model)))
        elif isinstance(baseline, Nameplate) and name not in baseline.freed:
            baseline = freed_by(baseline, name)
            tell(f"the model with {plain(name)}")
            steps.append(Step(name, with_map_step(setup, fit, baseline)))
        else:
            text = "{effect}: in the map {map} already"
            remarks.append(Remark.of("in_map", text, effect=name, map=baseline.title))
    if isinstance(baseline, Saturated) and steps[-1].fit.model.active:
        tell("is a finer map worth its freedom?")
        steps[-1] = replace(steps[-1], fit=_refine_map(setup, steps[-1].fit))
    ladder = (*(kept.ladder[:-1] if kept is not None else ()), *kept_rungs(setup, steps))
    report = _keep_refit(recording, setup, steps[-1].fit, baseline, kept, ladder, remarks, out)
    found = {effect.name: effect for effect in report.effects if effect.name in library}
    benefits = [
        added_remark(after.added, before.fit, after.fit, found.get(after.added))
        for before, after in pairwise(steps)
        if after.added is not None
    ]
    stated = {str(remark.values["effect"]) for remark in benefits if remark.code == "helps_at_bound"}
    remaining = bound_remarks(steps[-1].fit, stated)
    return report.model_copy(update={"remarks": (*benefits, *report.remarks, *remaining)})


def _with_effect(fitter: Fitter, fit: Fit, candidate: CandidateEffect) -> Fit:
    """The model with one more effect.

    Shapes that made up for it so far may have run to where no descent leads back: where much is left, it is fitted from
    the shapes that are usual as well, and the better fit stays.
    """
    grown = with_effect(fitter, fit, candidate)
    if grown.chi2_per_dof < fit.criteria.selection.detected_chi2:
        return grown
    still = fitter.fit(fit.model.with_active([_in_usual_shape(a) for a in fit.model.active]))
    again = with_effect(fitter, still, candidate)
    shapes = {a.name: [n for n in a.free if n in a.candidate.of_role(ParameterRole.SHAPE)] for a in fit.model.active}
    free = [a.release(*shapes.get(a.name, ())) for a in again.model.active]
    again = fitter.fit(again.model.with_active(free), again.frame)
    return min(grown, again, key=lambda f: f.chi2)


def _refine_map(setup: DiagnosisSetup, fit: Fit) -> Fit:
    """The model on a map as fine as the data ask for now: beside what was missing, detail was not worth its freedom."""
    detailed = with_finest_map(setup, setup.fitter, fit)
    return fit if detailed is fit else setup.fitter.fit(detailed.model, detailed.frame)


def _in_usual_shape(active: EffectTerm) -> EffectTerm:
    """As large as it is, in its candidate's shape and simple form, its amplitudes free."""
    usual = active.candidate.absent()
    amplitudes = {name: active.values[name] for name in active.candidate.amplitudes}
    return replace(usual, values={**usual.values, **amplitudes})


def remove_effect(
    recording: Recording,
    name: str,
    effects: Sequence[Effect],
    *,
    out: Path | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> AddReport:
    """Refit without one of the effects that `model.json` has; what was added before it stays as it was.

    Parameters
    ----------
    tell : callable
        Called with what is under way, in a few words.

    Raises
    ------
    PluginError
        Where the model has no such effect.
    """
    directory = out or recording.path
    kept = read_model(directory) if has_model(directory) else None
    have = [] if kept is None else [*_causes(kept), *_without_rung(kept)]
    if kept is None or name not in have:
        raise PluginError(MODEL_NAME, name, f"not in the model; it has {', '.join(have) or 'no effects'}")
    return _removed(recording, name, effects, kept, out, tell)


@solvable
def _removed(
    recording: Recording,
    name: str,
    effects: Sequence[Effect],
    kept: MotorModel,
    out: Path | None,
    tell: Callable[[str], None],
) -> AddReport:
    setup = open_for_refit(recording, kept, tell)
    library = {c.name: c for c in scaled_library(effects, setup.prepared.manifest)}
    before = setup.fitter.hold(restored(setup, kept, kept.baseline, library))
    left, beside = ([n for n in names if n != name] for names in (_causes(kept), _without_rung(kept)))
    # What is no cause has no rung of its own: the last one has them all.
    at = next((k for k, r in enumerate(kept.ladder) if r.added == name), len(left) + 1)
    steps = []
    # From the rung below on, all is fitted anew: what was added later may take over what was taken out.
    for count in range(at - 1, len(left) + 1):
        names = [*left[:count], *(beside if count == len(left) else ())]
        tell(f"the model with {listed([plain(n) for n in names])}" if names else "the model alone")
        baseline, model = _as_of(setup, reduced(kept, [name]), names, library)
        if not names and isinstance(baseline, Saturated):
            steps += first_steps(setup, "saturated", library)
        else:
            steps.append(Step(left[count - 1] if count else None, setup.fitter.fit(model)))
    ladder = (*kept.ladder[: at - 1], *kept_rungs(setup, steps))
    remarks = (removed_remark(name, before, steps[-1].fit), *setup.remarks, *bound_remarks(steps[-1].fit))
    return _keep_refit(recording, setup, steps[-1].fit, baseline, kept, ladder, remarks, out)


def _causes(kept: MotorModel) -> list[str]:
    """Names of the ladder's rungs, in their order."""
    return [rung.added for rung in kept.ladder if rung.added is not None]


def _without_rung(kept: MotorModel) -> list[str]:
    """Effects that are in the model without a rung of their own."""
    return [effect.name for effect in kept.effects if effect.name not in _causes(kept)]


def _as_of(
    setup: DiagnosisSetup, kept: MotorModel, names: Sequence[str | None], library: Mapping[str, CandidateEffect]
) -> tuple[Baseline, Model]:
    """The model with no more than these rungs, as free as its map was then."""
    baseline = kept.baseline
    if isinstance(baseline, Nameplate):
        baseline = Nameplate(freed=tuple(n for n in baseline.freed if n in names))
    model = restored(setup, kept, baseline, library)
    if isinstance(baseline, Nameplate):
        model = with_freed_map(setup, model, baseline)
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
    setup.fitter.tell("how sure is what was fitted?")
    evidence = {e.name: e.log_evidence for e in before.effects} if before is not None else {}
    twins = {e.name: e.twins for e in before.effects} if before is not None else {}
    found = found_effects(setup.fitter, fit, evidence, twins)
    kept = kept_model(setup, fit, baseline, found, ladder)
    write_model(out or recording.path, kept)
    uncertainty = MapUncertainty.of(setup.fitter, fit)
    band_percent = 100.0 * uncertainty.band_wb(mean_currents(fit)) / rated_flux_wb(setup)
    deliver(delivery_of(uncertainty, fit, kept, None, band_percent), recording, out)
    freed: tuple[str, ...] = baseline.freed if isinstance(baseline, Nameplate) else ()
    return AddReport(
        effects=map_effects(fit, dict.fromkeys(freed, 0.0)) + found,
        ladder=tuple(ladder),
        unexplained=unexplained(setup, ladder[0].chi2 or math.inf, fit),
        remarks=tuple(remarks),
    )
