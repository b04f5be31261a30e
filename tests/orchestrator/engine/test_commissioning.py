"""Runs from the first stage to the end, and every way out on the way, on the simulated drive."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from orchestrator.engine import AbsentOperator, Interrupts, RunServices, resume_run, table_of
from orchestrator.recording import open_recording
from orchestrator.runs import RunDirectory
from orchestrator.stages import installed_stages
from plugins.drives.simulated import SimulatedDrive
from protocols import (
    DriveFault,
    DriveState,
    LockChecked,
    Note,
    OperatorAnswered,
    PluginError,
    PointDone,
    RecordingError,
    RunAborted,
    RunEnded,
    StateChanged,
    Telemetry,
)
from tests.support.cases import few
from tests.support.tiny import STAGES, messages_of, run_tiny

FIRST_EXCITATIONS = {
    "gates_off": 1,
    "alignment": 2,
    "lock_check": 3,
    "resistance": 8,
    "classical": 12,
    "injection": 14,
}
"""Number of the first excitation in each stage of the tiny procedure."""

OF_MANY_SECONDS: list[dict[str, Any]] = [
    {"kind": "adaptive"},
    {"kind": "steps"},
    {"kind": "operator", "prompt": "Release the brake", "answer": "yes", "brake": "release"},
    {"kind": "spin"},
]
"""What the tiny procedure has not: a run that is stopped in one of them has no time to take them all."""

FAULTS: list[dict[str, Any]] = [
    {"kind": "trip", "cause": "overcurrent"},
    {"kind": "lost_link"},
    {"kind": "stuck", "timeout_s": 0.05},
    {"kind": "wrong_data", "data": "huge"},
    {"kind": "wrong_data", "data": "shape"},
    {"kind": "exception"},
]


@pytest.fixture
def at_close(monkeypatch: pytest.MonkeyPatch) -> list[Telemetry | DriveFault]:
    """What each drive says of itself just before it is let go of."""
    seen: list[Telemetry | DriveFault] = []
    close = SimulatedDrive.close

    def look_and_close(self: SimulatedDrive) -> None:
        try:
            seen.append(self.telemetry())
        except DriveFault as fault:
            seen.append(fault)
        close(self)

    monkeypatch.setattr(SimulatedDrive, "close", look_and_close)
    return seen


def assert_safe(seen: list[Telemetry | DriveFault]) -> None:
    (telemetry,) = seen
    assert isinstance(telemetry, Telemetry)
    assert telemetry.state is not DriveState.ARMED
    assert abs(telemetry.i_d_a) + abs(telemetry.i_q_a) < 0.05


def states(path: Path) -> list[str]:
    return [message.target for message in messages_of(path) if isinstance(message, StateChanged)]


def points_done(path: Path) -> list[str]:
    return [message.id for message in messages_of(path) if isinstance(message, PointDone)]


class StopAtCheck(Interrupts):
    """Asks for a stop the n-th time that the engine looks."""

    def __init__(self, n: int) -> None:
        super().__init__()
        self.left = n

    def check(self) -> None:
        self.left -= 1
        if self.left == 0:
            self.stop("enough")
        super().check()


class StopAtState(Interrupts):
    """Asks for a stop once the journal says that the run is in a state."""

    def __init__(self, run: Path, state: str) -> None:
        super().__init__()
        self._run, self._state = run, state

    def check(self) -> None:
        if (self._run / "journal.jsonl").exists() and states(self._run)[-1:] == [self._state]:
            self.stop(f"seen in {self._state}")
        super().check()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that went through without a hitch."""
    result = run_tiny(tmp_path_factory.mktemp("whole"))
    assert result.outcome.error is None, result.outcome
    return result.path


def test_a_run_goes_through_every_stage_and_rests_between_them(whole: Path) -> None:
    assert states(whole) == [
        "connecting",
        "reading_gates_off",
        "stopping",
        "waiting_for_operator",
        "aligning",
        "stopping",
        "waiting_for_operator",
        "checking_lock",
        "stopping",
        "estimating",
        "estimating_resistance",
        "sweeping_classical",
        "sweeping_injection",
        "stopping",
        "estimating",
        "stopping",
        "finished",
    ]


def test_a_run_is_a_recording_with_every_planned_point(whole: Path) -> None:
    recording = open_recording(whole)
    ids = [segment.id for segment in recording.segments()]
    assert ids == points_done(whole)
    assert len(ids) == 1 + 1 + 5 + 4 + 2 + 6
    for segment in recording.segments():
        assert len(recording.load(segment)) == segment.samples


def test_a_run_says_what_it_found(whole: Path) -> None:
    messages = messages_of(whole)
    (lock,) = [m for m in messages if isinstance(m, LockChecked)]
    assert lock.locked
    assert lock.confidence > 0.95
    ended = messages[-1]
    assert isinstance(ended, RunEnded)
    assert ended.outcome == "finished"
    assert ended.estimates is not None
    assert ended.estimates.resistance is not None
    assert ended.estimates.resistance.value_ohm == pytest.approx(4.25, rel=0.1)
    assert (whole / "results" / "flux_map.nc").is_file()


