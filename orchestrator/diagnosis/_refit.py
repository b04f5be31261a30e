"""A saved model refitted with one more effect or one less; its ladder is continued."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

from orchestrator.diagnosis._prepare import open_for_refit
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, with_finest_map, with_freed_map, with_sharpest_map
from orchestrator.diagnosis.fitting.candidates import (
    MAP_RUNGS,
    CandidateEffect,
    EffectTerm,
    require_known,
    scaled_library,
)
from orchestrator.diagnosis.fitting.guarded import is_own
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.diagnosis.judgement.contributions import mean_currents, rated_flux_wb
from orchestrator.diagnosis.judgement.map_band import MapUncertainty
from orchestrator.diagnosis.judgement.sufficiency import solvable
from orchestrator.diagnosis.reporting.benefit import added_remark, helps, removed_remark
from orchestrator.diagnosis.reporting.delivery import delivery_of
from orchestrator.diagnosis.reporting.determination import undetermined_words
from orchestrator.diagnosis.reporting.earlier_models import earlier_model, keep_earlier
from orchestrator.diagnosis.reporting.findings import found_effects, map_effects, unexplained
from orchestrator.diagnosis.reporting.keeping import deliver
from orchestrator.diagnosis.reporting.ladder import kept_rungs
from orchestrator.diagnosis.reporting.motor_model import freed_by, kept_model, reduced, require_effects_of, restored
from orchestrator.diagnosis.reporting.parameter_bounds import bound_remarks
from orchestrator.diagnosis.reporting.resemblance import (
    alternative_remarks,
    alternatives_to,
    needed_remarks,
    pair_remarks,
    resembling_pairs,
    separately_needed,
)
from orchestrator.diagnosis.selection.first_models import ModelChoice, baseline_of, first_steps, with_map_step
from orchestrator.diagnosis.selection.search import with_effect
from orchestrator.diagnosis.selection.search_state import AcceptedModel, evidence_gain
from orchestrator.formatting.names import parameter_words, plain
from orchestrator.formatting.quantities import measured
from orchestrator.formatting.sentences import listed
from orchestrator.recording import MODEL_NAME, Recording, has_model, read_model, write_model
from protocols import (
    AddReport,
    Baseline,
    Effect,
    FoundEffect,
    ModelEffect,
    MotorModel,
    Nameplate,
    ParameterRole,
    ParameterValue,
    PluginError,
    Remark,
    Rung,
    Saturated,
    Unexplained,
)

# Expected cost, in evaluations of the first model.
EVALUATIONS_OF_REFIT = 200.0
"""A refit with one more effect."""
EVALUATIONS_OF_RESULTS = 60.0
"""The intervals, the map, and the effects that resemble one that was added."""


def add_effects(
    recording: Recording,
    names: Sequence[str],
    effects: Sequence[Effect],
    *,
    model: ModelChoice | None = None,
    out: Path | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> AddReport:
    """Refit with these effects beside those that the model has already, and extend the ladder.

    Where the model has them all, nothing is fitted, and a remark, ``in_model``, states their sizes.

    Parameters
    ----------
    model : optional
        Start of the ladder; by default the model of `model.json`, else ``saturated``.
    tell : callable
        Called with what is under way, in a few words.

    Raises
    ------
    PluginError
        If a name is not in the library.
    """
    saved = read_model(out or recording.path) if model is None and has_model(out or recording.path) else None
    if saved is not None:
        require_effects_of(saved, {effect.name for effect in effects})
    require_known([n for n in names if n not in MAP_RUNGS], effects)
    if saved is not None and names and (unchanged := unchanged_model(saved, names)) is not None:
        return unchanged
    report = _added(recording, names, effects, saved, model or "saturated", out, tell)
    if out is None or model is not None or saved is not None or not has_model(recording.path):
        return report
    text = "no {file} in {folder}: the model began without the effects of the recording's own; copy that to keep them"
    began = Remark.of("no_model", text, file=MODEL_NAME, folder=str(out))
    return report.model_copy(update={"remarks": (began, *report.remarks)})


@solvable
def _added(
    recording: Recording,
    names: Sequence[str],
    effects: Sequence[Effect],
    saved: MotorModel | None,
    model: ModelChoice,
    out: Path | None,
    tell: Callable[[str], None],
) -> AddReport:
    setup = open_for_refit(recording, saved or model, tell)
    library = {c.name: c for c in scaled_library(effects, setup.prepared.manifest)}
    baseline = saved.baseline if saved is not None else baseline_of(model)
    tell("fitting the present model")
    if saved is None:
        steps = first_steps(setup, model, library)
    else:
        fit = setup.fitter.fit(restored(setup, saved, baseline, library))
        steps = [AcceptedModel(saved.ladder[-1].added, fit)]
    remarks = list(setup.remarks)
    setup.fitter.budget.calibrate()
    order = sorted(dict.fromkeys(names), key=lambda n: n not in MAP_RUNGS)
    for k, name in enumerate(order):
        left = EVALUATIONS_OF_REFIT * (len(order) - k) + EVALUATIONS_OF_RESULTS
        fit = steps[-1].fit
        if name in fit.model.names:
            remarks.append(Remark.of("in_model", "{effect}: in the model already", effect=name))
        elif name in library:
            setup.fitter.begin(f"fitting the model with {plain(name)}", left)
            steps.append(AcceptedModel(name, setup.fitter.fit(_with_effect(setup, fit, library[name]).model)))
        elif isinstance(baseline, Nameplate) and name not in baseline.freed:
            baseline = freed_by(baseline, name)
            setup.fitter.begin(f"fitting the model with {plain(name)}", left)
            steps.append(AcceptedModel(name, with_map_step(setup, fit, baseline)))
        else:
            text = "{effect}: in the map {map} already"
            remarks.append(Remark.of("in_map", text, effect=name, map=baseline.title))
    if len(steps) > 1:
        new = [step.added for step in steps[1:] if step.added is not None]
        steps[-1] = replace(steps[-1], fit=_with_similar_ones_anew(setup, steps[-1].fit, new, library))
    if isinstance(baseline, Saturated) and steps[-1].fit.model.active:
        setup.fitter.under_way("testing a finer map")
        steps[-1] = replace(steps[-1], fit=_refine_map(setup, steps[-1].fit))
    ladder = (*(saved.ladder[:-1] if saved is not None else ()), *kept_rungs(setup, steps))
    added = _judged(setup, [(b.fit, a) for b, a in pairwise(steps) if a.added is not None])
    helping = {name: helps(before, after) for name, before, after in added}
    before = added[-1][:2] if added else None
    report = _keep_refit(recording, setup, steps[-1].fit, baseline, saved, ladder, remarks, out, helping, before)
    if saved is not None and len(added) == 1:
        keep_earlier(out or recording.path, added[0][0], saved)
    found = {effect.name: effect for effect in report.effects if effect.name in library}
    last, every = steps[-1].fit, tuple(library.values())
    setup.fitter.under_way("comparing with similar effects")
    useful = [name for name, *_ in added if name in library and helping[name]]
    pairs, needed = separately_needed(setup.fitter, last, resembling_pairs(setup.fitter, last, useful))
    own = [name for name in useful if is_own(library[name].effect)]
    alternatives = [one for name in own for one in alternatives_to(setup, last, name, every)]
    benefits = [
        added_remark(name, before, after, found.get(name), _present(pairs, name, before))
        for name, before, after in added
    ]
    stated = {str(remark.values["effect"]) for remark in benefits if remark.code == "helps_at_bound"}
    remaining = bound_remarks(steps[-1].fit, stated)
    besides = (*alternative_remarks(alternatives), *pair_remarks(pairs), *needed_remarks(needed))
    together = (*benefits, *report.remarks, *remaining, *besides)
    # Wrong units or frames make the benefit of an effect meaningless.
    return report.model_copy(update={"remarks": tuple(sorted(together, key=lambda one: one.code != "convention"))})


def _with_similar_ones_anew(
    setup: DiagnosisSetup, fit: Fit, names: Sequence[str], library: Mapping[str, CandidateEffect]
) -> Fit:
    """The fit, or a better one where one of two similar effects is added again after the other.

    The first of them had to imitate the second, which was missing, and a fit of both starts there.
    """
    if fit.chi2_per_dof < fit.criteria.selection.detected_chi2:
        return fit
    for pair in resembling_pairs(setup.fitter, fit, [name for name in names if name in library]):
        for name in (n for n in pair if n in library):
            setup.fitter.under_way(f"fitting {plain(name)} anew")
            others = fit.model.with_active([a for a in fit.model.active if a.name != name])
            again = with_effect(setup, setup.fitter.fit(others, fit.linearisation), library[name])
            again = setup.fitter.fit(again.model, again.linearisation)
            if evidence_gain(again, fit) > fit.criteria.selection.log_evidence:
                fit = again
    return fit


def _judged(setup: DiagnosisSetup, steps: Sequence[tuple[Fit, AcceptedModel]]) -> list[tuple[str, Fit, Fit]]:
    """Each added effect with the fits without and with it.

    Of several effects each is left out of the model with all: beside one that is still missing, another's benefit is
    none.
    """
    single = [(step.added, before, step.fit) for before, step in steps if step.added is not None]
    last = single[-1][2] if single else None
    if last is None or len(single) == 1:
        return single
    judged = []
    for name, before, after in single:
        others = [a for a in last.model.active if a.name != name]
        if len(others) == len(last.model.active):  # a freed map, which no effect's absence gives back
            judged.append((name, before, after))
            continue
        setup.fitter.under_way(f"fitting the model without {plain(name)}")
        without = setup.fitter.evaluate(last.model.with_active(others), last.linearisation)
        judged.append((name, setup.fitter.fit(without.model, without.linearisation), last))
    return judged


def _present(pairs: Sequence[tuple[str, str]], name: str, before: Fit) -> list[str]:
    """The effects that resemble an added one and were in the model before it."""
    return [other for pair in pairs if name in pair for other in pair if other in before.model.names]


def _with_effect(setup: DiagnosisSetup, fit: Fit, candidate: CandidateEffect) -> Fit:
    """The model refitted with one more effect; where a large misfit remains, started at the usual shapes too."""
    grown = with_effect(setup, fit, candidate)
    if grown.chi2_per_dof < fit.criteria.selection.detected_chi2:
        return grown
    still = setup.fitter.fit(fit.model.with_active([_in_usual_shape(a) for a in fit.model.active]))
    again = with_effect(setup, still, candidate)
    shapes = {a.name: [n for n in a.free if n in a.candidate.of_role(ParameterRole.SHAPE)] for a in fit.model.active}
    free = [a.release(*shapes.get(a.name, ())) for a in again.model.active]
    again = setup.fitter.fit(again.model.with_active(free), again.linearisation)
    return min(grown, again, key=lambda f: f.chi2)


def _refine_map(setup: DiagnosisSetup, fit: Fit) -> Fit:
    """Refit on the finest map that the evidence now requires; a missing effect may have hidden its gain."""
    detailed = with_sharpest_map(setup, setup.fitter, with_finest_map(setup, setup.fitter, fit))
    return fit if detailed is fit else setup.fitter.fit(detailed.model, detailed.linearisation)


def _in_usual_shape(active: EffectTerm) -> EffectTerm:
    """The effect with its amplitudes, its candidate's typical shape and simple form; only amplitudes are free."""
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
    """Refit without one of the effects of `model.json`; earlier steps of the ladder are unchanged.

    Where the effect was the last one added, the model is again the one that it was added to.

    Parameters
    ----------
    tell : callable
        Called with what is under way, in a few words.

    Raises
    ------
    PluginError
        If the model has no such effect.
    """
    directory = out or recording.path
    saved = read_model(directory) if has_model(directory) else None
    have = [] if saved is None else [*_causes(saved), *_without_rung(saved)]
    if saved is None or name not in have:
        raise PluginError(
            str(directory / MODEL_NAME), name, f"not in the model; it has {', '.join(have) or 'no effects'}"
        )
    return _removed(recording, name, effects, saved, out, tell)


