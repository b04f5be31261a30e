"""The report as a stream: waits for the end of the run, then writes the page. Looks at no message."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel

from plugins.streams.report._collect import is_worth_a_report
from plugins.streams.report._page import write_report
from protocols import Message, NoOptions, StreamSetup


class ReportStream:
    """Writes ``report.html`` into the run directory when the run is over, however it ended."""

    name: ClassVar[str] = "report"
    Options: ClassVar[type[BaseModel]] = NoOptions
    wants_samples: ClassVar[bool] = False

    def __init__(self, setup: StreamSetup) -> None:
        self._run = setup.run

    def receive(self, message: Message) -> None:
        """Nothing to do: the page is made from files, which say the same."""

    def close(self) -> None:
        """Write the page, where there is anything to report."""
        if is_worth_a_report(self._run):
            write_report(self._run)
