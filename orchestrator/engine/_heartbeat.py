"""The heartbeat: tells the drive that the host is alive, and only while it really is.

A thread of its own beats, but on a lease that the run's thread has to renew: a host that hangs
stops beating, and the drive's dead man makes the motor safe.
"""

from __future__ import annotations

import threading
import time
from types import TracebackType
from typing import Self

from protocols import Drive

LEASE_S = 5.0
"""How long the run's thread may be busy (writing a capture to a slow disk) before beating stops."""


class HeartbeatKeeper:
    """Beats for an armed drive; use as a context manager around everything energised.

    Parameters
    ----------
    drive : Drive
        Its `heartbeat` is called from the keeper's thread.
    watchdog_s : float or None
        The drive's dead man; a beat comes every quarter of it. None: the drive has none, and
        there is nothing to keep.
    """

    def __init__(self, drive: Drive, watchdog_s: float | None) -> None:
        self._drive = drive
        self._period_s = None if watchdog_s is None else watchdog_s / 4
        self._expiry = 0.0
        self._done = threading.Event()
        self._thread: threading.Thread | None = None

    def renew(self, seconds: float = 0.0) -> None:
        """Promise to be back within the lease, and `seconds` more where the drive will be quiet for so long."""
        self._expiry = time.monotonic() + LEASE_S + seconds

    def __enter__(self) -> Self:
        self.renew()
        if self._period_s is not None:
            self._drive.heartbeat()
            self._thread = threading.Thread(target=self._beat, name="heartbeat", daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._done.set()
        if self._thread is not None:
            self._thread.join()

    def _beat(self) -> None:
        assert self._period_s is not None
        while not self._done.wait(self._period_s):
            if time.monotonic() < self._expiry:
                self._drive.heartbeat()
