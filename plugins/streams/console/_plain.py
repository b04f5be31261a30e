"""The run as plain lines, for logs and pipes: no escape codes, nothing is ever overwritten."""

from __future__ import annotations

from typing import TextIO

from plugins.streams.console._findings import (
    comparison_line,
    proposal_line,
    slot_rows,
    step_figures,
    step_name,
    verdict,
)
from plugins.streams.console._progress import Progress
from plugins.streams.console._words import (
    ASCII,
    can_draw,
    duration,
    plural,
    printable,
    resistance,
    stage_title,
    state_name,
    summary_rows,
    time_left,
    typeset,
    vector,
)
from protocols import (
    Compared,
    Diagnosed,
    DiagnosisStep,
    ExperimentProposed,
    LockChecked,
    MapEstimated,
    Message,
    Note,
    OperatorAnswered,
    OperatorAsked,
    PointDone,
    ResistanceEstimated,
    RunEnded,
    RunStarted,
    StageStarted,
    StateChanged,
)

EVERY_PART = 0.1
EVERY_S = 5.0
"""A progress line comes when a tenth of all points, or this many seconds, have passed; never twice a second."""
AT_LEAST_S = 0.5

WORTH_A_LINE = ("paused", "stopping", "faulted", "aborted")


class PlainView:
    """A line for each stage, for progress now and then, for states that matter, and for faults."""

    def __init__(self, output: TextIO) -> None:
        self._output = output
        self._draws = can_draw(output)
        self._told_part = 0.0
        self._told_s = float("-inf")
        self._prompt = ""

    def show(self, message: Message, progress: Progress) -> None:
        if progress.finished is not None:
            stage = progress.finished
            took = duration(progress.clock() - stage.begun_s)
            self._line(f"{stage_title(progress, stage)}: {plural(stage.done, 'point')} in {took}")
        for line in self._lines(message, progress):
            self._line(line)

    def close(self) -> None:
        """There is nothing to put back."""

    def _lines(self, message: Message, progress: Progress) -> list[str]:
        if isinstance(message, RunStarted):
            self._told_part = progress.fraction
            return [_opening(message)]
        if isinstance(message, StageStarted) and progress.stage is not None:
            return [f"{stage_title(progress, progress.stage)}: begins, {plural(message.points, 'point')}"]
        if isinstance(message, StateChanged) and message.target in WORTH_A_LINE:
            return [f"{state_name(message.target)}{': ' + message.reason if message.reason else ''}"]
        if isinstance(message, PointDone):
            return self._progress_lines(progress)
        return self._words(message) or _findings(message)

    def _progress_lines(self, progress: Progress) -> list[str]:
        now = progress.clock()
        waited = now - self._told_s
        part = progress.fraction - self._told_part
        if waited < AT_LEAST_S or (part < EVERY_PART and waited < EVERY_S):
            return []
        self._told_s, self._told_part = now, progress.fraction
        reached = "" if progress.achieved is None else f", at {vector(progress.achieved)}"
        counted = f"{progress.points_done} of {progress.points} points"
        return [f"{progress.fraction:4.0%}  {counted}, {time_left(progress)}{reached}"]

    def _words(self, message: Message) -> list[str]:
        if isinstance(message, OperatorAsked):
            self._prompt = message.prompt
            return []
        if isinstance(message, OperatorAnswered):
            prompt, self._prompt = self._prompt or "operator", ""
            return [f"{prompt} {message.answer}{', says the procedure' if message.by == 'procedure' else ''}"]
        if isinstance(message, LockChecked):
            return [f"lock check: {typeset(message.summary)}"]
        if isinstance(message, ResistanceEstimated):
            return [f"R_s = {resistance(message.estimate)}"]
        if isinstance(message, MapEstimated):
            grid = message.estimate.map
            return [f"flux map by {grid.method}: {len(grid.i_d)} x {len(grid.i_q)} currents"]
        if isinstance(message, Note):
            return [f"{'' if message.level == 'info' else message.level + ': '}{typeset(message.text)}"]
        if isinstance(message, RunEnded):
            return ["", *_table(message)]
        return []

    def _line(self, text: str) -> None:
        told = printable(text)
        self._output.write((told if self._draws else _ascii(told)) + "\n")
        self._output.flush()


class QuietView(PlainView):
    """Warnings, errors, and how it ended."""

    def show(self, message: Message, progress: Progress) -> None:
        if isinstance(message, Note) and message.level != "info":
            self._line(f"{message.level}: {message.text}")
        elif isinstance(message, RunEnded) and message.outcome != "finished":
            self._line(f"{message.outcome}: {message.reason}")


def _findings(message: Message) -> list[str]:
    if isinstance(message, Compared):
        return [comparison_line(message)]
    if isinstance(message, DiagnosisStep):
        return [f"{step_name(message):<24}  {step_figures(message)}"]
    if isinstance(message, Diagnosed):
        return [f"diagnosis: {verdict(message)}", *_aligned(list(slot_rows(message)))]
    if isinstance(message, ExperimentProposed):
        return [proposal_line(message)]
    return []


def _ascii(text: str) -> str:
    return text.translate(ASCII).encode("ascii", "replace").decode("ascii")


def _opening(message: RunStarted) -> str:
    done = f", {message.points_done} of them done before" if message.points_done else ""
    return (
        f"{message.name}: {message.motor.name} on the drive {message.drive}, "
        f"{plural(message.points, 'point')}{done}, {duration(message.seconds)} on the drive's clock"
    )


def _table(message: RunEnded) -> list[str]:
    return _aligned(list(summary_rows(message)))


def _aligned(rows: list[tuple[str, str]]) -> list[str]:
    width = max((len(label) for label, _ in rows), default=0)
    return [f"{label:<{width}}  {text}" for label, text in rows]
