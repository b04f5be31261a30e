"""A moteus's timeouts and tolerances. Decides nothing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Bounds:
    """Times in seconds; a board answers a frame within a few milliseconds."""

    call_timeout_s: float = 3.0
    """For a conversation of several frames."""
    loop_timeout_s: float = 1.0
    """Time beyond a call's own after which the event loop counts as dead."""
    max_stall_s: float = 2.0
    """Time without a turn of the event loop after which the link counts as lost: a call of the library blocks it."""
    answer_timeout_s: float = 0.5
    """Time after which a board that answers no frame counts as absent."""
    stream_timeout_s: float = 1.5
    """The same for a conversation on the diagnostic stream."""
    enable_timeout_s: float = 1.0
    """Time in which the power stage has to switch on."""
    max_ramp_s: float = 1.0
    """Time in which the current has to fall to zero."""
    current_decay_s: float = 0.05
    """Time for the rest of the current to decay: the board's current control has some 100 Hz."""
    zero_current_ratio: float = 0.05
    """Current over its limit, below which it counts as zero."""
    keepalive_period_s: float = 0.25
    """Longest time without a block."""
    poll_period_s: float = 0.05
    """Period of checking link and current."""
    zero_current_s: float = 0.05
    """Time for the current to be gone before the angle changes."""
    max_angle_error_rad: float = 0.02
    """Largest difference of the board's angle from the expected one: beyond it positions mean something else."""
    max_capture_attempts: int = 10
    """Attempts at a capture; a late reading ends one."""
    trip_ratio: float = 1.25
    """Measured current over its limit, above which the drive trips: the board's own limit has a ripple about it."""
    max_modulation_ratio: float = 0.5
    """Longest voltage vector over the bus voltage: what sinusoidal modulation reaches for certain."""
    register_map_version: int = 5
    """The supported version of the registers."""
    unlimited: float = -1.0
    """The library's value for no limit of velocity or acceleration."""


BOUNDS = Bounds()