@solvable
def _removed(
    recording: Recording,
    name: str,
    effects: Sequence[Effect],
    saved: MotorModel,
    out: Path | None,
    tell: Callable[[str], None],
) -> AddReport:
    setup = open_for_refit(recording, saved, tell)
    library = {c.name: c for c in scaled_library(effects, setup.prepared.manifest)}
    before = setup.fitter.hold(restored(setup, saved, saved.baseline, library))
    causes, without_rung = ([n for n in names if n != name] for names in (_causes(saved), _without_rung(saved)))
    # Effects that are no causes have no step of their own: they are in the last one.
    at = next((k for k, r in enumerate(saved.ladder) if r.added == name), len(causes) + 1)
    setup.fitter.budget.calibrate()
    earlier = earlier_model(out or recording.path, name, saved)
    if earlier is not None:
        # A finer map and the forms that were chosen with the effect leave with it.
        setup.fitter.begin("the model before it was added", EVALUATIONS_OF_REFIT + EVALUATIONS_OF_RESULTS)
        fit = setup.fitter.fit(restored(setup, earlier, earlier.baseline, library))
        steps = [AcceptedModel(earlier.ladder[-1].added, fit)]
        return _keep_reduced(recording, setup, name, before, steps, earlier.baseline, earlier, out)
    steps = []
    # All later steps are refitted: their effects may take over the one that is removed.
    for count in range(at - 1, len(causes) + 1):
        names = [*causes[:count], *(without_rung if count == len(causes) else ())]
        left = EVALUATIONS_OF_REFIT * (len(causes) + 1 - count) + EVALUATIONS_OF_RESULTS
        text = f"the model with {listed([plain(n) for n in names])}" if names else "the model alone"
        setup.fitter.begin(text, left)
        baseline, model = _as_of(setup, reduced(saved, [name]), names, library)
        if not names and isinstance(baseline, Saturated):
            steps += first_steps(setup, "saturated", library)
        else:
            steps.append(AcceptedModel(causes[count - 1] if count else None, setup.fitter.fit(model)))
    kept = saved.model_copy(update={"ladder": saved.ladder[:at]})
    return _keep_reduced(recording, setup, name, before, steps, baseline, kept, out)


