"""The project's own errors: one clear line each, and the exit code that goes with it.

Everything the project raises on purpose is a `FluxbenchError`. The command line prints its one
line and leaves with its `exit_code`; anything else that reaches the top is a defect.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import ClassVar


class FluxbenchError(Exception):
    """Base of every error raised on purpose; `str(error)` is one line for a person."""

    exit_code: ClassVar[int] = 2


class InputError(FluxbenchError):
    """Something that was handed in is wrong.

    Parameters
    ----------
    where : str
        The file, segment or plugin that holds the wrong thing.
    field : str
        The field, column or key in it.
    problem : str
        Actual and expected value.
    choices : sequence of str
        Suggestions; a terminal lists them below the line.
    """

    def __init__(self, where: str, field: str, problem: str, choices: Sequence[str] = ()) -> None:
        self.where, self.field, self.problem, self.choices = where, field, problem, tuple(choices)
        super().__init__(": ".join(part for part in (where, field, problem) if part))


class ProcedureError(InputError):
    """A procedure (or an override of it) that cannot be used."""


class RecordingError(InputError):
    """A recording or run directory that cannot be read."""


class PluginError(InputError):
    """A plugin that is missing, broken, or does not keep its contract."""


class CapabilityError(InputError):
    """A plan that asks for more than the drive, or the limits, allow."""


class NotMeasuredError(InputError):
    """A recording without the stage that an estimator needs, or with too little of it."""


class DriveError(FluxbenchError):
    """Something went wrong on the drive's side while a run was under way."""

    exit_code: ClassVar[int] = 3


class FaultCause(StrEnum):
    """Cause of a drive's transition to its safe state."""

    OVERCURRENT = "overcurrent"
    OVERTEMPERATURE = "overtemperature"
    BUS_VOLTAGE = "bus_voltage"
    HEARTBEAT_LOST = "heartbeat_lost"
    LINK_LOST = "link_lost"
    NO_ANSWER = "no_answer"
    WRONG_DATA = "wrong_data"
    PROGRAM_TOO_LONG = "program_too_long"
    EMERGENCY_STOP = "emergency_stop"
    STILL_ARMED = "still_armed"
    """Its power stage is on after the command to switch it off."""
    INTERNAL = "internal"


class DriveFault(DriveError):
    """The drive tripped, or was lost; it stays latched until cleared and armed afresh."""

    def __init__(self, cause: FaultCause, detail: str) -> None:
        self.cause, self.detail = cause, detail
        super().__init__(f"drive fault {cause.value}: {detail}")


class DriveRefused(DriveError):
    """The drive declined a request (not armed, past its limits, not in its modes)."""


class StorageError(FluxbenchError):
    """Measurements cannot be written any more (full disk, directory gone)."""

    exit_code: ClassVar[int] = 3


class RunAborted(FluxbenchError):
    """The run was ended on purpose before its last stage: refused by the operator or a check."""

    exit_code: ClassVar[int] = 3


class RunInterrupted(FluxbenchError):
    """A signal stopped the run; the drive was ramped down and disarmed."""

    exit_code: ClassVar[int] = 130
