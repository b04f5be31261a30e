"""Ctrl-C in the middle of a diagnosis: exit code 130, with a report of what was found, else at once."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from orchestrator.diagnosis import load_diagnosis
from orchestrator.recording import open_recording
from protocols import StateChanged
from tests.support.cases import few
from tests.support.forking import ForkedCommand
from tests.support.processes import called, start_afresh, start_fluxbench, wait_until
from tests.support.tiny import STAGES, all_effects_but, messages_of, tiny_file

DATA = Path(__file__).parents[3] / "data" / "pm400-reduced"
EFFECT = """
import time
from pathlib import Path
from protocols import Correction, EffectLayer, EffectParameters, amplitude

class Mine:
    name = "mine"
    summary = signature = "mine"
    layer = EffectLayer.INVERTER
    needs = ()
    gauge = ""

    class Parameters(EffectParameters):
        offset_v: float = amplitude("V", typical=0.15, prior_width=0.3, low=-5.0, high=5.0)

    def correct(self, signals, p):
        Path({marker!r}).touch()
        time.sleep({seconds})
        while Path({marker!r}).with_name("hold").exists():
            time.sleep(0.01)
        return Correction()
"""
ENDING = "fluxbench: ending early with the result so far (Ctrl-C again ends at once)\n"


def interrupted(words: list[str | Path], marker: Path, times: int = 1) -> tuple[ForkedCommand, str, float]:
    """Start a command, interrupt it as soon as the effect is evaluated; returns its message and the time to its end."""
    process = start_fluxbench(*words)
    wait_until(lambda: marker.exists() or process.poll() is not None)
    began = time.monotonic()
    for _ in range(times):
        process.send_signal(signal.SIGINT)
        time.sleep(0.05)
    _, message = process.communicate(timeout=20)
    return process, message, time.monotonic() - began


def effect_that_takes(seconds: float, folder: Path) -> tuple[Path, Path]:
    mine, marker = folder / "mine.py", folder / "at-work"
    mine.write_text(EFFECT.format(marker=str(marker), seconds=seconds))
    return mine, marker


@few("seconds, times", [(0.01, 1), pytest.param(1e6, 1, marks=pytest.mark.slow), (1e6, 2)])
def test_ctrl_c_ends_a_search_at_once(seconds: float, times: int, tmp_path: Path) -> None:
    mine, marker = effect_that_takes(seconds, tmp_path)
    words: list[str | Path] = ["diagnose", DATA, "--effects", mine, "--out", tmp_path / "out"]
    process, message, took = interrupted(words, marker, times)
    assert (process.returncode, message) == (130, "fluxbench: interrupted\n")
    assert took < 1.5
    assert not (tmp_path / "out").exists()


def test_ctrl_c_after_a_first_answer_ends_with_a_report(tmp_path: Path) -> None:
    mine, _ = effect_that_takes(0.003, tmp_path)
    out = tmp_path / "out"
    process = start_fluxbench("diagnose", DATA, "--effects", mine, "--out", out)
    wait_until(lambda: "so far: " in process.printed_so_far() or process.poll() is not None)
    process.send_signal(signal.SIGINT)
    printed, message = process.communicate(timeout=120)
    assert (process.returncode, message) == (130, ENDING)
    assert "so far: no effect found; the model alone explains the part of the recording" in printed
    assert "  ended early by the user: the search was not finished\n" in printed
    kept = load_diagnosis(out)
    assert kept is not None
    assert kept.report.remarks[0].code == "ended_early"
    assert (out / "model.json").exists()


@pytest.mark.slow
def test_so_it_does_with_json_where_the_first_answer_is_on_standard_error(tmp_path: Path) -> None:
    mine, _ = effect_that_takes(0.003, tmp_path)
    process = start_afresh("diagnose", DATA, "--effects", mine, "--out", tmp_path / "out", "--json")
    assert process.stderr is not None
    assert any(line.startswith("so far: ") for line in iter(process.stderr.readline, ""))
    process.send_signal(signal.SIGINT)
    printed, message = process.communicate(timeout=120)
    assert (process.returncode, message) == (130, ENDING)
    assert json.loads(printed)["reasons"][0]["quantity"] == "ended_early"


def test_a_second_ctrl_c_ends_at_once_without_a_report(tmp_path: Path) -> None:
    mine, _ = effect_that_takes(0.003, tmp_path)
    process = start_fluxbench("diagnose", DATA, "--effects", mine, "--out", tmp_path / "out")
    wait_until(lambda: "so far: " in process.printed_so_far() or process.poll() is not None)
    (tmp_path / "hold").touch()
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    assert process.poll() is None
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=20)
    assert (process.returncode, message) == (130, f"{ENDING}fluxbench: interrupted\n")
    assert time.monotonic() - began < 1.5
    assert not (tmp_path / "out").exists()


def test_ctrl_c_anywhere_else_is_one_line_too() -> None:
    code = (
        "from orchestrator.interface.cli import _inspect, _running\n"
        "def raising(*_):\n    raise KeyboardInterrupt\n"
        "_inspect.procedures = raising\nraise SystemExit(_running.run_app(['procedures']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (130, "fluxbench: interrupted\n")


@pytest.mark.slow
def test_a_signal_while_diagnosing_ends_the_run_and_keeps_the_recording(tmp_path: Path) -> None:
    run = tmp_path / "run"
    others = all_effects_but("dead_time", "voltage_bias")
    stages = [*STAGES[:-1], {"kind": "diagnose", "rounds": 0, "without": others}]
    process = start_fluxbench("run", tiny_file(tmp_path, stages=stages), "--out", run)
    wait_until(lambda: diagnosing(run) or process.poll() is not None)
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=30)
    assert process.returncode == 130, message
    assert "signal SIGINT" in message
    assert time.monotonic() - began < 6.0
    assert len(open_recording(run).segments()) > 10
    assert not (run / "results" / "diagnosis.json").exists()
    assert called("resume", run, "--quiet").returncode == 0
    assert (run / "results" / "diagnosis.json").exists()


def diagnosing(run: Path) -> bool:
    if not (run / "journal.jsonl").exists():
        return False
    return any(isinstance(message, StateChanged) and message.target == "diagnosing" for message in messages_of(run))