def _keep_reduced(
    recording: Recording,
    setup: DiagnosisSetup,
    name: str,
    before: Fit,
    steps: Sequence[AcceptedModel],
    baseline: Baseline,
    saved: MotorModel,
    out: Path | None,
) -> AddReport:
    """Write the model without an effect; the steps follow the ladder of `saved` from its last rung on."""
    after = steps[-1].fit
    ladder = (*saved.ladder[:-1], *kept_rungs(setup, steps))
    remarks = (removed_remark(name, before, after), *setup.remarks, *bound_remarks(after))
    return _keep_refit(recording, setup, after, baseline, saved, ladder, remarks, out)


def _causes(saved: MotorModel) -> list[str]:
    """Effects with a step of their own in the ladder, in its order."""
    return [rung.added for rung in saved.ladder if rung.added is not None]


def _without_rung(saved: MotorModel) -> list[str]:
    """Effects of the model without a step of their own."""
    return [effect.name for effect in saved.effects if effect.name not in _causes(saved)]


def _as_of(
    setup: DiagnosisSetup, saved: MotorModel, names: Sequence[str | None], library: Mapping[str, CandidateEffect]
) -> tuple[Baseline, Model]:
    """The baseline and model with only these steps of the ladder, and the map as free as it was then."""
    baseline = saved.baseline
    if isinstance(baseline, Nameplate):
        baseline = Nameplate(freed=tuple(n for n in baseline.freed if n in names))
    model = restored(setup, saved, baseline, library)
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
    helping: Mapping[str, bool] = MappingProxyType({}),
    added: tuple[str, Fit] | None = None,
) -> AddReport:
    """Write the model to `model.json` and report on it; raises `StorageError`.

    Parameters
    ----------
    helping : mapping of bool
        Whether each effect that was added helps.
    added : tuple, optional
        The effect that was added last, and the fit before.
    """
    setup.fitter.under_way("computing the intervals")
    evidence = {e.name: e.log_evidence for e in before.effects} if before is not None else {}
    twins = {e.name: e.twins for e in before.effects} if before is not None else {}
    found = found_effects(setup.fitter, fit, evidence, twins)
    saved = kept_model(setup, fit, baseline, found, ladder)
    earlier = {e.name: e.helps for e in before.effects} if before is not None else {}
    effects = tuple(e.model_copy(update={"helps": helping.get(e.name, earlier.get(e.name))}) for e in saved.effects)
    saved = saved.model_copy(update={"effects": effects})
    write_model(out or recording.path, saved)
    uncertainty = MapUncertainty.of(setup.fitter, fit)
    band_percent = _band_percent(setup, uncertainty)
    widening = _widening(setup, fit, found, added)
    deliver(delivery_of(uncertainty, fit, saved, None, band_percent, widening=widening), recording, out)
    freed: tuple[str, ...] = baseline.freed if isinstance(baseline, Nameplate) else ()
    return AddReport(
        effects=map_effects(fit, dict.fromkeys(freed, 0.0)) + found,
        ladder=tuple(ladder),
        unexplained=unexplained(setup, ladder[0].chi2 or math.inf, fit),
        remarks=tuple(remarks),
    )


