"""Checks of a drive's statements for contradictions."""

from __future__ import annotations

import math

from orchestrator.driving.readings import MAX_CURRENT_RATIO
from plugins.link._host import fault_names
from plugins.link._link import LatestMessages
from plugins.wire import BlockLayout, DriveFacts, Phase, PowerState, Progress
from protocols import DriveFault, FaultCause

ENERGISED = (PowerState.HOLDING, PowerState.RUNNING, PowerState.STOPPING)


def require_consistent_telemetry(news: LatestMessages, scale_a: float, limit_a: float | None) -> None:
    """Check the latest telemetry for consistency and against the current limit of the run.

    Raises `DriveFault`: wrong_data for a power stage that is on despite latched faults and for a fault that was
    reported and withdrawn, overcurrent where the drive continues above the limit.
    """
    status, measurement, faulted = news.status, news.measurement, news.faulted
    for seen in (faulted, status):
        if seen is not None and seen.state in ENERGISED and seen.faults:
            detail = f"the drive reports {seen.state.name.lower()} despite faults: {', '.join(fault_names(seen))}"
            raise DriveFault(FaultCause.WRONG_DATA, detail)
    if status is not None and faulted is not None and not status.faults:
        detail = f"the drive reported a fault and withdrew it: {', '.join(fault_names(faulted))}"
        raise DriveFault(FaultCause.WRONG_DATA, detail)
    if measurement is None or limit_a is None:
        return
    current_a = scale_a * math.hypot(measurement.i_d, measurement.i_q)
    if current_a > MAX_CURRENT_RATIO * limit_a:
        detail = f"the drive measures {current_a:.3g} A, the limit is {limit_a:.3g} A, and it did not trip"
        raise DriveFault(FaultCause.OVERCURRENT, detail)


def require_memory(facts: DriveFacts, layout: BlockLayout, row_bytes: int) -> None:
    """Raise `DriveFault` (wrong_data) where the capture memory is smaller than a row or a block."""
    min_bytes = max(row_bytes, layout.block)
    if facts.memory_bytes < min_bytes:
        detail = f"register capture_memory_bytes: {facts.memory_bytes} bytes are less than a row or a block"
        raise DriveFault(FaultCause.WRONG_DATA, detail)


class ProgramProgress:
    """Checks that a program's reported progress only increases and ends at its rows.

    Parameters
    ----------
    rows : int
        Rows of its capture.
    """

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self.phase, self.done = Phase.IDLE, 0

    def update(self, progress: Progress) -> bool:
        """Whether there is progress; raises `DriveFault` (wrong_data) where it is impossible."""
        before = (self.phase, self.done)
        if progress.rows > self._rows:
            detail = f"the drive has captured {progress.rows} rows of {self._rows}"
            raise DriveFault(FaultCause.WRONG_DATA, detail)
        if progress.phase < self.phase or progress.rows < self.done:
            detail = f"the program goes back from {_progress(*before)} to {_progress(progress.phase, progress.rows)}"
            raise DriveFault(FaultCause.WRONG_DATA, detail)
        self.phase, self.done = progress.phase, progress.rows
        return (self.phase, self.done) != before


def _progress(phase: Phase, rows: int) -> str:
    return f"{phase.name.lower()} at row {rows}"
