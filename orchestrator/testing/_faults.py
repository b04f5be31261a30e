"""A plugin that raises, or does not return, fails a kit's check with one line that says where."""

from __future__ import annotations

import functools
import signal
import sysconfig
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from protocols import FluxbenchError

_KIT = Path(__file__).parent


@contextmanager
def faults_as_failures(max_seconds: float) -> Iterator[None]:
    """Context in which an unexpected exception or `max_seconds` without an end fail the check with one line.

    The project's own errors and failed assertions pass. Time is limited in the main thread alone.
    """
    with _limited(max_seconds):
        try:
            yield
        except (AssertionError, FluxbenchError):
            raise
        except Exception as error:
            frames = traceback.walk_tb(error.__traceback__)
            what = " ".join(f"{type(error).__name__}: {error}".split())
            pytest.fail(f"the plugin raised {what}{_place(frames)}", pytrace=False)


def judged(check: Callable[..., Any]) -> Callable[..., Any]:
    """A kit's check with `faults_as_failures`."""

    @functools.wraps(check)
    def limited(self: Any, *arguments: Any, **named: Any) -> Any:
        with faults_as_failures(self.max_seconds):
            return check(self, *arguments, **named)

    return limited


@contextmanager
def _limited(max_seconds: float) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def overdue(number: int, frame: FrameType | None) -> None:
        place = _place(traceback.walk_stack(frame), innermost_first=True)
        pytest.fail(f"the plugin has not returned within {max_seconds:g} s{place}", pytrace=False)

    before = signal.signal(signal.SIGALRM, overdue)
    # Again and again: what cleans up after the check may not return either.
    remaining_s, interval_s = signal.setitimer(signal.ITIMER_REAL, max_seconds, max_seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        if remaining_s:  # of a limit around this one
            signal.setitimer(signal.ITIMER_REAL, remaining_s, interval_s)


def _place(frames: Any, *, innermost_first: bool = False) -> str:
    """File and line of the innermost frame outside the kit, pytest, libraries and this project's own rooms."""
    ordered = list(frames) if innermost_first else list(frames)[::-1]
    stdlib, root = sysconfig.get_path("stdlib"), _KIT.parents[1]
    for frame, line in ordered:
        file = frame.f_code.co_filename
        own = any(Path(file).is_relative_to(root / room) for room in ("orchestrator", "protocols"))
        if not own and "site-packages" not in file and not file.startswith(("<", stdlib)):
            return f" ({file}, line {line})"
    return ""
