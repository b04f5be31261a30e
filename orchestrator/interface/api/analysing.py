"""Analysis of measurements: estimates, comparison, diagnosis and changes of the model's effects."""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from difflib import get_close_matches
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orchestrator.formatting.deciding import map_advice
from orchestrator.interface.api.threads import one_thread
from orchestrator.recording import MANIFEST_NAME, has_model, has_recording, read_manifest, read_model, require_recording
from orchestrator.registry.plugins import PLUGIN_NAME, PluginKind, load_effects_file, make_plugins
from orchestrator.runs import is_run, open_any, refuse_file
from protocols import (
    AddReport,
    CompareReport,
    Effect,
    Estimate,
    EstimationReport,
    Explanation,
    FluxbenchError,
    FluxMap,
    InputError,
    MotorModel,
    PluginError,
    Remark,
)

if TYPE_CHECKING:
    import xarray as xr

    from orchestrator.diagnosis import InterimResult, ModelChoice, SavedDiagnosis
    from orchestrator.discovery import Discovery
    from orchestrator.interface.comparison import ComparedRuns
    from protocols.fleet_priors import FleetPriors

Place = str | PathLike[str]
"""A run or recording: its directory, or `Measurements`."""
AnyPath = str | PathLike[str]
"""A file or folder."""
Model = AnyPath | FluxMap | MotorModel
"""``saturated``, ``linear``, a flux map or a motor model, or the file of either."""
BASELINES = ("linear", "saturated")
"""The model before any effect: constant inductances of the nameplate, or a free map."""
Effects = AnyPath | Sequence[Effect]
"""Candidates beside the installed effects: a Python file, or the effects themselves."""


@one_thread()
def estimate(
    place: Place,
    *,
    estimators: Sequence[str] | None = None,
    out: AnyPath | None = None,
    on_estimate: Callable[[Estimate], None] = lambda _: None,
) -> EstimationReport:
    """R_s, flux and inductance maps, and checks of their consistency; written to ``results/``.

    Parameters
    ----------
    estimators : sequence of str, optional
        Names of the estimators; all installed ones by default.
    out : path, optional
        Folder for ``results/``. By default the recording; for chosen estimators its ``estimators/<names>/``, so that
        the results of all of them stay: a map of one alone lacks what the others contribute, and has fewer checks.
    on_estimate : callable
        Called with each resistance and each flux map as soon as its estimator is done.

    Raises
    ------
    RecordingError, NotMeasuredError, StorageError
    """
    from orchestrator.estimation import estimate_recording
    from orchestrator.screening import check_model

    path = Path(place)
    recording = open_any(path, keep=out is None)
    target = estimates_folder(path, estimators or (), out)
    refuse_file(target)
    refuse_file(target / "results")
    plugins = make_plugins(PluginKind.ESTIMATORS, estimators or None)
    return estimate_recording(
        recording,
        plugins,
        target,
        on_estimate=on_estimate,
        check_model=partial(check_model, chosen_effects()),
    )


def estimates_folder(path: Path, estimators: Sequence[str], out: AnyPath | None) -> Path:
    """The folder whose ``results/`` an estimation writes."""
    if out is not None:
        return Path(out)
    return path / "estimators" / "+".join(dict.fromkeys(estimators)) if estimators else path


@one_thread()
def compare(
    place: Place, *, model: Model | None = None, effects: Effects = (), out: AnyPath | None = None
) -> CompareReport:
    """The errors of a model, and whether given effects help; see `orchestrator.diagnosis.compare_recording`."""
    from orchestrator.diagnosis import compare_recording

    installed = {effect.name for effect in chosen_effects()} if effects else set()
    every = chosen_effects(effects)
    return compare_recording(
        open_any(Path(place)),
        every,
        model=chosen_model(model),
        out=_directory(out, writes=False),
        candidates=[effect.name for effect in every if effects and _is_own(effect, effects, installed)],
    )


@one_thread()
def compare_runs(*places: Place) -> ComparedRuns:
    """A comparison of runs, and changes beyond noise; see `orchestrator.interface.comparison.compare_runs`."""
    from orchestrator.interface.comparison import compare_runs as compare_paths

    return compare_paths([Path(place) for place in places])