def test_a_directory_that_is_taken_is_not_touched(whole: Path) -> None:
    before = sorted(whole.rglob("*"))
    with pytest.raises(RecordingError, match="not empty"):
        run_tiny(whole.parent)
    assert sorted(whole.rglob("*")) == before


@pytest.mark.parametrize(
    ("fault", "stage"),
    [
        # Each fault at two stages and each stage with two faults; every fault at every stage where there is time.
        pytest.param(
            fault,
            stage,
            marks=() if (k - n) % 3 == 0 else pytest.mark.slow,
            id=f"{'-'.join(map(str, fault.values()))}-{stage}",
        )
        for k, fault in enumerate(FAULTS)
        for n, stage in enumerate(FIRST_EXCITATIONS)
    ],
)
def test_a_drive_that_fails_at_any_stage_is_left_safe_and_its_points_are_kept(
    fault: dict[str, Any], stage: str, tmp_path: Path, at_close: list[Telemetry | DriveFault]
) -> None:
    number = FIRST_EXCITATIONS[stage]
    result = run_tiny(tmp_path, drive={"faults": [{**fault, "at_excitation": number}]})
    assert result.outcome.ending == "faulted"
    assert isinstance(result.outcome.error, DriveFault)
    assert states(result.path)[-2:] == ["stopping", "faulted"]
    ended = messages_of(result.path)[-1]
    assert isinstance(ended, RunEnded)
    assert str(result.outcome.error) in ended.reason
    done = points_done(result.path)
    assert len(done) == number - 1
    if done:
        recording = open_recording(result.path)
        assert [segment.id for segment in recording.segments()] == done
    assert not list((result.path / "captures").glob("*partial*"))
    if fault["kind"] != "lost_link":
        assert_safe(at_close)
    else:
        words = [m.text for m in messages_of(result.path) if isinstance(m, Note)][-1]
        assert "watchdog makes it safe" in words


@few("state", table_of(installed_stages()).energised, fast=3)
def test_a_stop_at_any_stage_ramps_down_and_disarms(
    state: str, tmp_path: Path, at_close: list[Telemetry | DriveFault]
) -> None:
    stop = StopAtState(tmp_path / "run", state)
    result = run_tiny(tmp_path, interrupts=stop, stages=[*STAGES[:-1], *OF_MANY_SECONDS])
    assert result.outcome.ending == "aborted"
    assert result.outcome.reason == f"seen in {state}"
    assert states(result.path)[-3:] == [state, "stopping", "aborted"]
    assert any(m.text == "current ramped down, drive disarmed" for m in messages_of(result.path) if isinstance(m, Note))
    assert_safe(at_close)


def stopped_and_resumed(folder: Path, check: int) -> Path:
    """A run that was stopped when the engine looked for the `check`-th time, and then resumed."""
    result = run_tiny(folder, interrupts=StopAtCheck(check), stages=STAGES[:-1])
    assert result.outcome.ending == "aborted"
    result = resume_run(result.path, RunServices(AbsentOperator(), Interrupts()))
    assert result.outcome.ending == "finished"
    return result.path


def slowly(check: int) -> Any:
    return pytest.param(check, marks=pytest.mark.slow)


@pytest.mark.parametrize("check", [slowly(4), 11, 16, slowly(23), slowly(29), slowly(35)])
def test_a_resumed_run_has_every_point_once(check: int, tmp_path: Path, whole: Path) -> None:
    path = stopped_and_resumed(tmp_path, check)
    done = points_done(path)
    assert len(done) == len(set(done))
    assert sorted(done) == sorted(points_done(whole))


@pytest.mark.parametrize("check", [slowly(23), slowly(29), 35])
def test_a_run_resumed_within_a_sweep_has_the_very_samples_of_one_that_was_never_stopped(
    check: int, tmp_path: Path, whole: Path
) -> None:
    path = stopped_and_resumed(tmp_path, check)
    samples = {segment.id: segment.sha256 for segment in open_recording(path).segments()}
    assert samples == {segment.id: segment.sha256 for segment in open_recording(whole).segments()}


def test_a_finished_run_that_is_resumed_has_nothing_left_to_do(whole: Path) -> None:
    before = (whole / "journal.jsonl").read_bytes()
    result = resume_run(whole, RunServices(AbsentOperator(), Interrupts()))
    assert result.outcome.ending == "finished"
    assert "nothing left to do" in result.outcome.reason
    assert result.outcome.estimates is not None
    assert (whole / "journal.jsonl").read_bytes() == before


def test_a_pause_disarms_and_the_run_goes_on_where_it_stood(
    tmp_path: Path, at_close: list[Telemetry | DriveFault]
) -> None:
    interrupts = Interrupts()
    interrupts.pause()
    threading.Timer(0.3, interrupts.resume).start()
    result = run_tiny(tmp_path, interrupts=interrupts, stages=STAGES[:-1])
    assert result.outcome.ending == "finished"
    walk = states(result.path)
    place = walk.index("paused")
    assert walk[place - 2 : place + 2] == ["reading_gates_off", "stopping", "paused", "reading_gates_off"]
    assert_safe(at_close)


