"""The heartbeat: tells the drive that the host is alive, and only while it really is.

It comes on a lease that the run's thread has to renew: a host that hangs stops beating, and the drive's dead man makes
the motor safe. Where the link is a descriptor that two processes may write to, a process of its own beats (`_beater`),
which a busy interpreter cannot hold up; it is handed a few seconds of beats at a time, never beyond the lease. On other
links a thread beats.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Self

from orchestrator.engine._beater import BEAT_HEADER, worst_gap
from protocols import Drive, RelayedDrive

LEASE_S = 5.0
"""How long the run's thread may be busy (writing a capture to a slow disk) before beating stops."""
BEATS_AHEAD_S = 3.0
"""Beats that are handed over at a time: longer than a busy host keeps this process waiting, within any lease."""
BEATS_PER_WATCHDOG = 4
_BEATER = str(Path(__file__).with_name("_beater.py"))
_BEATER_COMMAND = (sys.executable, "-I", "-S", _BEATER)
"""Without site-packages it is there in some hundredths of a second."""


class HeartbeatKeeper:
    """Beats for a drive that is about to be armed, from `__enter__` to `close`.

    Parameters
    ----------
    drive : Drive
        Its `heartbeat` is called from the keeper's thread, or what a `RelayedDrive` says is written by another process.
    watchdog_s : float or None
        The drive's dead man; a beat comes every quarter of it. None: the drive has none, and
        there is nothing to keep.
    """

    def __init__(self, drive: Drive, watchdog_s: float | None) -> None:
        self._drive = drive
        self._period_s = None if watchdog_s is None else watchdog_s / BEATS_PER_WATCHDOG
        self._expiry = 0.0
        self._done = threading.Event()
        self._thread: threading.Thread | None = None
        self._relay = None if watchdog_s is None else _Relay.of(drive)

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
        self.close()

    def close(self) -> None:
        """No beat comes after this returns."""
        self._done.set()
        if self._thread is not None:
            self._thread.join()
        if self._relay is not None:
            self._relay.close()

    def _beat(self) -> None:
        assert self._period_s is not None
        handed_s, wait_s = 0.0, 0.0
        while not self._done.wait(wait_s):
            wait_s = self._period_s
            now = time.monotonic()
            if self._relay is None:
                if now < self._expiry:
                    self._drive.heartbeat()
                continue
            handed_s = max(handed_s, now)
            while handed_s + self._period_s < min(now + BEATS_AHEAD_S, self._expiry):
                handed_s += self._period_s
                if not self._relay.hand(handed_s):
                    self._relay = None  # it has died: this thread goes on
                    break


class _Relay:
    """The process that beats, and this end of its pipe."""

    ready_s: ClassVar[float] = 2.0

    def __init__(self, drive: RelayedDrive, outlet: int) -> None:
        self._drive = drive
        self._process = subprocess.Popen(
            [*_BEATER_COMMAND, str(outlet)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=(outlet,),
            start_new_session=True,  # a terminal's Ctrl-C and Ctrl-Z are for the run
            bufsize=0,
        )

    @classmethod
    def of(cls, drive: Drive) -> _Relay | None:
        """For a drive that allows it, once the process is there; else None."""
        outlet = drive.heartbeat_outlet() if isinstance(drive, RelayedDrive) else None
        if outlet is None or os.name != "posix":
            return None
        assert isinstance(drive, RelayedDrive)
        try:
            relay = cls(drive, outlet)
        except OSError:
            return None
        if relay.is_ready():
            return relay
        relay.close()
        return None

    def is_ready(self) -> bool:
        assert self._process.stdout is not None
        readable, _, _ = select.select([self._process.stdout], [], [], self.ready_s)
        return bool(readable and self._process.stdout.read(1))

    def hand(self, at_s: float) -> bool:
        """Have a beat written at this instant; False where nobody is there to do it."""
        assert self._process.stdin is not None
        beat = self._drive.heartbeat_at(at_s)
        try:
            self._process.stdin.write(BEAT_HEADER.pack(at_s, len(beat)) + beat)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """End it: it says nothing more once its pipe is closed."""
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()
        try:
            self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@dataclass(frozen=True)
class HostGap:
    """How late this host is with what is due."""

    worst_s: float
    who: str
    """Who beats, and was looked at."""
    shortest_s: ClassVar[float] = 0.01
    """No shorter watchdog is promised by a look of a second."""

    @property
    def keeps_s(self) -> float:
        """The shortest watchdog that a beat every quarter of it keeps through such a gap, doubled to be sure."""
        return max(2.0 * self.worst_s * BEATS_PER_WATCHDOG / (BEATS_PER_WATCHDOG - 1), self.shortest_s)


def host_gap(drive: Drive, seconds: float = 1.0) -> HostGap:
    """What whoever beats for this drive would have met now, in so many seconds."""
    relayed = isinstance(drive, RelayedDrive) and drive.heartbeat_outlet() is not None and os.name == "posix"
    if relayed:
        with suppress(OSError, subprocess.SubprocessError, ValueError):
            command = [*_BEATER_COMMAND, "measure", str(seconds)]
            output = subprocess.run(command, capture_output=True, text=True, timeout=seconds + 10.0, check=True).stdout
            priority, worst = output.split()
            return HostGap(float(worst), f"a process of {_PRIORITIES[priority]} priority")
    return HostGap(worst_gap(seconds), "a thread, for this link cannot be shared,")


_PRIORITIES = {"r": "real-time", "n": "raised", "p": "plain"}
