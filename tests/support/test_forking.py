"""A forked command is a process like any other."""

from __future__ import annotations

import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.support.forking import ForkedCommand
from tests.support.processes import called, start_afresh, start_fluxbench, wait_until


def test_it_prints_what_a_new_interpreter_prints(tmp_path: Path) -> None:
    forked, fresh = start_fluxbench("procedures"), start_afresh("procedures")
    assert forked.communicate(timeout=60) == fresh.communicate(timeout=60)
    assert (forked.wait(), fresh.returncode) == (0, 0)
    wrong = start_fluxbench("check", "nothing.yaml", cwd=tmp_path)
    assert wrong.communicate(timeout=60) == ("", called("check", "nothing.yaml", cwd=tmp_path).stderr)
    assert wrong.returncode == 2


def test_signals_reach_it_alone_and_its_end_is_reported(tmp_path: Path) -> None:
    commands = [
        start_fluxbench("emulate", "--serial", tmp_path / name, "--log", tmp_path / f"{name}.jsonl") for name in "ab"
    ]
    wait_until(lambda: all((tmp_path / name).is_symlink() for name in "ab"))
    killed, stopped = commands
    assert killed.pid != stopped.pid
    killed.kill()
    assert killed.wait(timeout=20) == -signal.SIGKILL
    assert stopped.poll() is None
    stopped.send_signal(signal.SIGTERM)
    assert stopped.wait(timeout=20) == 0


def test_several_threads_may_wait_for_its_end() -> None:
    command = ForkedCommand(["--version"])
    with ThreadPoolExecutor(8) as threads:
        assert set(threads.map(lambda _: command.wait(60.0), range(8))) == {0}