def test_a_question_that_nobody_answers_ends_the_run_disarmed(
    tmp_path: Path, at_close: list[Telemetry | DriveFault]
) -> None:
    stages = [*STAGES[:1], {"kind": "operator", "prompt": "Release the brake"}, *STAGES[2:]]
    result = run_tiny(tmp_path, stages=stages)
    assert result.outcome.ending == "aborted"
    assert isinstance(result.outcome.error, RunAborted)
    assert "Release the brake" in result.outcome.reason
    assert not any(isinstance(message, OperatorAnswered) for message in messages_of(result.path))
    assert_safe(at_close)


def test_a_rotor_that_turns_ends_the_run_before_any_sweep(
    tmp_path: Path, at_close: list[Telemetry | DriveFault]
) -> None:
    result = run_tiny(tmp_path, drive={"plant": {"brake": {"works": False}}})
    assert result.outcome.ending == "aborted"
    assert "not locked" in result.outcome.reason
    assert "sweeping_classical" not in states(result.path)
    assert_safe(at_close)


@pytest.fixture
def blind_lock_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """A motor that shows nothing by which a rotation could be seen."""

    def judge(*_: object, **__: object) -> LockChecked:
        return LockChecked(
            locked=True, confidence=0.01, moved_rad=0.0, moved_std_rad=0.9, twist_rad=0.0, summary="cannot tell"
        )

    monkeypatch.setattr("orchestrator.analysis.judge_lock", judge)


@pytest.mark.usefixtures("blind_lock_check")
def test_where_the_lock_is_not_known_nobody_s_silence_ends_the_run(
    tmp_path: Path, at_close: list[Telemetry | DriveFault]
) -> None:
    result = run_tiny(tmp_path, stages=STAGES[:6])
    assert result.outcome.ending == "aborted"
    assert "cannot be measured on this motor" in result.outcome.reason
    (lock,) = [m for m in messages_of(result.path) if isinstance(m, LockChecked)]
    assert lock.locked is None
    assert "estimating_resistance" not in states(result.path)
    assert_safe(at_close)


@pytest.mark.usefixtures("blind_lock_check")
def test_where_the_lock_is_not_known_the_procedure_may_accept_that_in_words(tmp_path: Path) -> None:
    accepting = {**STAGES[4], "accept_not_known": "I have seen that the rotor is held"}
    result = run_tiny(tmp_path, stages=[*STAGES[:4], accepting, STAGES[5]])
    assert result.outcome.ending == "finished"
    walk = states(result.path)
    place = walk.index("checking_lock")
    assert walk[place : place + 5] == [
        "checking_lock",
        "stopping",
        "estimating",
        "waiting_for_operator",
        "estimating_resistance",
    ]
    answers = [m.by for m in messages_of(result.path) if isinstance(m, OperatorAnswered)]
    assert answers == ["procedure"] * 3


def leave(*_: object) -> None:
    sys.exit(0)


def test_a_drive_that_leaves_while_connecting_is_named_and_nothing_is_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SimulatedDrive, "connect", leave)
    with pytest.raises(PluginError, match=r"simulated: cannot be set up .*SystemExit"):
        run_tiny(tmp_path)
    assert not (tmp_path / "run").exists()


def test_a_drive_that_leaves_in_the_middle_of_a_run_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_close: list[Telemetry | DriveFault]
) -> None:
    monkeypatch.setattr(SimulatedDrive, "set_brake", leave)
    result = run_tiny(tmp_path, drive={"has_brake": True})
    assert result.outcome.ending == "faulted"
    assert "SystemExit" in result.outcome.reason
    assert_safe(at_close)


def test_an_estimator_that_leaves_does_not_take_the_run_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.estimation.estimate_recording", lambda *_, **__: sys.exit(0))
    result = run_tiny(tmp_path, stages=[STAGES[0], {"kind": "estimate"}])
    assert result.outcome.ending == "faulted"
    assert isinstance(result.outcome.error, PluginError)
    assert states(result.path)[-1] == "faulted"


def test_a_run_in_progress_cannot_be_resumed_beside_it(whole: Path) -> None:
    run = RunDirectory.open(whole)
    with run.lock(), pytest.raises(RecordingError, match="at work"):
        resume_run(whole, RunServices(AbsentOperator(), Interrupts()))


def test_the_truth_of_the_plant_is_nowhere_in_the_run_directory(tmp_path: Path) -> None:
    secret = 4.3217
    result = run_tiny(tmp_path, drive={"plant": {"resistance_ohm": secret}}, stages=STAGES[:1])
    text = "".join(file.read_text() for file in result.path.iterdir() if file.is_file())
    assert str(secret) not in text
    assert str(secret) in (result.path.with_name("run.sealed") / "truth.json").read_text()