def _band_percent(setup: DiagnosisSetup, uncertainty: MapUncertainty) -> float:
    """Half width of the map's 95 % band, rms over the measured currents, of the rated flux."""
    return 100.0 * uncertainty.band_wb(mean_currents(uncertainty.fit)) / rated_flux_wb(setup)


def _widening(
    setup: DiagnosisSetup, fit: Fit, found: Sequence[FoundEffect], added: tuple[str, Fit] | None
) -> tuple[str, float] | None:
    """An effect that was added and that the recording does not determine, and the map's band without it."""
    effect = None if added is None else next((one for one in found if one.name == added[0]), None)
    if added is None or effect is None or not undetermined_words(fit, effect):
        return None
    return effect.name, _band_percent(setup, MapUncertainty.of(setup.fitter, added[1]))


def unchanged_model(saved: MotorModel, names: Sequence[str]) -> AddReport | None:
    """The report on effects that a model has all already; None where one of them is missing in it.

    Parameters
    ----------
    names : sequence of str
        Effects of the library, at least one.
    """
    effects = {effect.name: effect for effect in saved.effects}
    if not all(name in effects for name in names):
        return None
    first, last = saved.ladder[0].chi2, saved.ladder[-1].chi2
    is_known = first is not None and last is not None and first > 1.0
    fraction = math.sqrt(max(last - 1.0, 0.0) / (first - 1.0)) if is_known and first and last else None
    text = "{effect} is in the model already: {sizes}; nothing was fitted"
    remarks = [
        Remark.of("in_model", text, effect=plain(name), sizes=_sizes(effects[name])) for name in dict.fromkeys(names)
    ]
    return AddReport(
        effects=tuple(_found(effect) for effect in saved.effects),
        ladder=saved.ladder,
        unexplained=Unexplained(fraction=fraction, shape=()),
        remarks=tuple(remarks),
    )


def _sizes(effect: ModelEffect) -> str:
    """The fitted parameters of the first one's unit, which are the effect's size."""
    fitted = {name: p for name, p in effect.parameters.items() if p.fitted} or effect.parameters
    unit = next((p.unit for p in fitted.values()), "")
    sizes = {name: p for name, p in fitted.items() if p.unit == unit}
    return ", ".join(f"{parameter_words(name)} {measured(p.value, p.low, p.high, p.unit)}" for name, p in sizes.items())


def _found(effect: ModelEffect) -> FoundEffect:
    return FoundEffect(
        name=effect.name,
        parameters={
            name: ParameterValue(value=p.value, low=p.low, high=p.high, unit=p.unit)
            for name, p in effect.parameters.items()
        },
        twins=tuple(name for name in effect.twins if name != effect.name),
        relative_size=effect.relative_size,
        log_evidence=effect.log_evidence,
    )
