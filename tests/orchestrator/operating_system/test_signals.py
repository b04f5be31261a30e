"""An alarm calls the main thread's handler, and not where it was cancelled; handlers are put back."""

from __future__ import annotations

import signal
import time
from types import FrameType

import pytest

from orchestrator.operating_system.signals import ALARM_SIGNAL, STOP_SIGNALS, Alarm, handlers


class OverdueError(Exception):
    """Raised by the alarm's handler."""


def wait_with_alarm(after_s: float) -> None:
    Alarm().start(after_s)
    for _ in range(1000):
        time.sleep(0.01)


def overdue(number: int, frame: FrameType | None) -> None:
    raise OverdueError


@pytest.mark.usefixtures("system")
def test_an_alarm_ends_what_takes_too_long() -> None:
    begun = time.monotonic()
    with handlers({ALARM_SIGNAL: overdue}), pytest.raises(OverdueError):
        wait_with_alarm(0.05)
    assert time.monotonic() - begun >= 0.05


@pytest.mark.usefixtures("system")
def test_a_cancelled_alarm_calls_nobody() -> None:
    alarm = Alarm()
    with handlers({ALARM_SIGNAL: overdue}):
        alarm.start(0.05)
        alarm.cancel()
        alarm.cancel()
        time.sleep(0.15)


def test_handlers_are_put_back() -> None:
    before = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    with handlers(dict.fromkeys(STOP_SIGNALS, overdue)):
        assert all(signal.getsignal(number) is overdue for number in STOP_SIGNALS)
    assert {number: signal.getsignal(number) for number in STOP_SIGNALS} == before


def test_a_terminal_that_is_closed_stops_a_run_as_ctrl_c_does() -> None:
    assert {signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT} == set(STOP_SIGNALS)
