"""The heartbeat process: writes the beats it was handed to a link when they are due. Started by its path.

It imports only the standard library and is independent of a busy main process: it has its own interpreter lock, memory
locked against swapping, and a higher priority where the system allows it. It sends only the beats it was handed: none
after the main process ends or is stopped, and none beyond the lease of one that hangs. Arguments: the link's
descriptor, or ``measure SECONDS`` to print this host's worst gap.
"""

import ctypes
import os
import select
import struct
import sys
import time
from collections import deque
from contextlib import suppress
from pathlib import Path

BEAT_HEADER = struct.Struct("<dH")
"""Instant on the monotonic clock, and the length of the beat to write then."""
REAL_TIME_PRIORITY = 10
_LOCK_ALL_MEMORY = 3


def with_priority() -> bytes:
    """Raise the priority as far as the system allows: b"r" real time, b"n" a better nice value, b"p" plain."""
    with suppress(OSError, AttributeError):  # without it, it may be swapped out
        ctypes.CDLL(None).mlockall(_LOCK_ALL_MEMORY)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
        return b"r"
    except (OSError, AttributeError):
        pass
    try:
        os.nice(-10)
        return b"n"
    except OSError:
        return b"p"


def is_stopped(process: int) -> bool:
    """Whether a process is stopped (SIGSTOP, Ctrl-Z, a debugger); False where unknown."""
    try:
        status = Path(f"/proc/{process}/stat").read_bytes()
        return status.rpartition(b")")[2].split()[0] in (b"T", b"t")
    except (OSError, IndexError):
        return False


def beat(link: int) -> None:
    """Send beats until the main process closes its end of the pipe."""
    parent, handed = os.getppid(), b""
    due: deque[tuple[float, bytes]] = deque()
    os.write(1, with_priority())
    while True:
        wait_s = max(0.0, due[0][0] - time.monotonic()) if due else 1.0
        if select.select([0], [], [], wait_s)[0]:
            data = os.read(0, 65536)
            if not data:
                return
            handed += data
            while len(handed) >= BEAT_HEADER.size:
                at_s, length = BEAT_HEADER.unpack_from(handed)
                if len(handed) < BEAT_HEADER.size + length:
                    break
                due.append((at_s, handed[BEAT_HEADER.size : BEAT_HEADER.size + length]))
                handed = handed[BEAT_HEADER.size + length :]
        latest = None
        while due and due[0][0] <= time.monotonic():
            latest = due.popleft()[1]
        if latest is not None and not is_stopped(parent):
            try:
                os.write(link, latest)
            except BlockingIOError:
                pass  # the next beat follows soon
            except OSError:
                return


def worst_gap(seconds: float, step_s: float = 0.005) -> float:
    """Sleep step by step; the longest time that a step took beyond it [s]."""
    worst, end = 0.0, time.monotonic() + seconds
    while (begun := time.monotonic()) < end:
        time.sleep(step_s)
        worst = max(worst, time.monotonic() - begun - step_s)
    return worst


if __name__ == "__main__":
    if sys.argv[1] == "measure":
        os.write(1, with_priority() + b" %.6f\n" % worst_gap(float(sys.argv[2])))
    else:
        beat(int(sys.argv[1]))
