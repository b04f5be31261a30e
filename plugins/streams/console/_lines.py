"""The run as JSON, one message a line, for programs that read along. For people there are other views."""

from __future__ import annotations

from typing import TextIO

from plugins.streams.console._progress import Progress
from protocols import Message


class JsonView:
    """Each message as one JSON object; arrays are described by dtype and shape."""

    def __init__(self, output: TextIO) -> None:
        self._output = output

    def show(self, message: Message, progress: Progress) -> None:
        self._output.write(message.model_dump_json() + "\n")
        self._output.flush()

    def close(self) -> None:
        """There is nothing to put back."""