@one_thread()
def diagnose(
    place: Place,
    *,
    model: Model = "saturated",
    effects: Effects = (),
    without: Sequence[str] = (),
    segments: Sequence[str] | None = None,
    material_flux_percent: float | None = None,
    material_voltage_percent: float | None = None,
    out: AnyPath | None = None,
    tell: Callable[[str], None] = lambda _: None,
    priors: FleetPriors | AnyPath | None = None,
    workers: int | None = None,
    on_interim: Callable[[InterimResult], None] = lambda _: None,
    report_early: bool = False,
) -> SavedDiagnosis:
    """The effects that the model lacks; see `orchestrator.diagnosis.diagnose_recording`. Stored with its model.

    Parameters
    ----------
    segments : sequence of str, optional
        Ids of the segments to use; all by default. The result is stored as if they were the whole recording; use a
        separate folder `out` for it.
    material_flux_percent, material_voltage_percent : float, optional
        Smallest change of the map in % of the rated flux, and of the voltage in % of the applied one, that makes an
        effect material.
    tell : callable
        Called with the current step, in a few words.
    priors : FleetPriors or path, optional
        Priors from other motors of the same kind, or the file of `fluxbench fleet priors`.
    workers : int
        Number of workers; by default the number of cores, up to four. The result does not depend on it.
    on_interim : callable
        Called with the search's result so far, whenever that has changed; its `sentence` describes it.
    report_early : bool
        Whether `KeyboardInterrupt` (Ctrl-C) ends the search with a report of the result so far, whose first remark
        has the code ``ended_early``. Before the first result, and the second time, it is raised.
    """
    from orchestrator.diagnosis import Criteria, diagnose_and_keep, workers_here
    from orchestrator.experiment_design.proposal import next_experiment

    percents = {"material_flux": material_flux_percent, "material_voltage": material_voltage_percent}
    materiality = {name: 0.01 * percent for name, percent in percents.items() if percent is not None}
    criteria = Criteria.model_validate({"materiality": materiality})

    recording = open_any(Path(place))
    return diagnose_and_keep(
        recording if segments is None else recording.limited_to(segments),
        chosen_effects(effects),
        propose=next_experiment,
        model=chosen_model(model) or "saturated",
        without=without,
        out=_directory(out),
        tell=tell,
        criteria=criteria,
        priors=_chosen_priors(priors),
        workers=workers or workers_here(),
        on_interim=on_interim,
        report_early=report_early,
    )[1]


def explain(place: Place) -> Explanation:
    """The reasons of the latest diagnosis: of its verdict, the steps of the search, the evidence for each effect.

    Raises
    ------
    InputError
        Where there is no diagnosis.
    RecordingError
        Where its file is damaged.
    """
    from orchestrator.diagnosis import explanation_of, load_diagnosis

    path = Path(place)
    diagnosis = load_diagnosis(path)
    if diagnosis is None:
        require_recording(path)
        raise InputError(str(path), "", f"has no diagnosis yet; run `fluxbench diagnose {path}` first")
    explanation = explanation_of(diagnosis.report, read_model(path) if has_model(path) else None)
    return explanation.model_copy(
        update={"to_decide": diagnosis.words.to_decide, "next_steps": _next_steps(path, diagnosis)}
    )


def _next_steps(path: Path, diagnosis: SavedDiagnosis) -> tuple[str, ...]:
    """What to do with the map and the model, as the report says it; of results without their recording, too."""
    from orchestrator.diagnosis.reporting.advice import advice_on
    from orchestrator.estimation import load_estimates

    is_here = has_recording(path)
    run = shlex.quote(str(path)) if is_here else "RECORDING"
    drive = estimates = None
    with suppress(FluxbenchError):  # the results alone
        drive = read_manifest(path / MANIFEST_NAME).drive
    with suppress(FluxbenchError):  # never estimated
        estimates = load_estimates(path)
    advice = advice_on(diagnosis.report, diagnosis.words, drive, run, is_imported=is_here and not is_run(path))
    details = (f"  {item}" for item in advice.items)
    return (f"the map: {map_advice(estimates, run)}", f"the model: {advice.text}", *details)


