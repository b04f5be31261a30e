"""The console says what matters, in plain lines or live, and survives its terminal."""

from __future__ import annotations

import errno
import io
import itertools
import json
import re
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from orchestrator.formatting.events import DISARMED_WHILE
from orchestrator.formatting.sentences import visible
from orchestrator.testing._messages import MOTOR, a_run, one_of_each, points_done
from plugins.streams.console import ConsoleOptions, ConsoleStream
from plugins.streams.console._progress import Progress
from plugins.streams.console._words import time_left
from protocols import (
    EstimationReport,
    Limits,
    Message,
    Note,
    OperatorAnswered,
    OperatorAsked,
    PointStarted,
    RunEnded,
    RunStarted,
    StageStarted,
    StateChanged,
    StreamSetup,
    UnderWay,
)

ESCAPE = "\x1b"
HOSTILE = "\x1b]0;owned\x07\x9b2J\u202egnp.\r\t\x00"


class Output(io.StringIO):
    """A standard output that may be a terminal, and may break."""

    def __init__(self, terminal: bool = False) -> None:
        super().__init__()
        self.terminal, self.broken = terminal, False

    def isatty(self) -> bool:
        return self.terminal

    def write(self, text: str) -> int:
        if self.broken:
            raise OSError(errno.EIO, "the terminal is gone")
        return super().write(text)


def listen(monkeypatch: pytest.MonkeyPatch, run: Path, output: io.TextIOBase, mode: str = "auto") -> ConsoleStream:
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    return ConsoleStream(StreamSetup(run=run, options=ConsoleOptions.model_validate({"mode": mode})))


def printed(monkeypatch: pytest.MonkeyPatch, run: Path, messages: list[Message], **how: Any) -> str:
    output = Output(how.pop("terminal", False))
    stream = listen(monkeypatch, run, output, **how)
    for message in messages:
        if message.kind != "samples_captured":
            stream.receive(message)
    stream.close()
    return output.getvalue()


def ending(**estimates: Any) -> RunEnded:
    report = EstimationReport.model_validate(estimates)
    return RunEnded(outcome="finished", reason="every stage is done", run="runs/demo", estimates=report)


def displays() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name == "console display"]


def test_not_a_terminal_gets_plain_lines_without_escape_codes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    text = printed(monkeypatch, tmp_path, a_run(tmp_path))
    assert ESCAPE not in text
    assert "\r" not in text
    assert "stage 1 of 1, the kit's sweep: begins, 20 points" in text
    assert "stage 1 of 1, the kit's sweep: 20 points in" in text
    assert "R_s: 4.310 Ω (95 %: 4.300 to 4.320)" in text
    assert "warning: the bus sags by 2 %" in text
    assert "outcome     finished: all stages are done" in text


def test_plain_progress_comes_every_tenth_or_every_few_seconds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    stream = listen(monkeypatch, tmp_path, output := Output())
    ticks = itertools.count(0.0, 0.2)
    stream._progress.clock = lambda: next(ticks)
    messages = list(points_done(tmp_path, 20))
    for message in messages:
        stream.receive(message)
    lines = [line for line in output.getvalue().splitlines() if "%" in line]
    assert 5 <= len(lines) <= 10
    assert lines[0].startswith("  5%  1 of 20 points")


