"""The run on a terminal: a few lines that stay below, everything that is over above them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.segment import Segment
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from orchestrator.formatting.events import describe
from orchestrator.formatting.names import OUTCOME_MOODS, plain
from orchestrator.formatting.quantities import vector
from orchestrator.formatting.results import resistance
from orchestrator.formatting.sentences import cut, one_line, visible
from plugins.streams.console._progress import Progress
from plugins.streams.console._words import (
    diagnosis_rows,
    stage_ending,
    stage_title,
    step_bar,
    step_line,
    summary_rows,
    time_left,
)
from protocols import (
    Diagnosed,
    DiagnosisStep,
    Message,
    OperatorAnswered,
    OperatorAsked,
    RunEnded,
    RunStarted,
    StagesAppended,
    StageStarted,
    StateChanged,
)

MARKS = {
    "good": ("✓ ", "green"),
    "bad": ("✗ ", "bold red"),
    "warning": ("! ", "yellow"),
    "info": ("· ", "dim"),
}


IN_THE_DISPLAY = (StageStarted, StateChanged, StagesAppended, OperatorAsked, RunEnded)
"""What has a place of its own below."""


class TerminalConsole(Console):
    """A rich console that lets a broken pipe surface, where rich itself would end the process, and escapes texts."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError("the terminal is gone")

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """What rich draws; of its texts nothing is obeyed by the terminal, whoever forgot to see to that."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(visible(segment.text), segment.style)


class LiveView:
    """Rich live display, redrawn by a ticker of its own so that time goes on between messages."""

    def __init__(self, output: TextIO) -> None:
        self._console = TerminalConsole(file=output, force_terminal=True, highlight=False)
        self._display = _Display()
        self._lock = threading.Lock()
        self._ticker: _Ticker | None = None
        self._live: Live | None = None
        self._prompt = ""
        self._is_over = False

    def show(self, message: Message, progress: Progress) -> None:
        with self._lock:
            self._display.progress = progress
            if progress.finished is not None:
                stage = progress.finished
                if ending := stage_ending(stage, progress.clock() - stage.begun_s):
                    self._print_line("good", f"{stage_title(progress, stage)}, {ending}")
            self._tell(message)
        self._drive_display(message)

    def close(self) -> None:
        self._stop()

    def _tell(self, message: Message) -> None:
        event = describe(message)
        if isinstance(message, RunStarted):
            title = Text(one_line(cut(message.name)), style="bold")
            title.append(one_line(f"  {message.motor.name} on the drive {message.drive}"), style="default not bold")
            self._console.print(title)
        elif isinstance(message, OperatorAnswered):
            prompt, self._prompt = self._prompt or "operator:", ""
            if message.by == "procedure":
                self._print_line("info", f"{prompt} {message.answer}, says the procedure")
        elif isinstance(message, DiagnosisStep):
            self._console.print(_rung(message))
        elif isinstance(message, Diagnosed):
            self._console.print(_diagnosis(message))
        elif event is not None and not isinstance(message, IN_THE_DISPLAY):
            self._print_line(event.mood, event.line)

    def _drive_display(self, message: Message) -> None:
        if isinstance(message, OperatorAsked):
            self._prompt = message.prompt
            self._stop()
        elif isinstance(message, RunEnded):
            self._is_over = True
            self._stop()
            self._console.print(_ending(message, self._display.progress.run))
        elif isinstance(message, StateChanged) and message.target == "paused":
            self._stop()
            self._console.print("paused; the drive is disarmed")
        elif self._live is None and not self._prompt and not self._is_over:
            self._start()
        elif self._live is not None and isinstance(message, StageStarted | StateChanged):
            with self._lock:
                self._live.refresh()

    def _print_line(self, mark: str, text: str) -> None:
        sign, style = MARKS[mark]
        self._console.print(Text.assemble((sign, style), one_line(cut(text))))

    def _start(self) -> None:
        self._live = Live(
            self._display,
            console=self._console,
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._live.start(refresh=True)
        self._ticker = _Ticker(self._live, self._lock)

    def _stop(self) -> None:
        ticker, live = self._ticker, self._live
        self._ticker = self._live = None
        if ticker is not None:
            ticker.stop()
        if live is not None:
            with self._lock:
                live.stop()


class _Ticker:
    """Redraws a live display until it is stopped, or the terminal is gone; owned by its view."""

    def __init__(self, live: Live, lock: threading.Lock, every_s: float = 0.125) -> None:
        self._live, self._lock, self._every_s = live, lock, every_s
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._tick, name="console display", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stopped.set()
        self._thread.join()

    def _tick(self) -> None:
        while not self._stopped.wait(self._every_s):
            try:
                with self._lock:
                    self._live.refresh()
            except (OSError, ValueError):  # the next message meets the same error, and raises it
                return


class _Display:
    """The lines that stay below: state and stage, bar, time left, currents, R_s."""

    def __init__(self) -> None:
        self.progress = Progress()
        self._spinner = Spinner("dots", style="cyan")

    def __rich__(self) -> RenderableType:
        progress = self.progress
        return Group("", self._heading(progress), _bar(progress), *_readings(progress))

    def _heading(self, progress: Progress) -> RenderableType:
        text = Text(plain(progress.state), style="bold")
        if progress.stage is not None:
            text.append(one_line(cut(f"  {stage_title(progress, progress.stage)}")), style="default not bold")
            if progress.stage.points:
                at = min(progress.stage.done + 1, progress.stage.points)
                text.append(f", point {at} of {progress.stage.points}", style="default not bold")
        self._spinner.update(text=text)
        return self._spinner


def _bar(progress: Progress) -> RenderableType:
    line = Table.grid(padding=(0, 1))
    line.add_column(width=36)
    line.add_column(justify="right")
    line.add_column(style="dim")
    bar = ProgressBar(total=max(progress.points, 1), completed=progress.points_done, width=36, complete_style="cyan")
    line.add_row(bar, f"{progress.fraction:.0%}", f"{progress.points_done}/{progress.points} points")
    return line


def _readings(progress: Progress) -> list[RenderableType]:
    rows = [("time", time_left(progress))]
    if progress.work:
        rows.append(("now", one_line(cut(progress.work))))
    if progress.target is not None:
        rows.append(("target", vector(*progress.target)))
    if progress.achieved is not None:
        rows.append(("achieved", vector(*progress.achieved)))
    if progress.resistance is not None:
        rows.append(("R_s", resistance(progress.resistance)))
    table = _two_columns()
    for label, text in rows:
        table.add_row(label, Text(text))
    return [table]


def _rung(step: DiagnosisStep, cells: int = 24) -> RenderableType:
    """A rung of the ladder: its name, a bar that shrinks with the error, and the figures."""
    name, figures = step_line(step)
    bar = step_bar(step, cells)
    colour = "red" if len(bar) > cells // 3 else "yellow" if len(bar) > 2 else "green"
    line = Text.assemble(("  " + one_line(name), "bold" if step.added else ""), " ")
    line.append(bar.ljust(cells), style=colour)
    line.append("  " + figures, style="default")
    line.no_wrap, line.overflow = True, "ellipsis"
    return line


def _diagnosis(message: Diagnosed) -> RenderableType:
    event = describe(message)
    assert event is not None
    sign, style = MARKS[event.mood]
    table = _two_columns()
    table.add_row(Text(sign + event.subject, style=style), Text(one_line(cut(event.text)), style=style))
    for title, text in diagnosis_rows(message):
        table.add_row("  " + title, Text(one_line(cut(text))))
    return table


def _two_columns() -> Table:
    """Labels, and texts that are folded rather than cut."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", min_width=8)
    table.add_column(overflow="fold")
    return table


def _ending(message: RunEnded, run: Path) -> RenderableType:
    _, style = MARKS[OUTCOME_MOODS[message.outcome]]
    table = _two_columns()
    for label, text in summary_rows(message, run):
        table.add_row(label, Text(one_line(cut(text)), style=style if label == "outcome" else ""))
    return Group("", table)
