"""The closed loop: compare, diagnose, propose, measure what is proposed, and diagnose again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from orchestrator.engine import AbsentOperator, Interrupts, RunResult, RunServices, extend_run, resume_run
from orchestrator.recording import open_recording
from orchestrator.runs import RunDirectory
from plugins.drives.simulated import SimulatedDrive
from plugins.stages.diagnose import DiagnoseStage
from plugins.stages.resistance import ResistanceStage
from protocols import (
    CapabilityError,
    Capture,
    Compared,
    Diagnosed,
    DriveRefused,
    Excitation,
    ExperimentProposed,
    Message,
    Note,
    OperatorAnswered,
    PointDone,
    RecordingError,
    StageRun,
    StagesAppended,
    StateChanged,
)
from tests.plugins.streams.report.example_diagnosis import WORDS, a_comparison, a_diagnosis
from tests.support.cases import few
from tests.support.tiny import STAGES, all_effects_but, messages_of, run_tiny, tiny_procedure

EXPERIMENT = {
    "kind": "resistance",
    "points_a": [[0.5, 0.0], [1.5, 0.0], [-0.5, 0.0]],
    "settle_s": 0.15,
    "duration_s": 0.05,
}
OPENING = [*STAGES[:4], STAGES[5]]
"""As far as the first measurement: what comes after it is not looked at here."""
PLANT = {"sensors": {"noise_a": 0.005}, "effects": {"dead_time": {"voltage_v": 0.8}}}

Propose = Callable[[dict[str, Any]], None]


@pytest.fixture
def propose(monkeypatch: pytest.MonkeyPatch) -> Propose:
    """Put a diagnosis in place that always proposes one and the same stage."""
    return partial(always_propose, monkeypatch)


def always_propose(patch: pytest.MonkeyPatch, stage: dict[str, Any]) -> None:
    def diagnosed(
        recording: object, stage_at_work: DiagnoseStage, run: StageRun
    ) -> tuple[Diagnosed, ExperimentProposed]:
        proposal = ExperimentProposed(
            round=run.appended, stage=stage, separates=("dead_time", "device_drop"), minutes=0.1, accepted=False
        )
        report = a_diagnosis(next_experiment={"stage": stage, "separates": proposal.separates, "minutes": 0.1})
        return Diagnosed(round=run.appended, report=report, words=WORDS), proposal

    patch.setattr("plugins.stages.diagnose.compared", lambda *_: Compared(report=a_comparison()))
    patch.setattr("plugins.stages.diagnose.diagnosed", diagnosed)


def diagnose(rounds: int) -> dict[str, Any]:
    return {"kind": "diagnose", "rounds": rounds}


def of_kind(path: Path, kind: type[Message]) -> list[Any]:
    return [message for message in messages_of(path) if isinstance(message, kind)]


def states(path: Path) -> list[str]:
    return [message.target for message in of_kind(path, StateChanged)]


def go_on(path: Path) -> RunResult:
    return resume_run(path, RunServices(AbsentOperator(), Interrupts()))


class StopAfter(Interrupts):
    """Asks for a stop once so many messages of a kind are in the journal."""

    def __init__(self, run: Path, kind: type[Message], count: int) -> None:
        super().__init__()
        self._run, self._kind, self._count = run, kind, count

    def check(self) -> None:
        if (self._run / "journal.jsonl").exists() and len(of_kind(self._run, self._kind)) >= self._count:
            self.stop("enough")
        super().check()


@pytest.fixture(scope="module")
def decided(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose inverter loses 0.8 V: one PWM frequency cannot tell dead time from a drop of the devices."""
    others = all_effects_but("dead_time", "device_drop")
    estimate = {"kind": "estimate", "estimators": ["resistance"]}
    stages = [*STAGES[:-1], estimate, {**diagnose(rounds=1), "without": others}]
    result = run_tiny(tmp_path_factory.mktemp("decided"), drive={"plant": PLANT}, stages=stages)
    assert result.outcome.error is None, result.outcome
    return result.path


