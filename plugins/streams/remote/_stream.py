"""The stream `remote`: the picture of a run on standard output, whenever it has changed. Draws nothing itself."""

from __future__ import annotations

import json
import sys
import time
from typing import ClassVar

from pydantic import BaseModel

from plugins.streams.remote._picture import Picture
from protocols import Message, PointDone, PointStarted, Positive, SamplesCaptured, StreamSetup, Strict

PASSING = (PointStarted, PointDone, SamplesCaptured)
"""Messages with another one like them soon: not each is worth a line."""


class RemoteOptions(Strict):
    """Options of the remote stream."""

    every_s: Positive = 0.25
    """Least time between two lines while points and samples go by."""


class RemoteStream:
    """Writes where a run stands, a line of JSON each time; whoever reads needs the latest line only.

    Once nobody reads any longer, that one error is raised, and the rest of the run passes in silence.
    """

    name: ClassVar[str] = "remote"
    Options: ClassVar[type[BaseModel]] = RemoteOptions
    wants_samples: ClassVar[bool] = True

    def __init__(self, setup: StreamSetup) -> None:
        options = setup.options if isinstance(setup.options, RemoteOptions) else RemoteOptions()
        self._every_s, self._sent_s = options.every_s, float("-inf")
        self._picture = Picture(setup.run)
        self._is_read = True

    def receive(self, message: Message) -> None:
        """Take one message; raises `OSError` or `ValueError` once where the output is gone."""
        self._picture.take(message)
        now = time.monotonic()
        if self._is_read and (now - self._sent_s >= self._every_s or not isinstance(message, PASSING)):
            self._sent_s = now
            self._send()

    def close(self) -> None:
        """Say the last of it."""
        if self._is_read:
            self._send()

    def _send(self) -> None:
        line = json.dumps(self._picture.drawn(), ensure_ascii=True, allow_nan=False)
        try:
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
        except (OSError, ValueError):
            self._is_read = False
            raise
