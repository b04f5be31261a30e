"""What a drive says of itself that cannot be, each with its name. Knows messages; sends nothing."""

from __future__ import annotations

import math

from plugins.link._host import fault_names
from plugins.wire import BlockLayout, DriveFacts, Measurement, Phase, PowerState, Progress, Status
from protocols import DriveFault, FaultCause

ENERGISED = (PowerState.HOLDING, PowerState.RUNNING, PowerState.STOPPING)
MAX_CURRENT_RATIO = 1.5
"""Current of a reading over the limit, at which the drive should have tripped long before."""


def require_sound(
    status: Status | None, measurement: Measurement | None, scale_a: float, limit_a: float | None
) -> None:
    """Hold the latest telemetry against itself and the limit that the drive was armed with.

    Raises `DriveFault`: wrong_data for a power stage that is on beside latched faults, overcurrent for a current with
    which the drive goes on.
    """
    if status is not None and status.state in ENERGISED and status.faults:
        detail = f"the drive says that it is {status.state.name.lower()}, with faults: {', '.join(fault_names(status))}"
        raise DriveFault(FaultCause.WRONG_DATA, detail)
    if measurement is None or limit_a is None:
        return
    current_a = scale_a * math.hypot(measurement.i_d, measurement.i_q)
    if current_a > MAX_CURRENT_RATIO * limit_a:
        detail = f"the drive reads {current_a:.3g} A, the limit is {limit_a:.3g} A, and it went on"
        raise DriveFault(FaultCause.OVERCURRENT, detail)


def require_memory(facts: DriveFacts, layout: BlockLayout, row_bytes: int) -> None:
    """Raise `DriveFault` (wrong_data) where the memory for captures does not hold a row and a block."""
    least = max(row_bytes, layout.block)
    if facts.memory_bytes < least:
        detail = f"register capture_memory_bytes: {facts.memory_bytes} bytes hold no row of a capture, nor a block"
        raise DriveFault(FaultCause.WRONG_DATA, detail)


class ProgramProgress:
    """How far one program says that it is: it goes on, never back, and not beyond its rows.

    Parameters
    ----------
    rows : int
        Of its capture.
    """

    def __init__(self, rows: int) -> None:
        self._rows = rows
        self.phase, self.done = Phase.IDLE, 0

    def takes(self, progress: Progress) -> bool:
        """Whether it got on; raises `DriveFault` (wrong_data) where it cannot have."""
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
