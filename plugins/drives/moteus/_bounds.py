"""What a moteus is given time for, and how far its readings may be off. Decides nothing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Bounds:
    """Times in seconds; a board answers a frame within a few milliseconds."""

    call_s: float = 3.0
    """A conversation of several frames."""
    round_trip_s: float = 1.0
    """What the loop may take beyond a call's own time before it counts as dead."""
    answer_s: float = 0.5
    """A board that has not answered a frame after so long is not there."""
    talk_s: float = 1.5
    """The same for a conversation on the diagnostic stream."""
    enable_s: float = 1.0
    """A power stage that is not on after so long does not come on."""
    ramp_s: float = 1.0
    """A current that is not zero after so long is not ramping down."""
    die_out_s: float = 0.05
    """What is left of the current then is gone after this: the board's current control has some 100 Hz."""
    zero: float = 0.05
    """Nearly zero, as a part of the current limit."""
    quiet_s: float = 0.25
    """A sign of life is given so often while nothing is there to hand out."""
    look_s: float = 0.05
    """How often it is looked whether the link or the current is still what it should be."""
    no_current_s: float = 0.05
    """Time for the current to be gone before the angle changes."""
    angle_rad: float = 0.02
    """A board that works at an angle further off than this does not understand positions as it should."""
    attempts: int = 10
    """A capture with a late reading is thrown away and taken again, so many times in all."""
    overcurrent: float = 1.25
    """A measured current past so many times the limit is a trip: the board's own limit has a ripple about it."""
    voltage: float = 0.5
    """Longest voltage vector, as a part of the bus voltage: what sinusoidal modulation reaches for certain."""
    register_map: int = 5
    """The version of the registers that is understood."""
    unlimited: float = -1.0
    """What the library takes for no limit of velocity or acceleration."""


BOUNDS = Bounds()
