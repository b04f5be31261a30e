"""The emulated device's sizes, periods and time limits. Decides nothing."""

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
    max_trapezoid_periods: int = 2_000
    """Periods of a trapezoid: its pieces are laid out before it begins."""
    max_answer_bytes: int = 1 << 18
    """Most bytes of one answer, so that the next command is not kept waiting."""
    max_turn_s: float = 4e-3
    """Longest computation of the plant between two checks of link and watchdog."""
    max_catch_up_s: float = 0.25
    """Most simulated time that a process catches up after it was stopped or starved; the rest is skipped."""
    max_trip_delay_s: float = 0.015
    """Time after a fault at which PWM goes off at the latest, wherever the ramp is."""
    progress_period_s: float = 0.1
    """Period of Progress while a program runs."""
    tick_period_s: float = 1.0
    """Period of Tick."""
    max_batch_frames: int = 64
    """Frames sent between two checks of watchdog and link: a bus may take 0.1 ms for each."""
    max_burst_s: float = 0.01
    """Longest delay that a paced line makes up for."""
    max_waiting_s: float = 0.25
    """Time after which waiting frames are dropped, as on a line without a reader."""
    max_waiting_frames: int = 4096
    """Frames that wait for the line."""
    release_probability: float = 0.2
    """Probability that a delayed frame goes out after the next one."""
    backlog_period_s: float = 1e-3
    """Longest sleep while frames wait for the line."""
    max_received_frames: int = 256
    """Received frames handled in a turn: some buses hand back all that is sent, and others send too."""
    reconnect_period_s: float = 0.002
    """Pause while the other end is gone."""
    max_read_bytes: int = 65536
    """Bytes read from a terminal at once."""
    overload_limit_s: float = 120.0
    """Limit of the integral of (i / rated)^2 - 1, unless options say otherwise: 40 s at twice the rated current."""


BOUNDS = Bounds()
