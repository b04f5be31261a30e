"""Signals in the first second of a program: obeyed at once, by a process that was started with them ignored too."""

from __future__ import annotations

import shlex
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from orchestrator.interface.cli._early_signals import EarlySignals
from orchestrator.interface.cli._running import run_app
from orchestrator.operating_system.signals import STOP_SIGNALS
from tests.support.cases import few
from tests.support.processes import FLUXBENCH, wait_until
from tests.support.tiny import tiny_file


def started(folder: Path) -> subprocess.Popen[str]:
    """A run of its own session, all signals ignored, at the moment in which its handlers are there."""
    words = shlex.join([FLUXBENCH, "run", str(tiny_file(folder)), "--out", str(folder / "run"), "--quiet"])
    shell = f"trap '' INT HUP QUIT TERM TSTP; exec {words}"
    process = subprocess.Popen(
        ["sh", "-c", shell], stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    wait_until(lambda: catches(process, signal.SIGTSTP))
    return process


def catches(process: subprocess.Popen[str], number: int) -> bool:
    caught = field_of(process, "SigCgt")
    return bool(int(caught, 16) >> (number - 1) & 1)


def field_of(process: subprocess.Popen[str], name: str) -> str:
    lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
    return next(line.split(":")[1].strip() for line in lines if line.startswith(name))


@few("number, later_s", [*zip(STOP_SIGNALS, (0.0, 0.05, 0.15, 0.3), strict=True)], fast=2)
def test_a_signal_while_the_program_is_still_loading_ends_it_before_anything_is_energised(
    tmp_path: Path, number: signal.Signals, later_s: float
) -> None:
    process = started(tmp_path)
    time.sleep(later_s)
    process.send_signal(number)
    _, message = process.communicate(timeout=20)
    assert (process.returncode, message.count("\n")) == (130, 1), message
    assert number.name in message
    journal = tmp_path / "run" / "journal.jsonl"
    assert not journal.exists() or "reading_gates_off" not in journal.read_text()


def test_ctrl_z_while_the_program_is_still_loading_stops_it_until_it_may_go_on(tmp_path: Path) -> None:
    process = started(tmp_path)
    process.send_signal(signal.SIGTSTP)
    wait_until(lambda: field_of(process, "State").startswith("T"))
    process.send_signal(signal.SIGTERM)
    process.send_signal(signal.SIGCONT)
    _, message = process.communicate(timeout=20)
    assert (process.returncode, message) == (130, "fluxbench: interrupted by SIGTERM\n")
    assert not (tmp_path / "run").exists()


@pytest.fixture
def handlers() -> Iterator[dict[int, object]]:
    numbers = (*STOP_SIGNALS, signal.SIGTSTP)
    before = {int(number): signal.getsignal(number) for number in numbers}
    yield {**before}
    for number, handler in before.items():
        signal.signal(number, handler)


def test_commands_that_energise_nothing_get_the_handlers_before_back(handlers: dict[int, object]) -> None:
    EarlySignals().settle(energises=False)
    assert {number: signal.getsignal(number) for number in handlers} == handlers


def test_commands_that_energise_keep_them_until_the_run_has_its_own(handlers: dict[int, object]) -> None:
    EarlySignals().settle(energises=True)
    assert all(signal.getsignal(number) != handler for number, handler in handlers.items())


@pytest.mark.parametrize(
    ("command", "energises"),
    [("run", True), ("resume", True), ("commission", True), ("estimate", False), ("probe", False), ("wire", False)],
)
def test_every_command_says_once_whether_it_energises(command: str, energises: bool) -> None:
    message: list[bool] = []
    run_app([command, "--no-such-option"], message.append)
    assert message == [energises]
