"""Runs from the page: starting, answering, stopping; and what becomes of them when the server goes."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from protocols import Message, Note, OperatorAnswered, PointDone, RunEnded
from tests.plugins.commands.serve.served import Served, serving
from tests.support.processes import wait_until
from tests.support.tiny import MOTOR, messages_of, tiny_document

pytestmark = pytest.mark.timeout(150)

ASKING: list[dict[str, Any]] = [
    {"kind": "gates_off", "duration_s": 0.02},
    {"kind": "operator", "prompt": "Is the brake engaged?"},
    {"kind": "resistance", "points_a": [[1.0, 0.0] for _ in range(40)], "settle_s": 0.2, "duration_s": 0.05},
]


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    asking = tiny_document(stages=ASKING, drive={"realtime_factor": 1.0, "watchdog_s": 60.0})
    (tmp_path / "asking.yaml").write_text(yaml.safe_dump(asking))
    (tmp_path / "broken.yaml").write_text("stages: 5\n")
    (tmp_path / "motors").mkdir()
    (tmp_path / "motors" / "servo.yaml").write_text(yaml.safe_dump({"motor": MOTOR}))
    with serving(tmp_path) as served:
        yield served


def question_of(view: dict[str, Any]) -> dict[str, Any] | None:
    picture = view["picture"]
    return None if picture is None else picture["question"]


def is_armed(view: dict[str, Any]) -> bool:
    return bool(view["picture"] and view["picture"]["armed"])


def until_energised(served: Served, **wanted: Any) -> Path:
    """Start a run, answer its question, and wait for current; the run's directory."""
    assert served.post("/start", {"procedure": "asking.yaml", **wanted}).status == 200
    question = question_of(served.view_when(question_of))
    assert question is not None
    assert served.post("/answer", {"question": question["number"], "answer": "yes"}).status == 200
    view = served.view_when(lambda view: is_armed(view) and view["picture"]["points"][0] > 2)
    return served.folder / "runs" / str(view["picture"]["run"])


def ended_safely(run: Path) -> RunEnded:
    """How a run ended that had current at the request to stop."""
    wait_until(lambda: isinstance(messages_of(run)[-1], RunEnded), 60.0)
    messages = messages_of(run)
    assert "current ramped down, drive disarmed" in [m.text for m in messages if isinstance(m, Note)]
    ended = messages[-1]
    assert isinstance(ended, RunEnded)
    return ended


def answers(messages: list[Message]) -> list[OperatorAnswered]:
    return [message for message in messages if isinstance(message, OperatorAnswered)]


def test_a_run_is_started_requested_about_answered_and_stopped_by_two_browsers(served: Served) -> None:
    listed = served.get("/choices").content
    names = {one["name"]: one["problem"] for one in listed["procedures"]}
    assert names["asking.yaml"] == names["demo"] == ""
    assert "broken.yaml: format: missing; a procedure begins with `format: " in names["broken.yaml"]
    assert [one["name"] for one in listed["motors"]] == ["motors/servo.yaml"]

    wanted = {
        "procedure": "asking.yaml",
        "motor": "motors/servo.yaml",
        "serial": "SN-7",
        "operator": "Ada",
        "note": "-x",
    }
    assert served.post("/start", wanted).status == 200
    starting = next(served.views())
    assert (starting["going"], starting["subject"]) == (True, "asking.yaml · motors/servo.yaml")
    again = served.post("/start", wanted)
    assert again.status == 409
    assert "only one is possible at a time" in again.content["problem"]

    view = served.view_when(question_of)
    question = question_of(view)
    assert question is not None
    assert question["text"] == "Is the brake engaged?"
    assert not is_armed(view)
    assert question_of(served.view_when(question_of)) == question, "who comes later sees the same question"
    assert served.post("/answer", {"question": question["number"] + 1, "answer": "yes"}).status == 409
    assert served.post("/answer", {"question": question["number"], "answer": "yes"}).status == 200
    assert served.post("/answer", {"question": question["number"], "answer": "no"}).status == 409, "the first counts"

    armed = served.view_when(lambda view: is_armed(view) and view["picture"]["points"][0] > 2)["picture"]
    assert armed["points"][1] == 41
    assert armed["stage"].startswith("stage 3 of 3")
    assert "left" in armed["left"]
    assert len(armed["waveform"]["i_d_a"]) == len(armed["waveform"]["time_ms"]) > 10
    assert served.post("/stop", {}).status == 200
    over = served.view_when(lambda view: not view["going"])
    assert over["picture"]["outcome"]["ending"] == "aborted"
    run = served.folder / "runs" / over["picture"]["run"]
    assert ended_safely(run).reason == "stopped by a person at the page"
    (answered,) = answers(messages_of(run))
    assert (answered.answer, answered.by, answered.through) == ("yes", "operator", "page")

    (row,) = served.get("/choices").content["runs"]
    assert (row["run"], row["outcome"], row["serial"], row["operator"]) == (run.name, "aborted", "SN-7", "Ada")
    report = served.get(f"/report/{run.name}")
    assert report.status == 200
    assert report.headers["content-security-policy"].startswith("sandbox; default-src 'none'")


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on_at_the_first_point_not_done(served: Served) -> None:
    run = until_energised(served)
    assert served.post("/stop", {}).status == 200
    served.view_when(lambda view: not view["going"])
    done = sum(isinstance(message, PointDone) for message in messages_of(run))
    assert served.post("/resume", {"run": run.name}).status == 200
    view = served.view_when(lambda view: is_armed(view) and view["picture"]["points"][0] > done)
    assert view["picture"]["run"] == run.name
    assert served.post("/stop", {}).status == 200
    served.view_when(lambda view: not view["going"])
    ids = [message.id for message in messages_of(run) if isinstance(message, PointDone)]
    assert len(ids) == len(set(ids)) > done


