"""Either end killed or stopped at any step of a run: the drive becomes safe, the run ends in a named fault or goes on.

How often: the environment variable FLUXBENCH_KILLS, for each of the four (3 by default).
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from orchestrator.engine import SAFE_BENCH_WORDS
from orchestrator.recording import open_recording
from orchestrator.runs import RunDirectory
from protocols import PointDone, RunEnded
from tests.support.emulator import Emulator, emulator
from tests.support.forking import ForkedCommand
from tests.support.processes import called, start_fluxbench, wait_until
from tests.support.tiny import STAGES, messages_of, tiny_file

TIMES = int(os.environ.get("FLUXBENCH_KILLS", "3"))
WATCHDOG_S = 0.2
SAFE_WITHIN_S = 1.1 * WATCHDOG_S
ENDED_WITHIN_S = 1.0
LONGEST_S = 4.0
"""A deed is done so long after arming at the latest: about as long as the run lasts."""

pytestmark = [pytest.mark.slow, pytest.mark.timeout(60 * TIMES + 300)]


@dataclass
class Bench:
    """An emulated drive, and runs on it one after the other: each is resumed until it is finished."""

    folder: Path
    rng: random.Random
    machine: Emulator
    _emulating: ExitStack
    latencies_s: list[float] = field(default_factory=list)
    runs: int = 0
    starved: int = 0
    """Runs that a busy machine ended by itself."""
    _run: Path | None = None

    @classmethod
    @contextmanager
    def at(cls, folder: Path, seed: int) -> Iterator[Bench]:
        with ExitStack() as emulating:
            machine = emulating.enter_context(emulator(folder))
            yield cls(folder, random.Random(seed), machine, emulating)

    def restart_machine(self) -> None:
        """A new emulator where the last one was killed."""
        self._emulating.close()
        self.machine = self._emulating.enter_context(emulator(self.folder))

    @property
    def run(self) -> Path:
        assert self._run is not None
        return self._run

    def start(self) -> ForkedCommand:
        """Start the next run, or go on with the one that was ended before its time; returns when it has armed."""
        ended = self._run is not None and self._run.exists() and RunDirectory.open(self._run).ended()
        if self._run is None or not self._run.exists() or (ended and ended.outcome == "finished"):
            self.runs += 1
            self._run = self.folder / f"run-{self.runs}"
            procedure = tiny_file(
                self.folder,
                drive={"name": "serial", "port": str(self.folder / "line")},
                stages=[stage for stage in STAGES if stage["kind"] != "estimate"],
            )
            words: tuple[str | Path, ...] = ("run", procedure, "--out", self._run)
        else:
            words = ("resume", self._run)
        armed = len(self.machine.events("armed"))
        process = start_fluxbench(*words, "--quiet", "--unattended", SAFE_BENCH_WORDS)
        wait_until(lambda: len(self.machine.events("armed")) > armed or process.poll() is not None)
        return process

    def wait_a_while(self, process: ForkedCommand) -> bool:
        """Some time of the run; False where it came to its end meanwhile.

        On a machine that is too busy to beat in time the watchdog does what it is there for; the run then says so.
        """
        try:
            process.wait(self.rng.uniform(0.0, LONGEST_S))
        except subprocess.TimeoutExpired:
            return True
        self._require_finished_or_starved(process)
        return False

    def _require_finished_or_starved(self, process: ForkedCommand) -> None:
        _, errors = process.communicate(timeout=60)
        self.starved += process.returncode == 3
        assert process.returncode == 0 or (process.returncode == 3 and "drive fault" in errors), errors
        assert self.starved <= TIMES, errors

    def require_safe_since(self, time_s: float) -> None:
        """Where the drive was energised it has gone to its safe state in time, and has not been armed since."""
        if self.machine.is_energised(time_s):
            wait_until(lambda: any(e["time_s"] > time_s for e in self.machine.events("safe", "disarmed")), 2.0)
            safe = [e for e in self.machine.events("safe") if e["time_s"] > time_s]
            if safe:
                self.latencies_s.append(safe[0]["since_beat_s"])
                assert safe[0]["cause"] == "watchdog"
                assert safe[0]["since_beat_s"] <= SAFE_WITHIN_S
        assert not self.machine.is_energised(time.monotonic())

    def require_points_kept(self) -> None:
        """Every point that the journal has is a segment that can be read."""
        if not (self.run / "journal.jsonl").exists():
            return
        done = {message.id for message in messages_of(self.run) if isinstance(message, PointDone)}
        assert set(RunDirectory.open(self.run).completed()) == done
        for point in done:
            assert (self.run / "captures" / f"{point}.parquet").stat().st_size > 0

    def finish(self) -> None:
        """The run is resumed to its end and whole."""
        process = self.start()
        self._require_finished_or_starved(process)
        while process.returncode:
            process = self.start()
            self._require_finished_or_starved(process)
        recording = open_recording(self.run)
        for segment in recording.segments():
            recording.load(segment)
        starts = [segment.start_s for segment in recording.segments()]
        assert starts == sorted(starts)
        assert called("estimate", self.run, "--estimator", "resistance").returncode == 0

    def report(self, what: str) -> None:
        worst = f", safe {max(self.latencies_s):.3f} s after the last heartbeat at worst" if self.latencies_s else ""
        print(f"{what}: {TIMES} times over {self.runs} runs{worst}; {self.starved} ended by a busy machine")


@pytest.fixture
def bench(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Bench]:
    with Bench.at(tmp_path, seed=len(request.node.name)) as made:
        yield made


def test_a_killed_host_leaves_a_safe_drive_and_a_run_that_can_be_resumed(bench: Bench) -> None:
    done = 0
    while done < TIMES:
        process = bench.start()
        if not bench.wait_a_while(process):
            continue
        process.kill()
        killed_s = time.monotonic()
        process.communicate()
        bench.require_safe_since(killed_s)
        bench.require_points_kept()
        done += 1
    bench.finish()
    bench.report("host killed")


def test_a_stopped_host_leaves_a_safe_drive_and_ends_in_a_named_fault_when_it_goes_on(bench: Bench) -> None:
    done = 0
    while done < TIMES:
        process = bench.start()
        if not bench.wait_a_while(process):
            continue
        process.send_signal(signal.SIGSTOP)
        stopped_s = time.monotonic()
        energised = bench.machine.is_energised(stopped_s)
        time.sleep(0.5)
        bench.require_safe_since(stopped_s)
        armed = len(bench.machine.events("armed"))
        process.send_signal(signal.SIGCONT)
        _, errors = process.communicate(timeout=30)
        if energised and process.returncode != 0:
            assert process.returncode == 3, errors
            assert "drive fault heartbeat_lost" in errors
            assert len(bench.machine.events("armed")) == armed, "armed again by itself"
        bench.require_points_kept()
        done += 1
    bench.finish()
    bench.report("host stopped")


def require_named_end(bench: Bench, process: ForkedCommand, done_s: float) -> float | None:
    """The run ends in a lost link within a second; returns how long it took, None where it had just finished."""
    _, errors = process.communicate(timeout=30)
    if process.returncode == 0:
        return None
    assert process.returncode == 3, errors
    if "drive fault heartbeat_lost" in errors:  # it had ended before, on a busy machine
        bench.starved += 1
        return None
    assert "drive fault link_lost" in errors
    assert errors.count("\n") == 1, errors
    ended = messages_of(bench.run)[-1]
    assert isinstance(ended, RunEnded)
    assert ended.outcome == "faulted"
    took_s = (bench.run / "journal.jsonl").stat().st_mtime - done_s
    assert took_s <= ENDED_WITHIN_S, f"the run ended {took_s:.2f} s after the drive did"
    return took_s


def test_a_killed_drive_ends_the_run_in_a_named_fault_and_it_can_be_resumed(bench: Bench) -> None:
    took: list[float] = []
    while len(took) < TIMES:
        process = bench.start()
        if not bench.wait_a_while(process):
            continue
        bench.machine.send(signal.SIGKILL)
        seconds = require_named_end(bench, process, time.time())
        if seconds is not None:
            took.append(seconds)
        bench.require_points_kept()
        bench.restart_machine()
    bench.finish()
    bench.report(f"drive killed (run over after {max(took):.2f} s at worst)")


def test_a_stopped_drive_ends_the_run_in_a_named_fault_and_nothing_is_armed_again(bench: Bench) -> None:
    took: list[float] = []
    while len(took) < TIMES:
        process = bench.start()
        if not bench.wait_a_while(process):
            continue
        bench.machine.send(signal.SIGSTOP)
        stopped_s, energised = time.time(), bench.machine.is_energised(time.monotonic())
        seconds = require_named_end(bench, process, stopped_s)
        armed = len(bench.machine.events("armed"))
        bench.machine.send(signal.SIGCONT)
        if seconds is not None:
            took.append(seconds)
            if energised:
                wait_until(lambda: not bench.machine.is_energised(time.monotonic()), 2.0)
            assert len(bench.machine.events("armed")) == armed
        bench.require_points_kept()
    bench.finish()
    bench.report(f"drive stopped (run over after {max(took):.2f} s at worst)")
