"""What a program's run needs to know of the drive, and what it asks of the rows on their way here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from plugins.wire import VECTORS, BlockLayout, Capability, CaptureFormat, Channel, DriveFacts, RowFormat
from protocols import Capabilities, Capture


@dataclass(frozen=True)
class Machine:
    """What is known of the drive since it was connected."""

    capabilities: Capabilities
    facts: DriveFacts
    layout: BlockLayout
    demodulated: bool
    """Whether injections are captured as ripple rows."""

    @property
    def channels(self) -> Channel:
        """The channels of a raw row."""
        return VECTORS | (Channel.V_DC & self.facts.channels)


class Rows(Protocol):
    """A program's rows on their way here."""

    def turn(self, done_rows: int, complete: bool, wait_s: float) -> bool:
        """Get on with it; True when all rows are here and verified."""
        ...

    @property
    def ready(self) -> int:
        """Rows from the start without a gap, which nothing that is to come changes."""
        ...

    def block(self, first: int, stop: int, start_s: float) -> Capture:
        """The next of the rows that are ready; `start_s` is the time of the first one."""
        ...


class SecondsOfTick(Protocol):
    """Turns a tick of the drive into seconds since the start of the experiment."""

    def __call__(self, tick: int, /) -> float: ...


def row_format(machine: Machine) -> RowFormat:
    """How a raw row of this drive is laid out."""
    return RowFormat(machine.channels, CaptureFormat.INT16, machine.facts.scales)


def longest_capture(machine: Machine, bulk_rate: float | None) -> float | None:
    """Longest raw capture that memory and line allow together [s]; None where nothing limits it.

    A ring is read while it fills, so that only what the line is behind has to fit.
    """
    row_rate = machine.capabilities.sampling_frequency_hz * row_format(machine).row_bytes
    if machine.facts.bits & Capability.CAPTURE_RING:
        if bulk_rate is None or bulk_rate > row_rate:
            return None
        row_rate -= bulk_rate
    return machine.facts.memory_bytes / row_rate