def test_a_run_measures_what_its_diagnosis_asks_for_and_ends_with_one_name(decided: Path) -> None:
    first, second = of_kind(decided, Diagnosed)
    assert {first.report.effects[0].name, *first.report.effects[0].twins} == {"dead_time", "device_drop"}
    (effect,) = second.report.effects
    assert (effect.name, effect.twins) == ("dead_time", ())
    assert effect.parameters["voltage_v"].value == pytest.approx(0.8, rel=0.02)
    assert (first.round, second.round) == (0, 1)
    assert all(first.words.model_dump().values())


def test_the_last_diagnosis_is_kept_in_the_results(decided: Path) -> None:
    kept = json.loads((decided / "results" / "diagnosis.json").read_text())
    last = of_kind(decided, Diagnosed)[-1]
    assert (kept["report"], kept["words"]) == (last.report.model_dump(mode="json"), last.words.model_dump())
    assert (decided / "results" / "diagnosis.npz").stat().st_size > 1000


def test_the_loop_goes_through_its_states_disarmed(decided: Path) -> None:
    walk = states(decided)
    place = walk.index("comparing")
    loop = ["estimating", "comparing", "diagnosing", "proposing", "estimating_resistance", "stopping"]
    assert walk[place - 1 : place + 5] == loop
    assert walk[place + 5 :] == ["estimating", "comparing", "diagnosing", "stopping", "finished"]


def test_an_appended_stage_is_part_of_the_recording_and_not_of_the_procedure(decided: Path) -> None:
    (appended,) = of_kind(decided, StagesAppended)
    assert appended.by == len(STAGES)
    run = RunDirectory.open(decided)  # whose procedure still has its hash
    assert len(run.record.procedure.stages) == len(STAGES) + 1
    segments = [s for s in open_recording(decided).segments() if s.settings.get("pwm_frequency_hz") == 20000.0]
    assert len(segments) == len(appended.stages[0].settings["points_a"])


def test_a_round_more_is_measured_as_long_as_there_are_rounds(propose: Propose, tmp_path: Path) -> None:
    propose(EXPERIMENT)
    path = run_tiny(tmp_path, stages=[*OPENING, diagnose(rounds=2)]).path
    assert [proposal.accepted for proposal in of_kind(path, ExperimentProposed)] == [True, True, False]
    assert [message.round for message in of_kind(path, Diagnosed)] == [0, 1, 2]
    ids = [message.id for message in of_kind(path, PointDone)]
    assert ids[-6:] == [f"resistance-{k:03d}" for k in range(4, 10)]
    assert states(path)[-1] == "finished"


def test_an_experiment_beyond_the_limits_is_proposed_and_not_measured(propose: Propose, tmp_path: Path) -> None:
    propose({**EXPERIMENT, "points_a": [[50.0, 0.0]]})
    result = run_tiny(tmp_path, stages=[*OPENING, diagnose(rounds=1)])
    assert result.outcome.ending == "finished"
    (proposal,) = of_kind(result.path, ExperimentProposed)
    assert not proposal.accepted
    assert not of_kind(result.path, StagesAppended)
    assert any("cannot be run here" in str(message) and "50 A" in str(message) for message in messages_of(result.path))


LOOP = [*OPENING, {"kind": "estimate", "estimators": ["resistance"]}, {"kind": "diagnose", "rounds": 1}]


@pytest.fixture(scope="module")
def whole_loop(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str | None]:
    """The samples of each segment where nobody stopped the run."""
    with pytest.MonkeyPatch.context() as patch:
        always_propose(patch, EXPERIMENT)
        return samples_of(run_tiny(tmp_path_factory.mktemp("whole"), stages=LOOP).path)


def samples_of(run: Path) -> dict[str, str | None]:
    return {segment.id: segment.sha256 for segment in open_recording(run).segments()}


