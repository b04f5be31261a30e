"""The drive's clock, checked against the host's clock and against captures for stops and jumps.

A reading was taken between request and reply, so that delays of a busy host are no errors of the
drive. Of an emulated drive, with ``clock: simulated`` in its description, only the order of readings is checked.
"""

from __future__ import annotations

import time
from typing import NamedTuple

from plugins.link._host import Host
from plugins.link._timeouts import TIMEOUTS
from plugins.wire import Unwrapped
from protocols import DriveFault, FaultCause

CLOCK_KEY = "clock"
SIMULATED_CLOCK = "simulated"
"""Value of `CLOCK_KEY` in an emulated drive's description."""
TICK_ROUNDING_SAMPLES = 2
"""Largest rounding of a tick."""
_HOST_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Host clock that continues during suspend, as the drive's does."""


class Reading(NamedTuple):
    """An unwrapped tick, and the host times between which it was taken [s]."""

    tick: int
    sent_s: float
    received_s: float


class Timeline:
    """The ticks of one connection.

    Parameters
    ----------
    host : Host
    sampling_frequency_hz : float
        Tick rate.
    is_simulated : bool
        Whether the drive's clock is simulated.
    """

    def __init__(self, host: Host, sampling_frequency_hz: float, is_simulated: bool) -> None:
        self._host, self._fs, self._is_simulated = host, sampling_frequency_hz, is_simulated
        self._unwrapped = Unwrapped()
        self._last: Reading | None = None
        self._captured = 0
        self._has_captured = False

    def now(self) -> int:
        """The drive's clock, read now; read again after a long delay.

        Raises `DriveFault` (wrong_data) where it went back, stopped or jumped.
        """
        reading = self._read()
        if self._problem(reading):
            reading = self._read()
            problem = self._problem(reading)
            if problem:
                raise DriveFault(FaultCause.WRONG_DATA, f"the drive's clock {problem}")
        self._last = reading
        return reading.tick

    def count(self, tick: int) -> int:
        """A received tick, unwrapped."""
        return self._unwrapped(tick)

    def begin_capture(self, tick: int) -> int:
        """Unwrapped tick of a capture's row 0; raises `DriveFault` (wrong_data) before the previous end."""
        start = self._unwrapped(tick)
        if self._has_captured and start < self._captured - TICK_ROUNDING_SAMPLES:
            early_s = (self._captured - start) / self._fs
            raise DriveFault(FaultCause.WRONG_DATA, f"the capture starts {early_s:.3g} s before the last one has ended")
        self._captured, self._has_captured = start, True
        return start

    def end_capture(self, start: int, rows: int) -> None:
        """Note a capture's end; raises `DriveFault` (wrong_data) where the drive's clock has not reached it."""
        end, now = start + rows, self.now()
        if now < end - TICK_ROUNDING_SAMPLES:
            message = f"the drive's clock is {(end - now) / self._fs:.3g} s before the end of its capture"
            raise DriveFault(FaultCause.WRONG_DATA, message)
        self._captured = end

    def _read(self) -> Reading:
        sent_s = time.clock_gettime(_HOST_CLOCK)
        tick = self._host.tick().tick
        return Reading(self._unwrapped(tick), sent_s, time.clock_gettime(_HOST_CLOCK))

    def _problem(self, reading: Reading) -> str:
        if self._last is None:
            return ""
        passed_s = (reading.tick - self._last.tick) / self._fs
        if passed_s < 0.0:
            return f"went back by {-passed_s:.3g} s"
        if self._is_simulated:
            return ""
        min_s, max_s = reading.sent_s - self._last.received_s, reading.received_s - self._last.sent_s
        if passed_s > (1.0 + TIMEOUTS.clock_error_ratio) * max_s + TIMEOUTS.clock_error_s:
            return f"jumped by {passed_s:.3g} s in {max_s:.3g} s"
        if passed_s < (1.0 - TIMEOUTS.clock_error_ratio) * min_s - TIMEOUTS.clock_error_s:
            return f"advanced by only {passed_s:.3g} s in {min_s:.3g} s"
        return ""
