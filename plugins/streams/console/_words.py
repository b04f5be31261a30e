"""What the console tells beside the messages' own sentences: how far a run is, and what it came to."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from orchestrator.formatting.events import step_error_v
from orchestrator.formatting.names import rung_name, slots
from orchestrator.formatting.quantities import UNKNOWN, duration, number, plural, quantity
from orchestrator.formatting.results import check_rows, effect_notes, resistance
from orchestrator.formatting.sentences import shortened, typographic
from plugins.streams.console._progress import Progress, StageProgress
from protocols import Diagnosed, DiagnosisStep, EstimationReport, RunEnded, Usability


def stage_title(progress: Progress, stage: StageProgress) -> str:
    """Which stage, of how many."""
    of = f" of {progress.stages}" if progress.stages else ""
    return f"stage {stage.index + 1}{of}, {stage.name}"


def time_left(progress: Progress) -> str:
    """What is left on the drive's clock, and on the wall where the two differ."""
    if progress.points and progress.points_done >= progress.points:
        return "all points measured"
    on_drive, on_wall = progress.left_s, progress.wall_left_s
    drive, wall = (duration(max(1, round(left or 0.0))) for left in (on_drive, on_wall))
    if on_wall is None:
        return f"{drive} of measuring left, on the drive's clock"
    if abs(on_wall - on_drive) <= 0.2 * on_drive:
        return f"{wall} of measuring left"
    return f"{wall} of measuring left ({drive} on the drive's clock)"


def stage_ending(stage: StageProgress, seconds: float) -> str | None:
    """How a stage ended; None where it measured nothing and took no time worth a line."""
    if stage.points:
        return f"{plural(stage.done, 'point')} in {duration(seconds)}"
    return f"done in {duration(seconds)}" if seconds >= 1.0 else None


def step_line(step: DiagnosisStep) -> tuple[str, str]:
    """A rung of the ladder: what it added, and chi2, rms and held-out rms."""
    misfit = f"chi2 {number(step.chi2, 3):>7}  fitted {quantity(step.rms_v, 'V'):>8}"
    held = "" if step.heldout_rms_v is None else f"  held out {quantity(step.heldout_rms_v, 'V'):>8}"
    return rung_name(step.added, step.index).ljust(24), misfit + held


def step_bar(step: DiagnosisStep, cells: int, decades: float = 3.0) -> str:
    """The held-out error above the noise: so many cells for so many decades."""
    error = step_error_v(step)
    if step.noise_rms_v <= 0.0 or error <= step.noise_rms_v:
        return ""
    return "━" * max(1, min(cells, round(cells / decades * math.log10(error / step.noise_rms_v))))


def diagnosis_rows(message: Diagnosed) -> list[tuple[str, str]]:
    """A diagnosis in words, and what its effects remark on their sizes; nothing without words."""
    if not message.words:
        return []
    return [*slots(message.words), *(("note", text) for text in effect_notes(message.report))]


def summary_rows(message: RunEnded, run: Path, longest: int = 220) -> Iterator[tuple[str, str]]:
    """The end of a run as label and text, the most wanted first; remarks of at most so many letters."""
    yield "outcome", f"{message.outcome}: {message.reason}" if message.reason else message.outcome
    if message.estimates is not None:
        yield from _estimate_rows(message.estimates, run / "results", longest)
    yield "run", str(run)


_USABLE = {
    Usability.USABLE: "yes",
    Usability.NOT_USABLE: "no",
    Usability.NOT_JUDGED: "not judged; fluxbench diagnose decides",
}


def _estimate_rows(report: EstimationReport, folder: Path, longest: int) -> Iterator[tuple[str, str]]:
    """The estimates, their remarks, and their files."""
    if report.resistance is not None:
        yield "R_s", resistance(report.resistance)
    if report.method is not None:
        yield "map by", report.method
    yield "map usable", _USABLE[report.usability]
    yield from (row for row in check_rows(report) if row[1] != UNKNOWN)
    for k, remark in enumerate(report.remarks):
        yield "" if k else "remarks", shortened(typographic(remark.text), longest)
    for name, file in sorted(report.files.items(), key=lambda file: (file[0] == "estimates", file[0])):
        yield name, str(folder / file)
