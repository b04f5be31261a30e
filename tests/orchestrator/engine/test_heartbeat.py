"""The heart beats from a process of its own: while this one is kept busy, and never beyond its lease."""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import subprocess
import time
from collections.abc import Iterator

import pytest

from orchestrator.engine import HeartbeatKeeper, _heartbeat
from orchestrator.engine._beater import is_stopped
from tests.support.processes import wait_until

INSTANT = struct.Struct("<d")


class PipedDrive:
    """A link that is a pipe; each beat says when it is due."""

    def __init__(self, shared: bool = True) -> None:
        self.far, self.near = os.pipe()
        os.set_blocking(self.far, False)
        self.shared = shared
        self.beats_here = 0

    def heartbeat(self) -> None:
        self.beats_here += 1

    def heartbeat_outlet(self) -> int | None:
        return self.near if self.shared else None

    def heartbeat_at(self, time_s: float) -> bytes:
        return INSTANT.pack(time_s)

    def beats(self) -> list[float]:
        """The instants of the beats since the last look."""
        try:
            return [instant for (instant,) in INSTANT.iter_unpack(os.read(self.far, 1 << 16))]
        except BlockingIOError:
            return []


@pytest.fixture
def drive() -> Iterator[PipedDrive]:
    made = PipedDrive()
    yield made
    os.close(made.far)
    os.close(made.near)


def test_beats_go_on_while_this_interpreter_is_held_up(drive: PipedDrive) -> None:
    with HeartbeatKeeper(drive, 0.2):  # type: ignore[arg-type]
        wait_until(lambda: bool(drive.beats()))
        begun = time.monotonic()
        ctypes.PyDLL(None).usleep(900_000)  # holds the lock of the interpreter, as a busy host would
        held_s = time.monotonic() - begun
        beats = drive.beats()
    assert len(beats) >= 0.8 * held_s / 0.05
    assert drive.beats_here == 1, "the one that arming begins with"


def test_nothing_is_stated_beyond_the_lease(drive: PipedDrive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_heartbeat, "LEASE_S", 0.3)
    with HeartbeatKeeper(drive, 0.1) as keeper:  # type: ignore[arg-type]
        begun = time.monotonic()
        time.sleep(0.8)
        assert 0.15 < max(drive.beats()) - begun <= 0.3
        keeper.renew()
        wait_until(lambda: bool(drive.beats()))


def test_nothing_is_stated_after_the_end(drive: PipedDrive) -> None:
    with HeartbeatKeeper(drive, 0.1):  # type: ignore[arg-type]
        wait_until(lambda: bool(drive.beats()))
    drive.beats()
    time.sleep(0.3)
    assert not drive.beats()


def test_a_link_that_cannot_be_shared_is_beaten_for_here(drive: PipedDrive) -> None:
    drive.shared = False
    with HeartbeatKeeper(drive, 0.1):  # type: ignore[arg-type]
        wait_until(lambda: drive.beats_here >= 3)
    assert not drive.beats()


def test_a_process_that_somebody_has_stopped_is_known_to_be() -> None:
    sleeping = subprocess.Popen(["sleep", "10"])
    try:
        assert not is_stopped(sleeping.pid)
        sleeping.send_signal(signal.SIGSTOP)
        wait_until(lambda: is_stopped(sleeping.pid), 5.0)
    finally:
        sleeping.kill()
        sleeping.wait()


@pytest.mark.parametrize("shared", [True, False])
def test_the_hosts_worst_gap_says_which_watchdog_it_keeps(drive: PipedDrive, shared: bool) -> None:
    drive.shared = shared
    gap = _heartbeat.host_latency(drive, 0.1)  # type: ignore[arg-type]
    assert 0.0 <= gap.worst_s < gap.shortest_watchdog_s
    assert gap.sender.startswith("a process of" if shared else "a thread")
