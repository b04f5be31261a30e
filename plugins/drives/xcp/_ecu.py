"""Layout of the variable `fluxbench` in the ECU, as firmware/fluxbench_xcp.h declares it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from protocols import DriveFault, FaultCause

Rows = NDArray[np.void]

MAGIC, VERSION = 0x46425831, 1
FAULTS = {
    1: (FaultCause.OVERCURRENT, "the current passed its limit"),
    2: (FaultCause.HEARTBEAT_LOST, "the ECU's routine received no heartbeat"),
    3: (FaultCause.BUS_VOLTAGE, "the bus has no voltage"),
    4: (FaultCause.INTERNAL, "the ECU's own protection switched off"),
}


class State(IntEnum):
    """State of the power stage."""

    OFF = 0
    ON = 1
    FAULTED = 2


class Phase(IntEnum):
    """Phase of a program."""

    SETTLING = 0
    CAPTURING = 1
    HOLDING = 2


class Order(IntEnum):
    """Commands of the routine."""

    SWITCH_ON = 1
    SWITCH_OFF = 2
    RUN = 3
    CLEAR = 4


class Mode(IntEnum):
    """Operating mode of a program."""

    GATES_OFF = 0
    CONTROL = 1
    INJECTION = 2


@dataclass(frozen=True)
class Status:
    """The status word of a row."""

    state: int
    phase: int
    refused: bool
    fault: int
    number: int
    """Number of the last order."""

    @classmethod
    def of(cls, word: int) -> Status:
        return cls(word & 3, word >> 2 & 3, bool(word >> 4 & 1), word >> 8 & 255, word >> 16)


class Layout:
    """Types and offsets for an ECU's byte order; every word has 32 bits.

    Parameters
    ----------
    order : str
        "<" or ">".
    """

    def __init__(self, order: str) -> None:
        u4, f4 = f"{order}u4", f"{order}f4"
        self.row = np.dtype([("tick", u4), ("status", u4), ("i", f4, 2), ("v", f4, 2), ("v_dc", f4)])
        self.program = np.dtype(
            [
                *((name, f4) for name in ("limit_current_a", "limit_voltage_v")),
                *((name, u4) for name in ("mode", "ramp_ticks", "freeze_ticks", "settle_ticks", "capture_ticks")),
                *((name, f4, 2) for name in ("direction", "start", "swept")),
                ("feed_forward", f4),
                *((name, f4, 2) for name in ("proportional", "integral")),
                ("amplitude_v", f4),
                *((name, u4) for name in ("wave_step", "turn_step", "sine")),
            ]
        )
        facts = ("sampling_hz", "pwm_hz", "max_current_a", "max_voltage_v", "dc_bus_v", "delay_samples")
        self.facts = np.dtype([("magic", u4), ("version", u4), *((name, f4) for name in facts), ("watchdog_ticks", u4)])
        self.word = np.dtype(u4)
        self.row_at = self.facts.itemsize
        self.beat_at = self.row_at + self.row.itemsize
        self.order_at = self.beat_at + self.word.itemsize
        self.program_at = self.order_at + self.word.itemsize


class Stream:
    """Checks and selects the incoming rows of one program.

    Parameters
    ----------
    number : int
        Number of the order that started the program.
    """

    def __init__(self, number: int) -> None:
        self._number = number
        self._last: np.uint32 | None = None

    def captured(self, rows: Rows) -> Rows:
        """The captured ones of the next rows.

        Raises `DriveFault` where the ECU has tripped, a row is missing, or another order runs.
        """
        if not len(rows):
            return rows
        status = rows["status"]
        newest = Status.of(int(status[-1]))
        if newest.state == State.FAULTED:
            raise fault_of(newest)
        self._require_whole(rows["tick"])
        if newest.state != State.ON or newest.number != self._number:
            raise DriveFault(FaultCause.INTERNAL, "the ECU has ended the program: another host controls it")
        captured: Rows = rows[(status >> 16 == self._number) & (status >> 2 & 3 == Phase.CAPTURING)]
        return captured

    def _require_whole(self, ticks: NDArray[np.uint32]) -> None:
        ticks = ticks.astype(np.uint32)
        known = ticks if self._last is None else np.concatenate([[self._last], ticks])
        gaps = np.flatnonzero(np.diff(known) != 1)
        if len(gaps):
            before, after = int(known[gaps[0]]), int(known[gaps[0] + 1])
            raise DriveFault(FaultCause.WRONG_DATA, f"rows are missing between the ticks {before} and {after}")
        self._last = ticks[-1]


def fault_of(status: Status) -> DriveFault:
    """The ECU's latched fault."""
    cause, detail = FAULTS.get(status.fault, (FaultCause.INTERNAL, f"the ECU has fault {status.fault}"))
    return DriveFault(cause, detail)
