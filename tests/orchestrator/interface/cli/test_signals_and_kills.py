"""Runs as processes: signals at every stage, kill -9 at any instant, a disk that is full."""

from __future__ import annotations

import random
import shlex
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from orchestrator.recording import open_recording
from orchestrator.runs import RunDirectory
from protocols import Note, PointDone, RunEnded, StateChanged
from tests.support.processes import FLUXBENCH, called, start_fluxbench, wait_until
from tests.support.tiny import STAGES, messages_of, run_tiny, tiny_file

STATES = (
    "reading_gates_off",
    "aligning",
    "checking_lock",
    "estimating_resistance",
    "sweeping_classical",
    "sweeping_injection",
)


def reached(run: Path, state: str) -> bool:
    journal = run / "journal.jsonl"
    if not journal.exists() or f'"{state}"' not in journal.read_text(encoding="utf-8"):
        return False  # looked for again and again: what is not in the text need not be decoded
    return any(isinstance(message, StateChanged) and message.target == state for message in messages_of(run))


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.slow
def test_a_signal_at_any_stage_ends_the_run_disarmed(state: str, number: signal.Signals, tmp_path: Path) -> None:
    signalled_at(state, number, tmp_path)


def test_a_signal_ends_the_run_disarmed(tmp_path: Path) -> None:
    signalled_at("sweeping_classical", signal.SIGTERM, tmp_path)


def signalled_at(state: str, number: signal.Signals, tmp_path: Path) -> None:
    run = tmp_path / "run"
    process = start_fluxbench("run", tiny_file(tmp_path, drive={"realtime_factor": 2.0}), "--out", run)
    wait_until(lambda: reached(run, state) or process.poll() is not None)
    process.send_signal(number)
    _, message = process.communicate(timeout=30)
    assert process.returncode == 130, message
    assert f"signal {number.name}" in message
    messages = messages_of(run)
    assert any(m.text == "current ramped down, drive disarmed" for m in messages if isinstance(m, Note))
    ended = messages[-1]
    assert isinstance(ended, RunEnded)
    assert (ended.outcome, ended.reason) == ("aborted", f"signal {number.name}")


def test_ctrl_z_disarms_before_the_process_stops_and_fg_goes_on(tmp_path: Path) -> None:
    run = tmp_path / "run"
    procedure = tiny_file(tmp_path, drive={"realtime_factor": 4.0}, stages=STAGES[:-1])
    process = start_fluxbench("run", procedure, "--out", run)
    wait_until(lambda: reached(run, "checking_lock"))
    process.send_signal(signal.SIGTSTP)
    wait_until(lambda: Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "T")
    changes = [m.target for m in messages_of(run) if isinstance(m, StateChanged)]
    assert changes[-2:] == ["stopping", "paused"]
    process.send_signal(signal.SIGCONT)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 0, message


def maps_of(run: Path) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    with xr.open_dataset(run / "results" / "flux_map.nc", engine="h5netcdf") as found:
        return {name: found[name].to_numpy() for name in ("psi_d", "psi_q", "l_dd", "l_qq")}


def start_and_kill(words: tuple[str | Path, ...], run: Path, rng: random.Random) -> int:
    """Kill a command at a random instant of its run; returns its exit code."""
    process = start_fluxbench(*words)
    wait_until(lambda: (run / "run.json").exists() or process.poll() is not None)
    try:
        process.wait(rng.uniform(0.1, 1.6))
    except subprocess.TimeoutExpired:
        process.kill()
    _, message = process.communicate()
    assert process.returncode in (0, -signal.SIGKILL), message
    return process.returncode


def kill_and_resume_until_done(procedure: Path, run: Path, kills: int, rng: random.Random) -> int:
    """Kill a run at random instants until it has been killed so often; returns the kills that it took."""
    done = 0
    words: tuple[str | Path, ...] = ("run", procedure, "--out", run)
    while done < kills:
        code = start_and_kill(words, run, rng)
        if code == 0:
            return done
        done += 1
        words = ("resume", run)
    last = called(*words)
    assert last.returncode == 0, last.stderr
    return done


def killed_run_is_whole(tmp_path: Path, kills: int, seed: int) -> None:
    procedure = tiny_file(tmp_path, drive={"realtime_factor": 1.5})
    killed = tmp_path / "killed"
    assert kill_and_resume_until_done(procedure, killed, kills, random.Random(seed)) > 0
    whole = run_tiny(tmp_path).path
    ids = [message.id for message in messages_of(killed) if isinstance(message, PointDone)]
    expected = [segment.id for segment in open_recording(whole).segments()]
    assert sorted(ids) == sorted(expected)
    recording = open_recording(killed)
    assert sorted(segment.id for segment in recording.segments()) == sorted(expected)
    for segment in recording.segments():
        recording.load(segment)
    assert not [path for path in killed.rglob("*") if "partial" in path.name]
    assert {path.stem for path in (killed / "captures").iterdir()} == set(expected)
    mine, reference = maps_of(killed), maps_of(whole)
    for name, values in reference.items():
        scale = np.nanmax(np.abs(values))
        np.testing.assert_allclose(mine[name], values, atol=2e-3 * scale, err_msg=name)


@pytest.mark.usefixtures("undrawn")
def test_a_run_that_was_killed_is_whole_after_resuming(tmp_path: Path) -> None:
    killed_run_is_whole(tmp_path, kills=1, seed=1)


@pytest.mark.slow
def test_a_run_that_was_killed_at_twenty_random_instants_is_whole_after_resuming(tmp_path: Path) -> None:
    killed_run_is_whole(tmp_path, kills=20, seed=2)


@pytest.mark.slow
def test_an_estimate_of_a_killed_run_needs_no_resume(tmp_path: Path) -> None:
    run = tmp_path / "run"
    process = start_fluxbench("run", tiny_file(tmp_path, drive={"realtime_factor": 2.0}), "--out", run)
    wait_until(lambda: reached(run, "sweeping_classical"))
    process.kill()
    process.communicate()
    done = called("estimate", run, "--estimator", "resistance", "--json")
    assert done.returncode == 0, done.stderr
    assert len(open_recording(run).segments()) == len(RunDirectory.open(run).completed())


@pytest.mark.slow
def test_a_full_disk_ends_the_run_safely_and_keeps_what_was_measured(tmp_path: Path) -> None:
    run = tmp_path / "run"
    procedure = tiny_file(tmp_path, stages=None)
    command = shlex.join([FLUXBENCH, "run", str(procedure), "--out", str(run), "--quiet"])
    # A limit on the size of a file stands in for the full disk: the classical sweep is the first to pass it.
    done = subprocess.run(
        ["bash", "-c", f"ulimit -f 40; exec {command}"], capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    assert done.returncode == 3, done.stderr
    assert done.stderr.count("\n") == 1
    assert "classical-000" in done.stderr
    assert [segment.stage.value for segment in open_recording(run).segments()][-1] == "resistance"
    notes = [message.text for message in messages_of(run) if isinstance(message, Note)]
    own = [text for text in notes if not text.startswith("stream ")]
    assert own[-1] == "current ramped down, drive disarmed"
