"""Requests to stop and to pause, and the signals that make them."""

from __future__ import annotations

import os
import signal
import threading

import pytest

from orchestrator.engine import Interrupts, handling_signals
from protocols import RunInterrupted


def test_nothing_is_raised_before_a_stop_is_requested() -> None:
    Interrupts().check()


def test_the_first_reason_to_stop_counts() -> None:
    interrupts = Interrupts()
    interrupts.stop("too hot")
    interrupts.stop("too late")
    with pytest.raises(RunInterrupted, match="too hot"):
        interrupts.check()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_stop_signal_becomes_a_request_that_names_it(number: signal.Signals) -> None:
    with handling_signals() as interrupts:
        os.kill(os.getpid(), number)
        with pytest.raises(RunInterrupted, match=number.name):
            interrupts.check()


def test_handlers_are_put_back() -> None:
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)]
    with handling_signals():
        assert signal.getsignal(signal.SIGTERM) is not before[1]
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP)] == before


def test_ctrl_z_asks_for_a_pause_and_does_not_stop_the_process_at_once() -> None:
    with handling_signals() as interrupts:
        assert not interrupts.pause_wanted
        os.kill(os.getpid(), signal.SIGTSTP)
        assert interrupts.pause_wanted


def test_a_pause_lasts_until_it_is_lifted() -> None:
    interrupts = Interrupts()
    interrupts.pause()
    threading.Timer(0.05, interrupts.resume).start()
    interrupts.wait_until_resumed()
    assert not interrupts.pause_wanted


def test_a_stop_ends_a_pause() -> None:
    interrupts = Interrupts()
    interrupts.pause()
    threading.Timer(0.05, interrupts.stop, ["enough"]).start()
    with pytest.raises(RunInterrupted, match="enough"):
        interrupts.wait_until_resumed()