def test_plain_progress_is_not_reported_for_each_of_many_quick_points(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stream = listen(monkeypatch, tmp_path, output := Output())
    stream._progress.clock = lambda: 7.0
    for message in points_done(tmp_path, 20):
        stream.receive(message)
    assert len(output.getvalue().splitlines()) == 1


def test_stages_without_points_are_counted_too_and_say_what_is_under_way(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stream = listen(monkeypatch, tmp_path, output := Output())
    now = [0.0]
    stream._progress.clock = lambda: now[0]
    messages: list[tuple[float, Message]] = [
        (0.0, StageStarted(index=10, stage="estimate", points=0)),
        (0.0, StateChanged(source="measuring", target="stopping", reason=f"{DISARMED_WHILE} the computer works")),
        (2.0, StageStarted(index=11, stage="diagnose", points=0)),
        (2.1, UnderWay(text="trying dead time (some 40 s more)")),
        (2.2, UnderWay(text="trying bus sag (some 40 s more)")),
        (9.0, UnderWay(text="so far: dead time", is_result=True)),
        (9.1, UnderWay(text="trying bus sag (some 30 s more)")),
        (12.0, RunEnded(outcome="finished", reason="", run="runs/demo")),
    ]
    for at, message in messages:
        now[0] = at
        stream.receive(message)
    assert [line for line in output.getvalue().splitlines() if "outcome" not in line and line][:-1] == [
        "stage 11, estimate: begins",
        "pausing: the drive is disarmed while the computer works",
        "stage 11, estimate: done in 2 s",
        "stage 12, diagnose: begins",
        "  trying dead time (some 40 s more)",
        "so far: dead time",
        "  trying bus sag (some 30 s more)",
    ]


def test_stages_are_counted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert "stage 1 of 1, the kit's sweep" in printed(monkeypatch, tmp_path, a_run(tmp_path))


def test_faults_and_their_reason_are_reported_in_plain_lines(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    reason = "drive fault overcurrent: 9 A"
    messages: list[Message] = [
        StateChanged(source="sweeping_injection", target="stopping", reason=reason),
        RunEnded(outcome="faulted", reason=reason, run="runs/demo"),
    ]
    text = printed(monkeypatch, tmp_path, messages)
    assert f"stopping: {reason}" in text
    assert f"faulted: {reason}" in text


def test_summary_is_a_table_of_what_was_estimated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    end = ending(
        resistance={"value_ohm": 4.312345, "low": 4.305, "high": 4.32, "first_ohm": 4.3, "last_ohm": 4.32},
        method="injection",
        crossings={"d_percent": 0.41, "q_percent": None},
        parity=None,
        reciprocity_percent=None,
        classical_against_injection_percent=None,
        usable=False,
        reasons=["the rotor turned", "too few points"],
        files={"estimates": "estimates.json", "flux_map": "flux_map.nc"},
    )
    lines = printed(monkeypatch, tmp_path, [end]).splitlines()
    assert "R_s         4.312 Ω (95 %: 4.305 to 4.320)" in lines
    assert "crossings   d 0.41 %" in lines
    assert "map usable  no" in lines
    assert lines[lines.index("remarks     the rotor turned") + 1] == "            too few points"
    there = tmp_path / "results"
    assert lines.index(f"flux_map    {there}/flux_map.nc") < lines.index(f"estimates   {there}/estimates.json")


def test_quiet_says_warnings_errors_and_a_bad_end_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert printed(monkeypatch, tmp_path, a_run(tmp_path), mode="quiet") == "warning: the bus sags by 2 %\n"
    bad = RunEnded(outcome="aborted", reason="the operator stated no", run="runs/demo")
    assert printed(monkeypatch, tmp_path, [bad], mode="quiet") == "aborted: the operator stated no\n"


def test_json_is_one_message_a_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    messages: list[Message] = [m for m in one_of_each(tmp_path) if m.kind != "samples_captured"]
    lines = printed(monkeypatch, tmp_path, messages, mode="jsonl").splitlines()
    assert [json.loads(line)["kind"] for line in lines] == [m.kind for m in messages]


def test_an_output_without_unicode_gets_plain_ascii(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    raw = io.BytesIO()
    output = io.TextIOWrapper(raw, encoding="ascii")
    stream = listen(monkeypatch, tmp_path, output)
    for message in one_of_each(tmp_path):
        stream.receive(message)
    assert b"R_s: 4.310 ohm" in raw.getvalue()
    monkeypatch.undo()


def test_control_characters_in_names_never_reach_the_terminal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    hostile = "motor\x1b[2J\r\nRUN FINISHED"
    messages: list[Message] = [
        RunStarted(
            run=str(tmp_path),
            name="demo",
            motor=MOTOR.model_copy(update={"name": hostile}),
            limits=Limits(current_a=1.0, voltage_v=1.0),
            drive="simulated",
            stages=1,
            points=1,
            points_done=0,
            seconds=1.0,
        ),
        Note(level="error", text=hostile),
    ]
    assert ESCAPE not in printed(monkeypatch, tmp_path, messages)
    assert f"{ESCAPE}[2J" not in printed(monkeypatch, tmp_path, messages, terminal=True)


def test_a_terminal_gets_a_live_display_with_stage_bar_time_and_currents(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    text = printed(monkeypatch, tmp_path, a_run(tmp_path), terminal=True)
    assert ESCAPE in text
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    for wanted in (
        "sweeping kit  stage 1 of 1, the kit's sweep, point 1 of 20",
        "1/20 points",
        "left",
        "(+1.000, −0.500) A",
        "(+0.980, −0.510) A",
        "✓ stage 1 of 1, the kit's sweep, 20 points",
        "✓ R_s: 4.310 Ω",
        "finished: all stages are done",
    ):
        assert wanted in plain, wanted


def test_cursor_is_shown_again_after_the_end(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    text = printed(monkeypatch, tmp_path, a_run(tmp_path)[:-1], terminal=True)
    assert text.count(f"{ESCAPE}[?25l") == text.count(f"{ESCAPE}[?25h") > 0


def test_live_display_stands_still_while_the_operator_is_requested(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stream = listen(monkeypatch, tmp_path, output := Output(terminal=True))
    for message in a_run(tmp_path)[:6]:
        if message.kind != "samples_captured":
            stream.receive(message)
    assert displays()
    stream.receive(OperatorAsked(prompt="Engage the brake."))
    assert not displays()
    assert output.getvalue().endswith(f"{ESCAPE}[2K")
    length = len(output.getvalue())
    assert f"{ESCAPE}[?25h" in output.getvalue()
    stream.receive(Note(level="info", text="still waiting"))
    assert "still waiting" in output.getvalue()[length:]
    assert not displays()
    stream.receive(OperatorAnswered(answer="yes", by="operator"))
    assert displays()
    stream.close()
    assert not displays()


def test_live_display_is_gone_while_paused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    stream = listen(monkeypatch, tmp_path, Output(terminal=True))
    stream.receive(a_run(tmp_path)[0])
    stream.receive(StateChanged(source="stopping", target="paused"))
    assert not displays()
    stream.receive(StateChanged(source="paused", target="sweeping_injection"))
    assert displays()
    stream.close()


@pytest.mark.parametrize("terminal", [True, False])
def test_a_terminal_that_goes_away_is_reported_once_and_then_passed_over(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, terminal: bool
) -> None:
    stream = listen(monkeypatch, tmp_path, output := Output(terminal))
    messages = [m for m in a_run(tmp_path) if m.kind not in ("samples_captured", "point_done")]
    stream.receive(messages[0])
    output.broken = True
    raised = 0
    for message in messages[1:]:
        try:
            stream.receive(message)
        except OSError:
            raised += 1
    stream.close()
    assert raised == 1
    assert not displays()


def test_time_left_follows_the_pace_of_the_wall() -> None:
    now = [100.0]
    progress = Progress(clock=lambda: now[0])
    progress.points, progress.left_s = 10, 50.0
    assert time_left(progress) == "50 s of measuring left, on the drive's clock"
    progress.take(PointStarted(id="p", stage_index=0, target_d_a=None, target_q_a=None, seconds=5.0))
    now[0] += 0.5
    progress.take(next(points_done(Path("run"), 1)).model_copy(update={"seconds_left": 45.0}))
    assert progress.wall_left_s == pytest.approx(4.5)
    assert time_left(progress) == "4 s of measuring left (45 s on the drive's clock)"


def test_time_left_is_reported_once_where_drive_and_wall_agree() -> None:
    progress = Progress(points=10, left_s=90.0, drive_s=10.0, measuring_s=10.5)
    assert time_left(progress) == "94 s of measuring left"


def test_a_stage_ends_with_the_next_or_with_a_stop() -> None:
    progress = Progress()
    progress.take(StageStarted(index=0, stage="gates_off", points=1))
    progress.take(StageStarted(index=1, stage="resistance", title="stator resistance", points=3))
    assert progress.finished is not None
    assert progress.finished.name == "gates off"  # a run of old has no titles
    progress.take(StateChanged(source="estimating_resistance", target="stopping"))
    assert progress.finished is not None
    assert progress.finished.name == "stator resistance"
    progress.take(Note(level="info", text=""))
    assert progress.finished is None


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(ValidationError, match="mode"):
        ConsoleOptions.model_validate({"mode": "loud"})


def with_hostile_texts(value: Any) -> Any:
    """The message as it is, with every free text in it replaced."""
    if isinstance(value, BaseModel):
        changed = value
        for name, held in value:
            replaced = with_hostile_texts(held)
            if replaced is not held:
                with suppress(ValidationError):  # a kind, an outcome: no free text
                    changed = type(value).model_validate({**dict(changed), name: replaced})
        return changed
    return HOSTILE * 3 if isinstance(value, str) else value


@pytest.mark.parametrize("mode", ["plain", "quiet", "jsonl", "live"])
def test_nothing_that_a_message_holds_is_obeyed_by_the_terminal(mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    output = Output(terminal=mode == "live")
    monkeypatch.setattr(sys, "stdout", output)
    stream = ConsoleStream(StreamSetup(run=Path("run"), options=ConsoleOptions.model_validate({"mode": mode})))
    for message in one_of_each(Path("run")):
        stream.receive(with_hostile_texts(message))
    stream.close()
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", output.getvalue())  # the live display's own styling
    assert "owned" in shown
    allowed = "\n\r" if mode == "live" else "\n"
    obeyed = [char for char in shown if visible(char) != char and char not in allowed]
    assert not obeyed, obeyed