@one_thread()
def discover(
    place: Place,
    *,
    write: AnyPath | None = None,
    name: str | None = None,
    effects: Effects = (),
    without: Sequence[str] = (),
    out: AnyPath | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Discovery:
    """The law that a recording requires beyond the library; see `orchestrator.discovery.discover_laws`.

    A recording without a diagnosis is diagnosed first. The result is stored as ``results/discovery.json``, with the
    curve as ``results/discovery.svg``.

    Parameters
    ----------
    write : path, optional
        File of effects to write the law to; nothing is written where there is none.
    name : str, optional
        Name of the effect; the file's by default, or ``learned_law``.
    without : sequence of str
        Effects left out of the library, as in `diagnose`, and taken out of the diagnosis' model.
    tell : callable
        Called with the current step, in a few words.

    Raises
    ------
    InputError
        Where `write` is no Python file or cannot be written, or the name cannot be one or is an effect's already.
    PluginError
        Where an effect in `without` is not known.
    StorageError
        Where a file cannot be written.
    """
    from orchestrator.diagnosis import CROSS_SATURATION, SATURATION, load_diagnosis, require_known
    from orchestrator.discovery import discover_laws, require_name, save_discovery, write_law

    target = Path(write) if write is not None else None
    library = chosen_effects(effects)
    require_known(without, library)
    taken = {SATURATION, CROSS_SATURATION, *(effect.name for effect in library)}
    called = require_name(name or (target.stem if target is not None else "learned_law"), target, taken)
    directory = _directory(out) or Path(place)
    diagnosis = load_diagnosis(directory)
    if diagnosis is None or not has_model(directory):
        diagnosis = diagnose(place, effects=effects, without=without, out=out, tell=tell)
    model = read_model(directory) if has_model(directory) else None
    recording = open_any(Path(place))
    found = discover_laws(recording, library, model, diagnosis.report, name=called, without=without, tell=tell)
    save_discovery(directory, found)
    if target is not None:
        write_law(target, found)
    return found.report


@one_thread()
def add(
    place: Place,
    *names: str,
    model: Model | None = None,
    effects: Effects = (),
    out: AnyPath | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> AddReport:
    """Refit the model with these effects; see `orchestrator.diagnosis.add_effects`. Stored in `model.json`.

    Parameters
    ----------
    tell : callable
        Called with the current step, in a few words.
    """
    from orchestrator.diagnosis import add_effects

    report = add_effects(
        open_any(Path(place)), names, chosen_effects(effects), model=chosen_model(model), out=_directory(out), tell=tell
    )
    if not effects or all(remark.code != "in_model" for remark in report.remarks):
        return report
    text = "if an effect's file has changed since: `fluxbench remove` it first, then `add` fits it again"
    return report.model_copy(update={"remarks": (*report.remarks, Remark.of("file_may_have_changed", text))})


@one_thread()
def remove(
    place: Place,
    name: str,
    *,
    effects: Effects = (),
    out: AnyPath | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> AddReport:
    """Refit the model without this effect; see `orchestrator.diagnosis.remove_effect`. Stored in `model.json`.

    Parameters
    ----------
    tell : callable
        Called with the current step, in a few words.
    """
    from orchestrator.diagnosis import remove_effect

    return remove_effect(open_any(Path(place)), name, chosen_effects(effects), out=_directory(out), tell=tell)


def map_of(model: MotorModel | AnyPath) -> xr.Dataset:
    """The map of a model, without effects, over ``i_d`` and ``i_q``; NaN where nothing was measured.

    Parameters
    ----------
    model : MotorModel or path
        A model, its `model.json`, or the run or recording that has one.
    """
    from orchestrator.diagnosis import flux_map_of
    from orchestrator.estimation import flux_dataset

    whole = model if isinstance(model, MotorModel) else read_model(Path(model))
    return flux_dataset(flux_map_of(whole), motor=whole.motor.name, recording=whole.recording)


def chosen_model(choice: Model | None) -> ModelChoice | None:
    """The chosen baseline or model, read from its file where it is a path; raises `InputError`."""
    if choice is None or isinstance(choice, FluxMap | MotorModel):
        return choice
    path = Path(choice)
    if str(path) in BASELINES:
        return str(path)
    from orchestrator.flux_maps import load_map

    if not path.suffix and not path.exists():
        close = get_close_matches(str(path), BASELINES, 1)
        hint = f"; did you mean '{close[0]}'?" if close else "; a file ends in .nc, .csv, .npz, .mat, .json or .yaml"
        raise InputError(str(path), "", f"neither {', '.join(BASELINES)} nor a file{hint}")
    return read_model(path) if path.suffix == ".json" else load_map(path)


def chosen_effects(more: Effects = ()) -> list[Effect]:
    """The installed effects and more; raises `PluginError` where two have one name."""
    from orchestrator.diagnosis import CROSS_SATURATION, SATURATION, guarded

    effects: list[Effect] = make_plugins(PluginKind.EFFECTS)
    if isinstance(more, str | PathLike):
        where = str(more)
        own = [_instance(kind, where) for kind in load_effects_file(Path(more))]
        # An installed plugin may be given by its file, too: it is one effect, in the file's current form.
        effects = [effect for effect in effects if _file_of(effect) != Path(more).resolve()]
    else:
        where, own = "effects", list(more)
        effects = [effect for effect in effects if type(effect) not in set(map(type, own))]
    for effect in map(guarded, own):
        if not PLUGIN_NAME.match(effect.name):
            problem = "a name has lower-case letters, digits and underscores"
            raise PluginError(where, effect.name, problem)
        if effect.name in {SATURATION, CROSS_SATURATION, *(e.name for e in effects)}:
            problem = "an effect of that name exists already: choose another, or leave --effects out if it is this one"
            raise PluginError(where, effect.name, problem)
        effects.append(effect)
    return effects


def _is_own(effect: Effect, more: Effects, installed: Collection[str]) -> bool:
    """Whether an effect was given beside the installed ones, or by the file of one."""
    if effect.name not in installed:
        return True
    if isinstance(more, str | PathLike):
        return _file_of(effect) == Path(more).resolve()
    return effect.name in {one.name for one in more}


def _file_of(effect: Effect) -> Path:
    return Path(inspect.getfile(type(effect))).resolve()


def _chosen_priors(choice: FleetPriors | AnyPath | None) -> FleetPriors | None:
    if not isinstance(choice, str | PathLike):
        return choice
    from orchestrator.recording import read_json
    from protocols.fleet_priors import FleetPriors

    return read_json(Path(choice), FleetPriors)


def _instance(kind: type[Any], where: str) -> Effect:
    try:
        effect: Effect = kind()
    except (Exception, SystemExit) as error:  # foreign code may raise anything
        raise PluginError(where, kind.__name__, f"cannot be created: {type(error).__name__}: {error}") from error
    return effect


def _directory(out: AnyPath | None, *, writes: bool = True) -> Path | None:
    if out is None:
        return None
    refuse_file(Path(out), writes=writes)
    return Path(out)
