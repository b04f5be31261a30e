"""`fluxbench compare`, `diagnose`, `add` and `remove`: where the model fails, and what is missing in it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orchestrator.cli._interrupting import prompt_interrupt
from orchestrator.cli._tables import amount, print_table, stage_as_yaml
from orchestrator.diagnosis import (
    CROSS_SATURATION,
    SATURATION,
    ModelChoice,
    add_effects,
    compare_recording,
    diagnose_and_keep,
    guarded,
    in_volts,
    remove_effect,
)
from orchestrator.exporting import load_map
from orchestrator.registry import PluginKind, installed, load_effects_file, load_plugin
from orchestrator.runs import open_any, refuse_file
from protocols import AddReport, CompareReport, DiagnosisReport, DiagnosisWords, Effect, PluginError

SLOTS = {
    "where_it_fails": "where it fails",
    "what_it_looks_like": "what it looks like",
    "likely_cause": "likely cause",
    "if_added": "if added",
    "to_decide": "to decide",
}


def compare(path: Path, model: str | None, effects: Path | None, out: Path | None, as_json: bool) -> int:
    """Hold the model against the measurements."""
    _refuse_files(out)
    with prompt_interrupt():
        report = compare_recording(open_any(path), _library(effects), model=_model(model), out=out)
    if as_json:
        print(report.model_dump_json(indent=2))
    else:
        _print_comparison(report)
    return 0


def diagnose(
    path: Path, model: str | None, effects: Path | None, without: Sequence[str], out: Path | None, as_json: bool
) -> int:
    """Name what the model lacks."""
    _refuse_files(out)
    with prompt_interrupt():
        diagnosis, kept = diagnose_and_keep(
            open_any(path), _library(effects), model=_model(model) or "saturated", without=without, out=out
        )
    if as_json:
        print(diagnosis.report.model_dump_json(indent=2))
    else:
        _print_diagnosis(diagnosis.report, kept.words)
    return 0


def add(
    path: Path, names: Sequence[str], model: str | None, effects: Path | None, out: Path | None, as_json: bool
) -> int:
    """Refit with these effects."""
    _refuse_files(out)
    with prompt_interrupt():
        report = add_effects(open_any(path), names, _library(effects), model=_model(model), out=out)
    _say_added(report, as_json)
    return 0


def remove(path: Path, name: str, effects: Path | None, out: Path | None, as_json: bool) -> int:
    """Refit without this effect."""
    _refuse_files(out)
    with prompt_interrupt():
        report = remove_effect(open_any(path), name, _library(effects), out=out)
    _say_added(report, as_json)
    return 0


def _refuse_files(out: Path | None) -> None:
    if out is not None:
        refuse_file(out)


def _library(extra: Path | None) -> list[Effect]:
    """The installed effects, and those of a file; raises `PluginError` where two have one name."""
    effects: list[Effect] = [load_plugin(PluginKind.EFFECTS, info.name)() for info in installed(PluginKind.EFFECTS)]
    for made in load_effects_file(extra) if extra is not None else []:
        effect = guarded(_made(made, extra))
        if effect.name in {SATURATION, CROSS_SATURATION, *(e.name for e in effects)}:
            raise PluginError(str(extra), effect.name, "there is an effect of that name already: choose another")
        effects.append(effect)
    return effects


def _made(kind: type[Any], file: Path | None) -> Effect:
    try:
        effect: Effect = kind()
    except (Exception, SystemExit) as error:  # somebody else's code may raise anything
        raise PluginError(str(file), kind.__name__, f"cannot be made: {type(error).__name__}: {error}") from error
    return effect


def _model(choice: str | None) -> ModelChoice | None:
    return choice if choice in (None, "linear", "saturated") else load_map(Path(str(choice)))


def _print_comparison(report: CompareReport) -> None:
    print(f"{report.recording}: the model {report.model}")
    rows = [
        (stage.stage, in_volts(stage.rms_v), _number(stage.chi2), amount(stage.current_rms_a, "A"))
        for stage in report.stages
    ]
    print_table(("stage", "rms error", "chi2", "current error"), rows)
    print(f"noise floor {in_volts(report.noise_floor.rms_v)}, chi2 over all {_number(report.chi2)}")
    print_table(
        ("worst", "i_d", "i_q", "rms error"),
        [(w.segment, amount(w.i_d_a, "A"), amount(w.i_q_a, "A"), in_volts(w.rms_v)) for w in report.worst],
    )
    _print_notes(report.notes)


def _print_diagnosis(report: DiagnosisReport, words: DiagnosisWords) -> None:
    print(f"{report.recording}: {report.verdict.replace('_', ' ')}")
    print()
    for field, title in SLOTS.items():
        print(f"{title:<19} {getattr(words, field)}")
    print()
    _print_ladder(report)
    if report.traces:
        print(f"traces, below what deserves a name: {', '.join(report.traces)}")
    _print_notes(report.notes)
    if report.next_experiment is not None:
        print("to decide, as a stage of a procedure (`fluxbench run --from` measures it into the run itself):")
        print(stage_as_yaml(report.next_experiment.stage))


def _say_added(report: AddReport, as_json: bool) -> None:
    if as_json:
        print(report.model_dump_json(indent=2))
        return
    _print_ladder(report)
    _print_notes(report.notes)


def _print_ladder(report: DiagnosisReport | AddReport) -> None:
    rows = [
        (
            rung.added or "(the map alone)",
            _number(rung.chi2),
            in_volts(rung.rms_v),
            in_volts(rung.heldout_rms_v),
            amount(rung.current_rms_a, "A"),
        )
        for rung in report.ladder
    ]
    print_table(("added", "chi2", "rms error", "held out", "current error"), rows)
    for effect in report.effects:
        for name, found in effect.parameters.items():
            interval = "" if found.low is None or found.high is None else f", 95 % {found.low:.4g} to {found.high:.4g}"
            print(f"{effect.name}: {name} = {_number(found.value)} {found.unit}{interval}")


def _print_notes(notes: Sequence[str]) -> None:
    for note in notes:
        print(f"note: {note}")


def _number(value: float | None) -> str:
    """Four digits, no exponent for what is large."""
    if value is None:
        return "-"
    return f"{value + 0.0:.4g}" if abs(value) < 9999.5 else f"{value:.0f}"
