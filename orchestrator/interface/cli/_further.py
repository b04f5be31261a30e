"""`fluxbench run --from RUN`: measure the experiment that a finished run's diagnosis proposes, and diagnose again."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from orchestrator.diagnosis import diagnose_recording, load_diagnosis
from orchestrator.experiment_design.proposal import next_experiment
from orchestrator.formatting.names import plain
from orchestrator.formatting.results import by_import
from orchestrator.interface import api
from orchestrator.interface.cli._diagnosis import diagnose
from orchestrator.interface.cli._output import say_document, say_notes, stage_as_yaml
from orchestrator.recording import has_model, read_model
from orchestrator.registry.plugins import PluginKind, installed
from orchestrator.runs import RunDirectory, is_run, open_any
from orchestrator.stages import parse_stages, proposing_stage
from protocols import Diagnosed, DiagnosisReport, InputError, NextExperiment, PointDone, RecordingError, StageEntry

DIAGNOSIS = Path("results") / "diagnosis.json"


@dataclass(frozen=True)
class Continuation:
    """How a finished run goes on.

    Attributes
    ----------
    path : Path
        The run.
    stages : tuple of StageEntry
        To append to it.
    effects : Path or None
        The file of own effects that the diagnosis used. The last stage, a diagnosis, knows installed effects alone, and
        is left out of `stages` then.
    """

    path: Path
    stages: tuple[StageEntry, ...]
    effects: Path | None = None


def continuation(source: Path, rounds: int, effects: Path | None = None) -> Continuation:
    """The run to continue, and the stages to append to it.

    Parameters
    ----------
    source : Path
        A finished run, or the diagnosis in its results.
    rounds : int
        Maximum number of experiments, this one included.
    effects : Path, optional
        File of own effects; by default the one that the run's model records.

    Raises
    ------
    InputError
        No experiment is proposed, it is about an effect whose file is not known, or the recording is no run: then the
        stage is printed for a procedure.
    """
    path = source.parent.parent if source.is_file() and source.name == DIAGNOSIS.name else source
    report = _kept_report(path) or _journalled_report(path)
    if report is None:
        report = diagnose_recording(open_any(path), api.chosen_effects(effects or ()), propose=next_experiment).report
    if report.next_experiment is None:
        verdict = plain(report.verdict)
        inseparable = next((remark.text for remark in report.remarks if remark.code == "not_separable"), None)
        if inseparable is not None:
            raise InputError(str(path), "", inseparable)
        raise InputError(str(path), "", f"nothing to decide: {verdict}, and no experiment is proposed")
    experiment = report.next_experiment.stage
    if not is_run(path):
        say_document(stage_as_yaml(experiment))
        problem = (
            "missing: a recording without a run, whose drive is unknown; put the stage above in a procedure, or "
            f"{by_import(shlex.quote(str(path)))}"
        )
        raise RecordingError(str(path), "run.json", problem)
    own = _effects_file(path, report.next_experiment, effects)
    procedure = RunDirectory.open(path).procedure()
    *more, diagnosis = proposing_stage(parse_stages(procedure)).going_on(experiment, procedure, rounds)
    return Continuation(path, tuple(more) if own is not None else (*more, diagnosis), own)


def diagnose_again(path: Path, effects: Path, *, quiet: bool) -> bool:
    """Diagnose a run with own effects as `fluxbench diagnose` does; returns whether it proposes an experiment."""
    if quiet:
        return api.diagnose(path, effects=effects).report.next_experiment is not None
    say_notes([f"the run's own diagnosis knows installed effects alone; this one has those of {effects} too"])
    diagnose(path, None, effects, (), (None, None), None, as_json=False)
    kept = load_diagnosis(path)
    return kept is not None and kept.report.next_experiment is not None


def _effects_file(path: Path, proposal: NextExperiment, given: Path | None) -> Path | None:
    """The file of own effects to diagnose with: the given one, or else the one that the model was found with."""
    if given is not None:
        return given
    model = read_model(path) if has_model(path) else None
    file = next((Path(e.file) for e in (model.effects if model is not None else ()) if e.file is not None), None)
    if file is not None and file.is_file():
        return file
    known = {info.name for info in installed(PluginKind.EFFECTS)}
    unknown = [name for name in proposal.separates if name not in known]
    if unknown:
        problem = f"the experiment is about {unknown[0]}, which is not installed: give its file by --effects FILE"
        raise InputError(str(path), "", problem)
    return None


def _kept_report(path: Path) -> DiagnosisReport | None:
    """`results/diagnosis.json`, unless something was measured after it."""
    file = path / DIAGNOSIS
    if not file.is_file():
        return None
    captures = (capture.stat().st_mtime for capture in (path / "captures").glob("*.parquet"))
    if file.stat().st_mtime < max(captures, default=0.0):
        return None
    kept = load_diagnosis(path)
    return None if kept is None else kept.report


def _journalled_report(path: Path) -> DiagnosisReport | None:
    """The run's own last diagnosis, unless something was measured after it."""
    if not is_run(path):
        return None
    report: DiagnosisReport | None = None
    for entry in RunDirectory.open(path).journal.read():
        if isinstance(entry.message, Diagnosed):
            report = entry.message.report
        elif isinstance(entry.message, PointDone):
            report = None
    return report
