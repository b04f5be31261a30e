"""The report as a stream: waits for the end of the run, then writes the page out of files."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel

from orchestrator.recording import has_model
from plugins.streams.report._collect import is_worth_a_report
from plugins.streams.report._page import write_report
from protocols import Message, NoOptions, RunEnded, StreamSetup


class ReportStream:
    """Writes ``report.html`` into the run directory when the run is over, however it ended."""

    name: ClassVar[str] = "report"
    Options: ClassVar[type[BaseModel]] = NoOptions
    wants_samples: ClassVar[bool] = False

    def __init__(self, setup: StreamSetup) -> None:
        self._run = setup.run
        self._is_stopped = False

    def receive(self, message: Message) -> None:
        """Note whether the run was stopped; all else the page is made of is in files."""
        if isinstance(message, RunEnded):
            self._is_stopped = message.outcome == "aborted"

    def close(self) -> None:
        """Write the page, where there is anything to report; that of a run that was stopped without its pictures."""
        if is_worth_a_report(self._run):
            # Only `add` and `remove` leave a model without its diagnosis: where that one fails is what to look at next.
            write_report(self._run, draws=not self._is_stopped, compares=has_model(self._run))
