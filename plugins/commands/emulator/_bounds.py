"""The emulated device's sizes, periods and time limits."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Bounds:
    """Limits of a microcontroller, and limits that keep the process punctual."""

    row_bytes: int = 8
    """Bytes of a row of four int16 channels, the unit of `memory_rows`."""
    ripple_rate_hz: float = 500.0
    """Highest rate of ripple rows."""
    ripple_rows: int = 8192
    """Rows of the ripple memory."""
    max_trapezoid_periods: int = 2_000
    """Largest number of periods of a trapezoid, whose pieces are composed before its start."""
    max_answer_bytes: int = 1 << 18
    """Largest number of bytes of an answer, which bounds the delay of the next command."""
    max_turn_s: float = 4e-3
    """Longest computation of the plant between two checks of link and watchdog."""
    max_rest_s: float = 0.01
    """Longest pause after a computation, where the process has real-time priority."""
    max_catch_up_s: float = 0.25
    """Longest simulated time that is caught up after a suspension; the rest is skipped."""
    max_trip_delay_s: float = 0.015
    """Time after a fault by which PWM is switched off, even during a ramp."""
    progress_period_s: float = 0.1
    """Period of Progress while a program runs."""
    tick_period_s: float = 1.0
    """Period of Tick."""
    max_batch_frames: int = 64
    """Frames sent between two checks of watchdog and link, at up to 0.1 ms each."""
    max_burst_s: float = 0.01
    """Longest delay that a rate-limited line catches up."""
    max_waiting_s: float = 0.25
    """Time after which waiting frames are dropped, as on a line without a reader."""
    max_waiting_frames: int = 4096
    """Largest number of frames queued for the line."""
    release_probability: float = 0.2
    """Probability that a delayed frame goes out after the next one."""
    backlog_period_s: float = 1e-3
    """Longest sleep while frames wait for the line."""
    max_received_frames: int = 256
    """Received frames processed in a cycle, since some buses echo frames and have other senders."""
    reconnect_period_s: float = 0.002
    """Pause while no host is connected."""
    max_read_bytes: int = 65536
    """Largest number of bytes in a read from a terminal."""
    overload_limit_s: float = 120.0
    """Limit of the integral of (i / rated)^2 - 1, unless options say otherwise: 40 s at twice the rated current."""


BOUNDS = Bounds()