@few("kind, count", [(PointDone, 6), (Diagnosed, 1), (StagesAppended, 1), (PointDone, 7), (PointDone, 8)], fast=2)
def test_a_run_stopped_anywhere_in_the_loop_goes_on_exactly_there(
    propose: Propose, kind: type[Message], count: int, whole_loop: dict[str, str | None], tmp_path: Path
) -> None:
    propose(EXPERIMENT)
    stopped = run_tiny(tmp_path, stages=LOOP, interrupts=StopAfter(tmp_path / "run", kind, count))
    assert stopped.outcome.ending == "aborted"
    assert go_on(stopped.path).outcome.ending == "finished"
    assert samples_of(stopped.path) == whole_loop
    assert len(of_kind(stopped.path, StagesAppended)) == 1
    assert [message.round for message in of_kind(stopped.path, Diagnosed)] == [0, 1]


def test_a_finished_run_can_be_gone_on_with(propose: Propose, tmp_path: Path) -> None:
    propose(EXPERIMENT)
    stages = [*OPENING, {"kind": "estimate", "estimators": ["resistance"]}]
    path = run_tiny(tmp_path, stages=stages).path
    answered, estimated = len(of_kind(path, OperatorAnswered)), states(path).count("estimating")
    more = DiagnoseStage().going_on(EXPERIMENT, tiny_procedure(tmp_path), 1)
    assert more[0].settings["answer"] == "yes"  # as where the procedure has the brake engaged
    result = extend_run(path, more, RunServices(AbsentOperator(), Interrupts()))
    assert result.outcome.ending == "finished"
    assert [message.id for message in of_kind(path, PointDone)][-3:] == [f"resistance-{k:03d}" for k in (4, 5, 6)]
    assert len(of_kind(path, OperatorAnswered)) == answered + 1
    assert states(path).count("estimating") == estimated + 1
    starts = [segment.start_s for segment in open_recording(path).segments()]
    assert starts == sorted(starts)


def test_stages_beyond_the_limits_are_not_appended(tmp_path: Path) -> None:
    path = run_tiny(tmp_path, stages=OPENING).path
    journal = (path / "journal.jsonl").read_bytes()
    with pytest.raises(CapabilityError, match="50 A"):
        extend_run(
            path, [ResistanceStage(points_a=((50.0, 0.0),)).entry()], RunServices(AbsentOperator(), Interrupts())
        )
    assert (path / "journal.jsonl").read_bytes() == journal


def test_a_run_that_is_not_finished_is_not_appended_to(tmp_path: Path) -> None:
    result = run_tiny(tmp_path, stages=OPENING, interrupts=StopAfter(tmp_path / "run", PointDone, 2))
    with pytest.raises(RecordingError, match=r"not finished.*resume"):
        extend_run(result.path, [DiagnoseStage().entry()], RunServices(AbsentOperator(), Interrupts()))


def test_a_recording_with_too_little_in_it_gets_no_diagnosis_and_the_run_goes_on(tmp_path: Path) -> None:
    result = run_tiny(tmp_path, stages=[STAGES[0], diagnose(rounds=1)])
    assert result.outcome.ending == "finished"
    assert not of_kind(result.path, Diagnosed)
    assert any("no diagnosis" in str(message) for message in messages_of(result.path))


def test_a_proposed_experiment_that_the_drive_refuses_is_passed_over(
    tmp_path: Path, propose: Propose, monkeypatch: pytest.MonkeyPatch
) -> None:
    propose(EXPERIMENT)
    start = SimulatedDrive.start

    def picky(self: SimulatedDrive, excitation: Excitation) -> Iterator[Capture]:
        if excitation.start_dq_a == (0.5, 0.0):
            raise DriveRefused("not at half an ampere")
        return start(self, excitation)

    monkeypatch.setattr(SimulatedDrive, "start", picky)
    result = run_tiny(tmp_path, drive={"plant": PLANT}, stages=[*OPENING, {"kind": "estimate"}, diagnose(1)])
    assert result.outcome.ending == "finished", result.outcome
    (note,) = [m.text for m in of_kind(result.path, Note) if "was proposed" in m.text]
    assert note.endswith("the drive refuses it: not at half an ampere; passed over")
    assert len(of_kind(result.path, Diagnosed)) == 1
    assert go_on(result.path).outcome.ending == "finished"
