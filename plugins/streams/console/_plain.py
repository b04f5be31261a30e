"""The run as plain lines, for logs and pipes: no escape codes, nothing is ever overwritten."""

from __future__ import annotations

from typing import TextIO

from orchestrator.formatting.events import describe
from orchestrator.formatting.quantities import plural, vector
from orchestrator.formatting.sentences import columns, cut, for_output, one_line
from plugins.streams.console._progress import Progress
from plugins.streams.console._words import diagnosis_rows, stage_ending, stage_title, step_line, summary_rows, time_left
from protocols import (
    Diagnosed,
    DiagnosisStep,
    Message,
    Note,
    OperatorAnswered,
    OperatorAsked,
    PointDone,
    RunEnded,
    RunStarted,
    StagesAppended,
    StageStarted,
    StateChanged,
    UnderWay,
)

WORTH_A_LINE = ("paused", "stopping", "faulted", "aborted")
"""States that get a line beside the stages."""


class PlainView:
    """A line for each stage, for progress now and then, for states that matter, and for faults.

    Parameters
    ----------
    output : TextIO
    every_part, every_s : float
        A progress line comes when so much of all points, or so many seconds, have passed.
    least_s : float
        Between two of them.
    """

    def __init__(self, output: TextIO, *, every_part: float = 0.1, every_s: float = 5.0, least_s: float = 0.5) -> None:
        self._output = output
        self._every_part, self._every_s, self._least_s = every_part, every_s, least_s
        self._printed_part = 0.0
        self._printed_s = float("-inf")
        self._prompt = ""

    def show(self, message: Message, progress: Progress) -> None:
        if progress.finished is not None:
            stage = progress.finished
            if ending := stage_ending(stage, progress.clock() - stage.begun_s):
                self._line(f"{stage_title(progress, stage)}: {ending}")
        for line in self._lines(message, progress):
            self._line(line)

    def close(self) -> None:
        """There is nothing to put back."""

    def _lines(self, message: Message, progress: Progress) -> list[str]:
        match message:
            case RunStarted():
                self._printed_part = progress.fraction
            case StageStarted() if progress.stage is not None:
                points = f", {plural(message.points, 'point')}" if message.points else ""
                return [f"{stage_title(progress, progress.stage)}: begins{points}"]
            case PointDone():
                return self._progress_lines(progress)
            case UnderWay(is_result=False):
                return self._work_lines(progress)
            case OperatorAsked():
                self._prompt = message.prompt
                return []
            case OperatorAnswered():
                prompt, self._prompt = self._prompt or "operator", ""
                return [f"{prompt} {message.answer}{', says the procedure' if message.by == 'procedure' else ''}"]
            case DiagnosisStep():
                return ["  ".join(step_line(message))]
            case RunEnded():
                return ["", *columns(list(summary_rows(message, progress.run)))]
            case StagesAppended():
                return []
            case StateChanged() if message.target not in WORTH_A_LINE:
                return []
        event = describe(message)
        slot_lines = columns(diagnosis_rows(message)) if isinstance(message, Diagnosed) else []
        return [] if event is None else [event.line, *slot_lines]

    def _progress_lines(self, progress: Progress) -> list[str]:
        now = progress.clock()
        waited = now - self._printed_s
        part = progress.fraction - self._printed_part
        if waited < self._least_s or (part < self._every_part and waited < self._every_s):
            return []
        self._printed_s, self._printed_part = now, progress.fraction
        reached = "" if progress.achieved is None else f", at {vector(*progress.achieved)}"
        counted = f"{progress.points_done} of {progress.points} points"
        return [f"{progress.fraction:4.0%}  {counted}, {time_left(progress)}{reached}"]

    def _work_lines(self, progress: Progress) -> list[str]:
        """What is under way, now and then: a search goes through hundreds of fits."""
        now = progress.clock()
        if now - self._printed_s < self._every_s:
            return []
        self._printed_s = now
        return [f"  {progress.work}"]

    def _line(self, text: str) -> None:
        self._output.write(for_output(one_line(cut(text)), self._output) + "\n")
        self._output.flush()


class QuietView(PlainView):
    """Warnings, errors, and how it ended."""

    def show(self, message: Message, progress: Progress) -> None:
        event = describe(message)
        is_bad = isinstance(message, RunEnded) and message.outcome != "finished"
        if event is not None and (is_bad or (isinstance(message, Note) and message.level != "info")):
            self._line(event.line)
