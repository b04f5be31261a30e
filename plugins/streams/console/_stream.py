"""The console stream: chooses a view and hands it what the run says. Prints nothing itself."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from typing import ClassVar, Literal, Protocol, TextIO

from pydantic import BaseModel

from orchestrator.formatting.sentences import can_print
from plugins.streams.console._plain import PlainView, QuietView
from plugins.streams.console._progress import Progress
from protocols import Message, StreamSetup, Strict


class ConsoleOptions(Strict):
    """Options of the console stream."""

    mode: Literal["auto", "live", "plain", "quiet", "jsonl"] = "auto"
    """auto: live on a terminal, else plain. quiet: warnings, errors, a bad end. jsonl: one JSON object a message."""
    output: Literal["stdout", "stderr"] = "stdout"


class View(Protocol):
    """A way of showing a run."""

    def show(self, message: Message, progress: Progress) -> None:
        """Show what changed; `progress` has taken the message in already."""
        ...

    def close(self) -> None:
        """Leave the terminal as it was found."""
        ...


class ConsoleStream:
    """Shows a run on standard output.

    Once an output cannot be written to any longer (its terminal is gone), that one error is
    raised, and the rest of the run passes in silence.
    """

    name: ClassVar[str] = "console"
    Options: ClassVar[type[BaseModel]] = ConsoleOptions
    wants_samples: ClassVar[bool] = False

    def __init__(self, setup: StreamSetup) -> None:
        options = setup.options if isinstance(setup.options, ConsoleOptions) else ConsoleOptions()
        output: TextIO = sys.stderr if options.output == "stderr" else sys.stdout
        self._progress = Progress(setup.run)
        self._view: View | None = _view(options.mode, output)

    def receive(self, message: Message) -> None:
        """Take one message; raises `OSError` or `ValueError` once where the output is gone."""
        self._progress.take(message)
        if self._view is not None:
            view = self._view
            self._guarded(lambda: view.show(message, self._progress))

    def close(self) -> None:
        """Leave the terminal as it was found."""
        if self._view is not None:
            self._guarded(self._view.close)
            self._view = None

    def _guarded(self, call: Callable[[], None]) -> None:
        try:
            call()
        except (OSError, ValueError):
            view, self._view = self._view, None
            if view is not None:
                with suppress(OSError, ValueError):
                    view.close()
            raise


def _view(mode: str, output: TextIO) -> View:
    if mode == "jsonl":
        from plugins.streams.console._lines import JsonView

        return JsonView(output)
    if mode == "quiet":
        return QuietView(output)
    if mode == "live" or (mode == "auto" and output.isatty() and can_print(output)):
        from plugins.streams.console._live import LiveView

        return LiveView(output)
    return PlainView(output)
