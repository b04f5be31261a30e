"""A page's view of a run: its state, whole each time, in numbers and texts that a page can show."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.testing._messages import POINTS, a_run
from plugins.streams.remote import RemoteOptions, RemoteStream
from plugins.streams.remote._picture import Picture
from protocols import (
    Capture,
    NoOptions,
    Note,
    OperatorAnswered,
    OperatorAsked,
    SamplesCaptured,
    StateChanged,
    StreamSetup,
)

FS = 10_000.0


def block(values: np.ndarray[Any, Any]) -> SamplesCaptured:
    v_dc = np.full(len(values), 540.0)
    capture = Capture(start_s=0.0, sampling_frequency_hz=FS, i_ab=values, v_ab=0.0 * values, v_dc=v_dc)
    return SamplesCaptured(segment="injection-000", rotor_angle_rad=0.0, capture=capture)


def test_a_question_is_open_from_its_asking_to_its_answer(tmp_path: Path) -> None:
    picture = Picture(tmp_path / "run")
    assert picture.drawn()["question"] is None
    picture.take(OperatorAsked(prompt="Engage the brake \x1b[2J"))
    question = picture.drawn()["question"]
    assert question == {"number": 1, "prompt": "Engage the brake \x1b[2J", "text": "Engage the brake \\u001b[2J"}
    picture.take(OperatorAnswered(answer="yes", by="operator", through="page"))
    assert picture.drawn()["question"] is None
    assert picture.drawn()["log"] == [("info", "answered: yes (by operator, through the page)")]
    picture.take(OperatorAsked(prompt="Engage the brake"))
    assert picture.drawn()["question"]["number"] == 2


@pytest.mark.parametrize(("state", "armed"), [("sweeping_injection", True), ("waiting_for_operator", False)])
def test_a_drive_is_armed_in_the_states_in_which_stages_measure(state: str, armed: bool, tmp_path: Path) -> None:
    picture = Picture(tmp_path / "run")
    picture.take(StateChanged(source="connecting", target=state))
    assert picture.drawn()["armed"] is armed


def test_a_waveform_keeps_its_peaks_however_long_it_is(tmp_path: Path) -> None:
    i_ab = np.zeros((5000, 2))
    i_ab[1234, 0], i_ab[4321, 1] = 7.5, -3.25
    picture = Picture(tmp_path / "run")
    picture.take(block(i_ab))
    wave = picture.drawn()["waveform"]
    assert max(wave["i_d_a"]) == 7.5
    assert min(wave["i_q_a"]) == -3.25
    assert len(wave["time_ms"]) == len(wave["i_d_a"]) == len(wave["i_q_a"]) <= 500
    assert wave["time_ms"] == sorted(wave["time_ms"])
    assert wave["time_ms"][-1] == pytest.approx(1e3 * len(i_ab) / FS, rel=0.02)


def test_the_log_keeps_the_latest_lines(tmp_path: Path) -> None:
    picture = Picture(tmp_path / "run", lines=3)
    for number in range(5):
        picture.take(Note(level="warning", text=f"note {number}"))
    assert [line for _, line in picture.drawn()["log"]] == ["warning: note 2", "warning: note 3", "warning: note 4"]


def test_the_last_line_of_a_run_has_all_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    output = io.StringIO()
    monkeypatch.setattr(sys, "stdout", output)
    stream = RemoteStream(StreamSetup(run=tmp_path / "run", options=RemoteOptions(every_s=3600.0)))
    messages = a_run(tmp_path / "run")
    for message in messages:
        stream.receive(message)
    stream.close()
    lines = [json.loads(line) for line in output.getvalue().splitlines()]
    assert len(lines) < len(messages)
    last = lines[-1]
    assert last["outcome"]["ending"] == "finished"
    assert [POINTS, POINTS] in [line["points"] for line in lines]
    assert last["verdict"]["slots"]
    assert last["flux"]["points"]


def test_once_nobody_reads_any_longer_the_rest_passes_in_silence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Closed(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stdout", Closed())
    stream = RemoteStream(StreamSetup(run=tmp_path / "run", options=NoOptions()))
    with pytest.raises(BrokenPipeError):
        stream.receive(Note(level="info", text="one"))
    stream.receive(Note(level="info", text="two"))
    stream.close()
