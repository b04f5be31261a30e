"""The heartbeat to the drive, sent only while the run's thread is alive.

The run's thread has to renew a lease: if it hangs, the heartbeat stops and the drive's watchdog makes the motor safe.
On a link whose descriptor two processes may write to, a separate process (`_beater`) sends it, which a busy interpreter
cannot delay; it gets a few seconds of beats at a time, never beyond the lease. On other links a thread sends it.
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
from orchestrator.operating_system.processes import own_group
from protocols import Drive, RelayedDrive

LEASE_S = 5.0
"""Time that the run's thread may be busy (writing to a slow disk) before the heartbeat stops."""
BEATS_AHEAD_S = 3.0
"""Beats handed over at a time: longer than a busy host delays this process, shorter than a lease."""
BEATS_PER_WATCHDOG = 4
_BEATER = str(Path(__file__).with_name("_beater.py"))
_BEATER_COMMAND = (sys.executable, "-I", "-S", _BEATER)
"""Without site-packages it starts in some hundredths of a second."""


class HeartbeatKeeper:
    """Beats for a drive that is about to be armed, from `__enter__` to `close`.

    Parameters
    ----------
    drive : Drive
        Its `heartbeat` is called from the keeper's thread; a `RelayedDrive`'s is written by another process.
    watchdog_s : float or None
        The drive's watchdog; a beat comes every quarter of it. None: the drive has none, and no
        beat is sent.
    """

    def __init__(self, drive: Drive, watchdog_s: float | None) -> None:
        self._drive = drive
        self._period_s = None if watchdog_s is None else watchdog_s / BEATS_PER_WATCHDOG
        self._expiry = 0.0
        self._done = threading.Event()
        self._thread: threading.Thread | None = None
        self._relay = None if watchdog_s is None else _Relay.of(drive)

    def renew(self, seconds: float = 0.0) -> None:
        """Renew the lease, extended by `seconds` where the drive will be quiet for so long."""
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
                    self._relay = None  # it has died: this thread takes over
                    break


class _Relay:
    """The process that sends the heartbeat, and this end of its pipe."""

    ready_s: ClassVar[float] = 2.0

    def __init__(self, drive: RelayedDrive, heartbeat_fd: int) -> None:
        self._drive = drive
        self._process = subprocess.Popen(
            [*_BEATER_COMMAND, str(heartbeat_fd)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=(heartbeat_fd,),
            **own_group(),  # a terminal's Ctrl-C and Ctrl-Z are for the run
            bufsize=0,
        )

    @classmethod
    def of(cls, drive: Drive) -> _Relay | None:
        """The relay, once its process is ready; None for a drive without a shared descriptor."""
        heartbeat_fd = drive.heartbeat_outlet() if isinstance(drive, RelayedDrive) else None
        if heartbeat_fd is None or os.name != "posix":
            return None
        assert isinstance(drive, RelayedDrive)
        try:
            relay = cls(drive, heartbeat_fd)
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
        """Schedule a beat at this instant; False where the process is gone."""
        assert self._process.stdin is not None
        beat = self._drive.heartbeat_at(at_s)
        try:
            self._process.stdin.write(BEAT_HEADER.pack(at_s, len(beat)) + beat)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """End the process: it sends nothing once its pipe is closed."""
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()
        try:
            self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@dataclass(frozen=True)
class HostLatency:
    """Latency of this host in sending a due heartbeat."""

    worst_s: float
    sender: str
    """Name of the process or thread that sends it."""
    shortest_s: ClassVar[float] = 0.01
    """Lower bound of `shortest_watchdog_s`, as one second of measurement proves no less."""

    @property
    def shortest_watchdog_s(self) -> float:
        """Shortest watchdog that a beat every quarter of it keeps alive through such a gap, with a factor of two."""
        return max(2.0 * self.worst_s * BEATS_PER_WATCHDOG / (BEATS_PER_WATCHDOG - 1), self.shortest_s)


def host_latency(drive: Drive, seconds: float = 1.0) -> HostLatency:
    """Latency of this drive's heartbeat sender, measured for `seconds`."""
    relayed = isinstance(drive, RelayedDrive) and drive.heartbeat_outlet() is not None and os.name == "posix"
    if relayed:
        with suppress(OSError, subprocess.SubprocessError, ValueError):
            command = [*_BEATER_COMMAND, "measure", str(seconds)]
            output = subprocess.run(command, capture_output=True, text=True, timeout=seconds + 10.0, check=True).stdout
            priority, worst = output.split()
            return HostLatency(float(worst), f"a process of {_PRIORITIES[priority]} priority")
    return HostLatency(worst_gap(seconds), "a thread (this link cannot be shared)")


_PRIORITIES = {"r": "real-time", "n": "raised", "p": "plain"}
