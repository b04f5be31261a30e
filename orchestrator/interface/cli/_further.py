"""`fluxbench run --from RUN`: measure the experiment that a finished run's diagnosis proposes, and diagnose again."""

from __future__ import annotations

from pathlib import Path

from orchestrator.diagnosis import diagnose_recording, load_diagnosis
from orchestrator.experiment_design.proposal import next_experiment
from orchestrator.formatting.names import plain
from orchestrator.interface.cli._output import say_document, stage_as_yaml
from orchestrator.registry.plugins import PluginKind, make_plugins
from orchestrator.runs import RunDirectory, is_run, open_any
from orchestrator.stages import parse_stages, proposing_stage
from protocols import Diagnosed, DiagnosisReport, InputError, PointDone, RecordingError, StageEntry

DIAGNOSIS = Path("results") / "diagnosis.json"


def next_stages(source: Path, rounds: int) -> tuple[Path, tuple[StageEntry, ...]]:
    """The run to continue, and the stages to append to it.

    Parameters
    ----------
    source : Path
        A finished run, or the diagnosis in its results.
    rounds : int
        Maximum number of experiments, this one included.

    Raises
    ------
    InputError
        No experiment is proposed, or the recording is no run: then the stage is printed for a procedure.
    """
    path = source.parent.parent if source.is_file() and source.name == DIAGNOSIS.name else source
    report = _kept_report(path) or _journalled_report(path)
    if report is None:
        report = diagnose_recording(open_any(path), make_plugins(PluginKind.EFFECTS), propose=next_experiment).report
    if report.next_experiment is None:
        verdict = plain(report.verdict)
        inseparable = next((remark.text for remark in report.remarks if remark.code == "not_separable"), None)
        if inseparable is not None:
            raise InputError(str(path), "", inseparable)
        raise InputError(str(path), "", f"nothing to decide: {verdict}, and no experiment is proposed")
    experiment = report.next_experiment.stage
    if not is_run(path):
        say_document(stage_as_yaml(experiment))
        problem = "missing: the drive of this recording is unknown; put the stage above in a procedure"
        raise RecordingError(str(path), "run.json", problem)
    procedure = RunDirectory.open(path).procedure()
    more = proposing_stage(parse_stages(procedure)).going_on(experiment, procedure, rounds)
    return path, tuple(more)


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