@pytest.mark.slow
def test_when_the_server_is_killed_the_run_ramps_down_by_itself(served: Served) -> None:
    run = until_energised(served)
    served.process.kill()
    ended = ended_safely(run)
    assert (ended.outcome, ended.reason) == ("aborted", "the operator's page is gone")


@pytest.mark.slow
def test_when_the_server_hangs_the_run_ramps_down_by_itself(served: Served) -> None:
    run = until_energised(served, settings=["drive.realtime_factor=0.1"])
    served.process.send_signal(signal.SIGSTOP)
    try:
        ended = ended_safely(run)
    finally:
        served.process.send_signal(signal.SIGCONT)
    assert (ended.outcome, ended.reason) == ("aborted", "the operator's page has been silent for 10 s")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_run_and_then_the_server(number: signal.Signals, served: Served) -> None:
    run = until_energised(served)
    served.process.send_signal(number)
    _, errors = served.process.communicate(timeout=60)
    assert served.process.returncode == 0, errors
    assert ended_safely(run).reason == f"the page's server was ended by {number.name}"


@pytest.mark.slow
def test_a_browser_that_is_gone_while_a_question_is_open_leaves_it_open(served: Served) -> None:
    assert served.post("/start", {"procedure": "asking.yaml"}).status == 200
    views = served.views()
    question = question_of(next(view for view in views if question_of(view)))
    views.close()  # type: ignore[attr-defined]
    assert question_of(served.view_when(question_of)) == question
    assert served.post("/answer", {"question": question and question["number"], "answer": "no"}).status == 200
    over = served.view_when(lambda view: not view["going"])
    assert "answered no to: Is the brake engaged?" in over["problem"]


@pytest.mark.slow
def test_what_is_wrong_with_a_run_is_reported_before_and_after_it_is_started(served: Served) -> None:
    wanted = {"procedure": "asking.yaml", "settings": ["limits.current_a=-3"]}
    checked = served.post("/check", wanted)
    assert checked.status == 400
    assert "limits.current_a" in checked.content["problem"]
    assert served.post("/start", wanted).status == 200
    over = served.view_when(lambda view: not view["going"])
    assert over["picture"] is None
    assert "limits.current_a" in over["problem"]
    choices = served.get("/choices").content
    assert (choices["runs"], choices["unreadable"]) == ([], [])
    broken = served.folder / "runs" / "broken"
    broken.mkdir(parents=True)
    (broken / "run.json").write_text("{")
    (problem,) = served.get("/choices").content["unreadable"]
    assert "broken/run.json: broken JSON" in problem
