"""The messages of the drive protocol as Python types; the DBC defines the layout of their bits.

Field names are the DBC's signal names. A field that is an enumeration here is a value table there.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import NamedTuple, get_args

PROTOCOL_MAJOR = 1
PROTOCOL_MINOR = 1

HEARTBEAT_PERIOD_S = 0.05
"""Period of the heartbeat [s]."""
TELEMETRY_PERIOD_S = 0.05
"""Period of Status and Measurement unless the register telemetry_period_s says otherwise [s]."""
NO_TEMPERATURE_C = -128
"""Temperature in a Status of a drive that does not measure it."""
MIN_BYTES = {"Measurement": 7}
"""Length of a message in version 1.0, where a later version added bytes; missing ones are zero."""
STALE_PERIODS = 3
"""Age in periods from which on telemetry is stale, which stops the run."""


class Op(IntEnum):
    """Operation of a `Command`; from 16 on, other requests that an `Ack` answers."""

    IDENTIFY = 1
    ARM = 2
    DISARM = 3
    CLEAR_FAULT = 4
    RUN_PROGRAM = 5
    STOP = 6
    CAPTURE_ARM = 7
    CAPTURE_TRIGGER = 8
    TIME_SYNC = 9
    PARAMETER_WRITE = 16
    PARAMETER_READ = 17
    READ_BLOCK = 18
    SETPOINT = 19


class AckStatus(IntEnum):
    """Result of a request: done, or the reason of its refusal."""

    OK = 0
    WRONG_STATE = 1
    PAST_LIMIT = 2
    NOT_A_NUMBER = 3
    OUT_OF_RANGE = 4
    READ_ONLY = 5
    UNKNOWN = 6
    NOT_SUPPORTED = 7
    STALE_SESSION = 8
    BUSY = 9
    FAULT_LATCHED = 10
    WRONG_VERSION = 11
    NOT_CAPTURED = 12
    OVERWRITTEN = 13
    NO_MEMORY = 14
    TOO_LONG = 15
    INTERLOCK_OPEN = 16


class PowerState(IntEnum):
    """State of the power stage; all but the first and the last are energised."""

    DISARMED = 0
    HOLDING = 1
    RUNNING = 2
    STOPPING = 3
    FAULTED = 4


class Fault(IntEnum):
    """Why a drive tripped; also the number of the bit in `Status.faults`."""

    NONE = 0
    OVERCURRENT = 1
    OVERLOAD = 2
    WATCHDOG = 3
    BUS_VOLTAGE = 4
    OVERTEMPERATURE = 5
    PROGRAM_TOO_LONG = 6
    SENSOR = 7
    LIMIT = 8
    EMERGENCY_STOP = 9
    ENCODER = 10
    GATE_DRIVER = 11
    INTERNAL = 12
    INTERLOCK = 13


class Phase(IntEnum):
    """Phase of a program."""

    IDLE = 0
    RAMPING = 1
    SETTLING = 2
    CAPTURING = 3
    COMPLETE = 4
    GIVEN_UP = 5


class SetpointKind(IntEnum):
    """Quantity of `x` and `y` of a set-point."""

    CURRENT = 0
    VOLTAGE = 1


class StopReason(IntEnum):
    """Reason of an emergency stop, for logs; the drive ignores it."""

    UNSPECIFIED = 0
    OPERATOR = 1
    HOST_ERROR = 2


class Capability(IntFlag):
    """Optional capabilities of a drive (register capability_bits)."""

    RIPPLE_ON_DRIVE = 1
    RAW_CAPTURE = 2
    CAPTURE_RING = 4
    F32_CAPTURE = 8
    SETPOINTS = 16
    BRAKE = 32
    TEMPERATURE = 64
    INTERLOCKS = 128
    RIPPLE_CURVATURE = 256


class EStop(NamedTuple):
    """Emergency stop."""

    reason: StopReason = StopReason.UNSPECIFIED


class Heartbeat(NamedTuple):
    """The host is alive."""

    session: int
    seq: int
    host_ms: int


class Command(NamedTuple):
    """One operation, stop-and-wait."""

    session: int
    seq: int
    op: Op
    arg: int = 0


class ParameterWrite(NamedTuple):
    """Write a register."""

    session: int
    seq: int
    parameter: int
    value: float


class ParameterRead(NamedTuple):
    """Read a register."""

    session: int
    seq: int
    parameter: int


class Setpoint(NamedTuple):
    """Move the held operating point; `theta` in rad, `x` and `y` in counts."""

    seq: int
    kind: SetpointKind
    session_low: int
    theta: float
    x: int
    y: int


class ReadBlock(NamedTuple):
    """Request blocks of a capture."""

    offset: int
    window: int
    blocks: int
    capture: int


class Status(NamedTuple):
    """State of the power stage; `v_dc` in V, `temperature` in °C (-128: not measured)."""

    state: PowerState
    cause: Fault
    last_heartbeat: int
    faults: int
    v_dc: float
    temperature: int
    seq: int


class Ack(NamedTuple):
    """Answer to a command, and the refusal of anything else."""

    session: int
    seq: int
    op: Op
    status: AckStatus
    state: PowerState
    value: int = 0


class ParameterValue(NamedTuple):
    """Value of a register."""

    session: int
    seq: int
    parameter: int
    value: float


class Tick(NamedTuple):
    """The drive's clock."""

    tick: int
    t_us: int


class Measurement(NamedTuple):
    """Low-pass filtered readings: currents in counts, `v_dc` in V; `open_interlocks` has a bit for each input."""

    seq: int
    i_d: int
    i_q: int
    v_dc: float
    open_interlocks: int = 0


class Progress(NamedTuple):
    """Progress of the program."""

    seq: int
    phase: Phase
    capture: int
    rows: int


class RippleD(NamedTuple):
    """One ripple row of the d axis, in counts."""

    n: int
    mean: int
    ripple: int
    v: int


class RippleQ(NamedTuple):
    """One ripple row of the q axis, in counts."""

    n: int
    mean: int
    ripple: int
    v: int


class BulkEnd(NamedTuple):
    """End of the answer to a `ReadBlock`."""

    crc: int
    length: int
    window: int


Message = (
    EStop
    | Heartbeat
    | Command
    | ParameterWrite
    | ParameterRead
    | Setpoint
    | ReadBlock
    | Status
    | Ack
    | ParameterValue
    | Tick
    | Measurement
    | Progress
    | RippleD
    | RippleQ
    | BulkEnd
)
"""All messages except the two with bulk data, which are processed in batches."""

MESSAGES: tuple[type[Message], ...] = get_args(Message)
