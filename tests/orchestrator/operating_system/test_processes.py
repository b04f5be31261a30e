"""A lasting process goes on after whoever started it, beyond the reach of its terminal, until it is stopped."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from orchestrator.operating_system.processes import LastingProcess, available_cores, interrupt, open_process, own_group

SLEEP = [sys.executable, "-c", "import time; time.sleep(60)"]
START = f"from orchestrator.operating_system.processes import LastingProcess; print(LastingProcess({SLEEP!r}).pid)"


def test_it_goes_on_when_its_starter_has_ended_without_a_word() -> None:
    done = subprocess.run([sys.executable, "-W", "error", "-c", START], capture_output=True, text=True, check=True)
    left = psutil.Process(int(done.stdout))
    try:
        assert left.is_running()
        assert os.getsid(left.pid) == left.pid
        assert done.stderr == ""
    finally:
        left.kill()


def test_it_goes_on_when_nobody_refers_to_it_any_more() -> None:
    process = LastingProcess(SLEEP)
    pid = process.pid
    assert not process.has_ended
    del process
    gc.collect()
    child = psutil.Process(pid)
    assert child.status() != psutil.STATUS_ZOMBIE
    child.kill()
    child.wait()


@pytest.mark.parametrize("ignored", ["SIG_DFL", "SIG_IGN"])
def test_it_is_stopped_even_where_it_ignores_the_request(ignored: str, tmp_path: Path) -> None:
    ready = tmp_path / "ready"
    program = "import pathlib, signal, sys, time; signal.signal(signal.SIGTERM, getattr(signal, sys.argv[1])); "
    program += "pathlib.Path(sys.argv[2]).touch(); time.sleep(60)"
    process = LastingProcess([sys.executable, "-c", program, ignored, str(ready)])
    while not ready.exists():
        assert not process.has_ended
    process.stop(0.2)
    assert process.has_ended
    process.stop()


def test_a_request_to_end_is_that_of_ctrl_c() -> None:
    program = "import time; print(flush=True); time.sleep(60)"
    process = open_process([sys.executable, "-c", program], stdout=subprocess.PIPE, **own_group())
    assert process.stdout is not None
    with process.stdout as output:
        output.readline()
        interrupt(process)
        assert process.wait() == -signal.SIGINT


def test_cores_are_those_that_this_process_may_use() -> None:
    assert available_cores() == len(os.sched_getaffinity(0))
