"""Who may answer, and who may energise: on a real drive a person, or somebody's spelled-out words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from orchestrator.config import load_procedure
from orchestrator.engine import (
    SAFE_BENCH_WORDS,
    AbsentOperator,
    Interrupts,
    Operator,
    RunResult,
    RunServices,
    start_run,
)
from plugins.drives.simulated import SimulatedDrive
from protocols import Capabilities, CapabilityError, InputError, OperatorAnswered, PointDone
from tests.support.tiny import STAGES, messages_of, tiny_procedure

ASKED = [*STAGES[:2], {"kind": "resistance", "points_a": [[1.0, 0.0]], "settle_s": 0.1, "duration_s": 0.02}]
"""The sensors alone, a question that the procedure answers, and a point."""


class Person:
    """Says no to everything."""

    def __init__(self) -> None:
        self.prompts: list[str] = []

    def confirm(self, prompt: str, interrupts: Interrupts) -> bool:
        self.prompts.append(prompt)
        return False


@pytest.fixture
def real(monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulated drive no longer says that it is one, nor which motor it is set up for."""
    open_ = SimulatedDrive.open

    def opened(self: SimulatedDrive) -> Capabilities:
        return open_(self).model_copy(update={"simulated": False})

    monkeypatch.setattr(SimulatedDrive, "open", opened)


def run_with(operator: Operator, folder: Path, stages: Sequence[dict[str, Any]] = ASKED, **drive: Any) -> RunResult:
    procedure = tiny_procedure(folder, stages=stages, drive=drive)
    return start_run(procedure, folder / "run", RunServices(operator, Interrupts()))


def answers(folder: Path) -> list[OperatorAnswered]:
    return [message for message in messages_of(folder / "run") if isinstance(message, OperatorAnswered)]


@pytest.mark.usefixtures("real")
def test_on_a_real_drive_a_person_is_requested_whatever_the_procedure_answers(tmp_path: Path) -> None:
    person = Person()
    result = run_with(person, tmp_path)
    assert person.prompts == ["Release the brake"]
    assert result.outcome.ending == "aborted"
    assert [(found.answer, found.by) for found in answers(tmp_path)] == [("no", "operator")]


@pytest.mark.usefixtures("real")
def test_with_nobody_there_a_real_drive_is_not_energised_by_a_procedure_s_own_answer(tmp_path: Path) -> None:
    result = run_with(AbsentOperator(), tmp_path)
    assert result.outcome.ending == "aborted"
    assert SAFE_BENCH_WORDS in result.outcome.reason
    done = [message.id for message in messages_of(tmp_path / "run") if isinstance(message, PointDone)]
    assert done == ["gates_off-000"]


@pytest.mark.usefixtures("real")
def test_words_spelled_out_let_the_procedure_answer_and_stand_in_the_journal(tmp_path: Path) -> None:
    assert run_with(AbsentOperator(SAFE_BENCH_WORDS), tmp_path).outcome.ending == "finished"
    assert [(found.by, found.words) for found in answers(tmp_path)] == [("procedure", SAFE_BENCH_WORDS)]


def test_other_words_are_none() -> None:
    with pytest.raises(InputError, match=SAFE_BENCH_WORDS):
        AbsentOperator("yes")


@pytest.mark.usefixtures("real")
def test_a_real_drive_is_not_energised_with_an_example_s_nameplate(tmp_path: Path) -> None:
    with pytest.raises(CapabilityError, match=r"motor.example.*--motor"):
        start_run(load_procedure("demo"), tmp_path / "run", RunServices(AbsentOperator(SAFE_BENCH_WORDS), Interrupts()))
    assert not (tmp_path / "run").exists()


def test_a_point_in_which_an_interlock_opened_is_not_done_and_the_run_ends(tmp_path: Path) -> None:
    fault = {"kind": "interlock", "at_excitation": 2}
    result = run_with(AbsentOperator(), tmp_path, interlocks=["door"], faults=[fault])
    assert result.outcome.ending == "faulted"
    assert "interlock open: door" in result.outcome.reason
    done = [message.id for message in messages_of(tmp_path / "run") if isinstance(message, PointDone)]
    assert done == ["gates_off-000"]


def test_an_interlock_that_the_drive_does_not_have_is_missed_before_anything(tmp_path: Path) -> None:
    procedure = tiny_procedure(tmp_path, stages=ASKED).model_copy(update={"interlocks": ("door",)})
    with pytest.raises(CapabilityError, match=r"interlocks: 'simulated' has no input door"):
        start_run(procedure, tmp_path / "run", RunServices(AbsentOperator(), Interrupts()))
