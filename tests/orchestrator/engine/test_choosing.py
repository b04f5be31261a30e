"""Points that a stage chooses while it measures: within plan and limits, or the run ends; and enough is enough."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from orchestrator.engine import AbsentOperator, Interrupts, RunResult, RunServices, resume_run
from plugins.stages.injection import InjectionStage
from protocols import Excitation, PointDone, StageRun, StageSufficed, StateChanged
from tests.support.tiny import STAGES, messages_of, run_tiny

Asked = Callable[[Sequence[Excitation]], Iterator[Excitation]]


@pytest.fixture
def run_asking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., RunResult]:
    """A run whose injections are a function of the planned ones."""

    def run(choose: Asked, *more: dict[str, Any]) -> RunResult:
        def as_run(self: InjectionStage, run: StageRun, planned: Sequence[Excitation]) -> Iterator[Excitation]:
            return choose(planned)

        monkeypatch.setattr(InjectionStage, "as_run", as_run)
        return run_tiny(tmp_path, stages=[STAGES[0], STAGES[7], *more], drive={"watchdog_s": 60.0})

    return run


def injected(result: RunResult) -> list[PointDone]:
    return [m for m in messages_of(result.path) if isinstance(m, PointDone) and m.id.startswith("injection")]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target_d_a": 4.4}, r"stages\.1\.points_a: injection reaches .*limits\.current_a is 4\.5 A"),
        ({"amplitude_v": 151.0}, r"stages\.1\.amplitudes_v: injection needs 151 V"),
        ({"duration_s": 0.4}, "another kind of excitation, or a longer one"),
    ],
)
def test_more_than_plan_and_limits_allow_ends_the_run_disarmed(
    run_asking: Callable[..., RunResult], change: dict[str, float], message: str
) -> None:
    result = run_asking(lambda planned: iter([planned[0], planned[1].model_copy(update=change)]))
    assert result.outcome.ending == "faulted"
    with pytest.raises(Exception, match=message):
        raise result.outcome.error or AssertionError
    assert len(injected(result)) == 1
    states = [m.target for m in messages_of(result.path) if isinstance(m, StateChanged)]
    assert states[-2:] == ["stopping", "faulted"]


def test_a_point_may_be_elsewhere_and_shorter_and_the_recording_says_so(run_asking: Callable[..., RunResult]) -> None:
    elsewhere = {"target_d_a": 0.25, "target_q_a": -0.5, "duration_s": 0.1}
    result = run_asking(lambda planned: iter([one.model_copy(update=elsewhere) for one in planned]))
    assert result.outcome.ending == "finished"
    for message in injected(result):
        settings = message.segment.settings
        assert (settings["target_d_a"], settings["target_q_a"], message.segment.samples) == (0.25, -0.5, 1000)


def test_what_is_enough_is_enough_after_a_resumption_too(
    run_asking: Callable[..., RunResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run_asking(lambda planned: iter(planned[:2]), {"kind": "operator", "prompt": "Go on?", "answer": None})
    assert result.outcome.ending == "aborted"
    assert len(injected(result)) == 2
    (enough,) = [m for m in messages_of(result.path) if isinstance(m, StageSufficed)]
    assert (enough.index, enough.points_spared) == (1, 4)
    monkeypatch.undo()
    again = resume_run(result.path, RunServices(AbsentOperator(), Interrupts()))
    assert again.outcome.ending == "aborted"  # the question comes once more, and nothing is measured before
    assert len(injected(result)) == 2
