"""Streams: consumers of a run's validated messages.

Each stream has its own thread and a bounded queue that drops the oldest, so that a slow or
broken one costs the run nothing; what was dropped is counted. Entry point group
``fluxbench.streams``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

from pydantic import BaseModel, ConfigDict

from protocols._events import Message


class StreamSetup(BaseModel):
    """All that a stream gets from outside."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    run: Path
    """The run directory; a stream may write files of its own there."""
    options: Any
    """An instance of the plugin's own `Options`."""


@runtime_checkable
class Stream(Protocol):
    """A listener; all methods are called from the stream's own thread, in order.

    A stream that has something to say at its end may have an attribute `notes`, a sequence of lines that is read after
    `close`.
    """

    name: ClassVar[str]
    Options: ClassVar[type[BaseModel]]
    wants_samples: ClassVar[bool]
    """Whether `SamplesCaptured` is delivered as well."""

    def __init__(self, setup: StreamSetup) -> None: ...

    def receive(self, message: Message) -> None:
        """Take one message. The dispatcher counts what this raises, reports it at the end, and never passes it on."""
        ...

    def close(self) -> None:
        """The run is over; called once, also after an error."""
        ...
