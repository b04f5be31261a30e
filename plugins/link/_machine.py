"""Data of the connected drive, and the interface of a program's row reader."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from plugins.wire import VECTORS, BlockLayout, Capability, CaptureFormat, Channel, DriveFacts, RowFormat
from protocols import Capabilities, Capture


@dataclass(frozen=True)
class Machine:
    """Data of the drive, read on connecting."""

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
    """Reader of a program's rows."""

    def poll(self, done_rows: int, complete: bool, wait_s: float) -> bool:
        """Continue reading; returns True when all rows are received and verified."""
        ...

    @property
    def ready(self) -> int:
        """Number of rows from the start without a gap that no later data change."""
        ...

    def block(self, first: int, stop: int, start_s: float) -> Capture:
        """Rows `first` to `stop` of those that are ready; `start_s` is the time of the first one."""
        ...


class SecondsOfTick(Protocol):
    """Converts a tick of the drive to seconds since the start of the experiment."""

    def __call__(self, tick: int, /) -> float: ...


def row_format(machine: Machine) -> RowFormat:
    """Layout of a raw row of this drive."""
    return RowFormat(machine.channels, CaptureFormat.INT16, machine.facts.scales)


def longest_capture(machine: Machine, bulk_rate: float | None) -> float | None:
    """Longest raw capture within memory and line rate [s]; None where nothing limits it.

    A ring buffer is read while it fills, so that it only needs to hold the backlog of the line.
    """
    row_rate = machine.capabilities.sampling_frequency_hz * row_format(machine).row_bytes
    if machine.facts.bits & Capability.CAPTURE_RING:
        if bulk_rate is None or bulk_rate > row_rate:
            return None
        row_rate -= bulk_rate
    return machine.facts.memory_bytes / row_rate
