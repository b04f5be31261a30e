"""What the emulated device is: its sizes, its paces, and how long it attends to one thing. Decides nothing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Bounds:
    """A microcontroller's limits, and what keeps a process as punctual as one."""

    row_bytes: int = 8
    """Four int16 channels: what `memory_rows` counts in."""
    ripple_rate_hz: float = 500.0
    """Ripple rows a second at most."""
    ripple_rows: int = 8192
    """Rows that the memory for ripple holds."""
    most_periods: int = 2_000
    """Periods of a trapezoid: its pieces are laid out before it begins."""
    answer_bytes: int = 1 << 18
    """Most bytes of one answer, so that the next command is not kept waiting."""
    attended_s: float = 4e-3
    """The plant is computed for so long at most before link and watchdog are looked at again."""
    forgiven_s: float = 0.25
    """What a process that was stopped or starved missed is caught up with as far as this; the rest never was."""
    safe_within_s: float = 0.015
    """PWM goes off so long after a fault at the latest, wherever the ramp is."""
    progress_s: float = 0.1
    """Period of Progress while a program runs."""
    tick_s: float = 1.0
    """Period of Tick."""
    batch: int = 64
    """Frames that are sent before watchdog and link are looked at again: a bus may take 0.1 ms for each."""
    burst_s: float = 0.01
    """A paced line makes up for so much time that it was not attended to."""
    given_up_s: float = 0.25
    """What nobody took for so long is thrown away, as a line without a reader does."""
    most_waiting: int = 4096
    """Frames that wait for the line."""
    let_go: float = 0.2
    """Chance that a frame that was held back goes out after the next one."""
    backlog_s: float = 1e-3
    """Longest sleep while frames wait for the line."""
    frames_each: int = 256
    """Frames looked at in a turn: some buses hand back all that is sent, and others are talking too."""
    nobody_s: float = 0.002
    """Pause where the other end is gone: it may come back."""
    read_bytes: int = 65536
    """Bytes read from a terminal at once."""
    overload_s: float = 120.0
    """Of (i / rated)^2 - 1, unless the options say otherwise: 40 s at twice the rated current."""


BOUNDS = Bounds()
