"""`fluxbench compare`, `diagnose`, `add` and `remove`: the model's errors, and the effects that it lacks."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.formatting.explaining import accuracy_sentences, reason_sentences
from orchestrator.formatting.names import plain, slots
from orchestrator.formatting.progress import Progress
from orchestrator.formatting.quantities import number, quantity
from orchestrator.formatting.results import (
    BENEFITS,
    CHI2_MEANING,
    CHI2_OF_NOISE_MEANING,
    NOISE_FLOOR_MEANING,
    REFIT_MEANING,
    accuracy_words,
    benefit_line,
    by_import,
    has_other_chi2,
    ladder_rows,
    objection_words,
    parameter_rows,
    resistance,
    share_notes,
    share_rows,
    trace_words,
)
from orchestrator.formatting.sentences import columns, text_table
from orchestrator.interface import api
from orchestrator.interface.cli._interrupting import Interruption, prompt_interrupt
from orchestrator.interface.cli._output import say, say_document, say_notes, say_table, stage_as_yaml
from orchestrator.interface.cli._refreshing import refresh_report
from orchestrator.interface.cli._results import in_capitals
from orchestrator.runs import is_run
from protocols import AddReport, CompareReport, DiagnosisReport, DiagnosisWords, EstimationReport, InputError

if TYPE_CHECKING:
    from orchestrator.diagnosis import InterimResult


def compare(path: Path, model: str | None, effects: Path | None, out: Path | None, as_json: bool) -> int:
    """Compare the model with the measurements."""
    with prompt_interrupt():
        report = api.compare(path, model=model, effects=effects or (), out=out)
    if as_json:
        say_document(report.model_dump_json(indent=2))
    else:
        _print_comparison(path, report)
    return 0


def diagnose(
    path: Path,
    model: str | None,
    effects: Path | None,
    without: Sequence[str],
    material: tuple[float | None, float | None],
    out: Path | None,
    as_json: bool,
    priors: Path | None = None,
) -> int:
    """Name the effects that the model lacks; `material` in % of the rated flux, and of the excitation's voltage.

    Ctrl-C ends the search: the result so far is reported, and the exit code is 130.
    """
    progress, interruption = _progress(as_json), Interruption()

    def show(interim: InterimResult) -> None:
        interruption.has_result = True
        progress.result(interim.sentence)

    with prompt_interrupt(interruption):
        kept = api.diagnose(
            path,
            model=model or "saturated",
            effects=effects or (),
            without=without,
            material_flux_percent=material[0],
            material_voltage_percent=material[1],
            out=out,
            tell=progress,
            priors=priors,
            on_interim=show,
            report_early=True,
        )
        interruption.has_result = False
        refresh_report(path, out)
    if as_json:
        say_document(kept.report.model_dump_json(indent=2))
    else:
        _print_diagnosis(path, kept.report, kept.words)
        if kept.estimates is not None:
            _print_map(kept.estimates, (out or path) / "results")
    return 130 if interruption.requested else 0


def add(
    path: Path, names: Sequence[str], model: str | None, effects: Path | None, out: Path | None, as_json: bool
) -> int:
    """Refit with these effects."""
    names = [name for word in names for name in word.split(",") if name]
    if not names:
        raise InputError("EFFECT", "", "expected names of effects, separated by spaces or commas")
    with prompt_interrupt():
        tell = _progress(as_json).result
        report = api.add(path, *names, model=model, effects=effects or (), out=out, tell=tell)
        refresh_report(path, out)
    _print_refit(report, path, effects, out, as_json)
    return 0


def remove(path: Path, name: str, effects: Path | None, out: Path | None, as_json: bool) -> int:
    """Refit without this effect."""
    with prompt_interrupt():
        report = api.remove(path, name, effects=effects or (), out=out, tell=_progress(as_json).result)
        refresh_report(path, out)
    _print_refit(report, path, effects, out, as_json)
    return 0


def _progress(as_json: bool) -> Progress:
    """The progress display: on standard error at a terminal, and where standard output is one JSON object."""
    return Progress(results=sys.stderr if as_json else sys.stdout)


def _print_comparison(path: Path, report: CompareReport) -> None:
    say(f"{path}: the model {report.model}")
    volts, amps = partial(quantity, unit="V"), partial(quantity, unit="A")
    pwm = partial(quantity, unit="Hz")
    rows = [
        (
            s.stage,
            pwm(s.pwm_frequency_hz),
            volts(s.rms_v),
            volts(s.noise_rms_v),
            number(s.chi2),
            number(s.chi2_of_noise, 3),
            amps(s.current_rms_a),
        )
        for s in report.stages
    ]
    say_table(("stage", "PWM", "rms error", "noise floor", "chi2", "noise up to", "current error"), rows)
    floor = volts(report.noise_floor.rms_v)
    say(f"over all stages: error {volts(report.rms_v)}, noise floor {floor}, chi2 {number(report.chi2)}")
    if report.heldout_rms_v is not None:
        say(f"of these, the stages that are not fitted (held out) have the error {volts(report.heldout_rms_v)}")
    say(CHI2_MEANING, CHI2_OF_NOISE_MEANING, NOISE_FLOOR_MEANING, "")
    worst = [
        (w.segment, pwm(w.pwm_frequency_hz), amps(w.i_d_a), amps(w.i_q_a), volts(w.rms_v), volts(w.noise_rms_v))
        for w in report.worst
    ]
    say_table(("worst", "PWM", "mean i_d", "mean i_q", "rms error", "noise floor"), worst)
    say_notes(report.notes)


def _print_diagnosis(path: Path, report: DiagnosisReport, words: DiagnosisWords) -> None:
    say(f"{path}: {plain(report.verdict)}", *(f"  {s}" for s in reason_sentences(report.reasons)), "")
    # Commands in the words have RUN for the recording.
    decide = words.to_decide.replace(" RUN", f" {shlex.quote(str(path))}")
    say(*columns(list(slots(words.model_copy(update={"to_decide": decide})))), "")
    if report.convention is None:
        _print_ladder(report)
        say_notes([NOISE_FLOOR_MEANING])
    heads = ("size", "error without it", "probability", "material")
    if report.leaves_most and report.effects:
        say_table(("takes up a part", *heads[:2]), [row[:3] for row in share_rows(report.effects)])
    elif report.effects:
        say_table(("cause", *heads), share_rows(report.effects))
    if report.minor:
        say_table(("in the model, but not named", *heads), share_rows(report.minor))
    say_notes(share_notes(report))
    if traces := trace_words(report):
        say(f"detected, but too small to be named: {', '.join(traces)}")
    say(*accuracy_sentences(report))
    say_notes(report.notes)
    if report.next_experiment is not None:
        run = shlex.quote(str(path))
        how = f"`fluxbench run --from {run}` measures it into a run itself" if is_run(path) else by_import(run)
        say(f"to decide, as a stage of a procedure ({how}):")
        say(stage_as_yaml(report.next_experiment.stage))
    if report.verdict in ("unknown_remains", "mostly_explained") and "`fluxbench discover" not in decide:
        say(f"`fluxbench discover {path}` looks for the law that is missing, and writes it as an effect.")


def _print_map(estimates: EstimationReport, folder: Path) -> None:
    """Print R_s and the map of the diagnosis, or why the map is not reliable."""
    if estimates.usable and estimates.resistance is not None:
        say(f"R_s {resistance(estimates.resistance)}, flux map usable: {folder / estimates.files['flux_map']}")
        say(*(f"accuracy: {words}" for words in filter(None, [accuracy_words(estimates)])))
        say_notes(r.text for r in estimates.remarks if r.code in ("far_from_nameplate", "common_factor"))
        return
    why = next((objection_words(estimates, r) for r in estimates.remarks), "no estimator succeeded")
    say(f"flux map: {in_capitals(estimates.usability)}: {why}")


def _print_refit(report: AddReport, path: Path, effects: Path | None, out: Path | None, as_json: bool) -> None:
    from orchestrator.diagnosis import load_diagnosis

    if as_json:
        say_document(report.model_dump_json(indent=2))
        return
    _print_ladder(report)
    given = (("out", out), ("effects", effects))
    options = "".join(f" --{name} {shlex.quote(str(value))}" for name, value in given if value is not None)
    run = shlex.quote(str(path))
    say("", *(benefit_line(remark, run, options) for remark in report.remarks if remark.code in BENEFITS))
    say_notes(remark.text for remark in report.remarks if remark.code not in BENEFITS)
    diagnosed = load_diagnosis(path)
    if diagnosed is not None and has_other_chi2(report.ladder, diagnosed.report.ladder):
        say_notes([REFIT_MEANING])
    if out is None:
        say(f"model: {path / 'model.json'}")
    else:
        say(f"model: {out / 'model.json'}; {path} is unchanged")


def _print_ladder(report: DiagnosisReport | AddReport) -> None:
    say_table(("model", "chi2", "error fitted", "held out", "current error"), ladder_rows(report.ladder))
    immaterial = report.minor if isinstance(report, DiagnosisReport) else ()
    rows = [(effect.name, *row) for effect in (*report.effects, *immaterial) for row in parameter_rows(effect)]
    if rows:
        say("", text_table(("effect", "parameter", "value", "95 %"), rows, numbers=False))
