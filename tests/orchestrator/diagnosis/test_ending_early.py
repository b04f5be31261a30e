"""Whoever ends a search early gets the report of what it has found so far; other ends are as they were."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from orchestrator.diagnosis import InterimResult, diagnose_recording, judge
from orchestrator.diagnosis._prepare import setup_of
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.selection.search import unfinished_search
from orchestrator.diagnosis.selection.search_state import AcceptedModel, Checkpoint, SearchState
from orchestrator.diagnosis.weak_form.noise import sensor_noise
from orchestrator.recording import Recording, read_model
from plugins.effects.inverter import DeadTime, VoltageBias
from plugins.effects.timing import VoltageDelay
from protocols import Effect, RunInterrupted
from tests.orchestrator.diagnosis import pieces as made_of
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import free_model, plan, prepared

LIBRARY: list[Effect] = [DeadTime(), VoltageBias()]
THREADS = "fluxbench-equations"


class Impatient:
    """Raises from the first poll on after an answer, or after certain words; as often as it is to."""

    def __init__(self, error: type[BaseException], times: int = 1, words: str | None = None) -> None:
        self._error, self._left, self._words, self._is_due = error, times, words, False
        self.answers: list[InterimResult] = []

    def on_interim(self, result: InterimResult) -> None:
        self.answers.append(result)
        self._is_due = self._is_due or self._words is None

    def tell(self, text: str) -> None:
        self._is_due = self._is_due or (self._words is not None and text.startswith(self._words))

    def poll(self) -> None:
        if self._is_due and self._left > 0:
            self._left -= 1
            raise self._error


def threads_left() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith(THREADS)]


def test_what_was_found_so_far_is_fitted_to_the_whole_and_reported_as_unfinished(
    with_dead_time: Recording, tmp_path: Path
) -> None:
    who = Impatient(KeyboardInterrupt)
    found = diagnose_recording(
        with_dead_time,
        LIBRARY,
        out=tmp_path,
        on_interim=who.on_interim,
        poll=who.poll,
        report_early=True,
        workers=2,
    )
    report = found.report
    assert [(one.effects, one.is_part) for one in who.answers] == [(("dead_time",), True)]
    assert report.remarks[0].code == report.reasons[0].quantity == "ended_early"
    assert report.reasons[0].sentence == "ended early by the user: the search was not finished"
    assert report.verdict_record is not None
    judged = judge(report.verdict_record)
    assert (report.verdict, report.reasons[1:]) == (judged.verdict, judged.reasons)
    assert [effect.name for effect in report.effects] == ["dead_time"]
    assert [rung.added for rung in report.ladder] == [None, "dead_time"]
    assert all(step.fit.prepared is found.setup.prepared for step in found.search.steps if found.setup)
    assert [effect.name for effect in read_model(tmp_path).effects] == ["dead_time"]
    assert not threads_left()


@pytest.mark.parametrize(
    ("who", "report_early"),
    [
        pytest.param(Impatient(KeyboardInterrupt), False, id="nobody wants a report", marks=pytest.mark.slow),
        pytest.param(Impatient(KeyboardInterrupt, times=2), True, id="the second time", marks=pytest.mark.slow),
        pytest.param(Impatient(RunInterrupted), True, id="a run is stopped", marks=pytest.mark.slow),
        pytest.param(Impatient(KeyboardInterrupt, words="searching for missing"), True, id="nothing was found yet"),
    ],
)
def test_anything_else_ends_the_diagnosis_and_leaves_nothing(
    who: Impatient, report_early: bool, with_dead_time: Recording, tmp_path: Path
) -> None:
    with pytest.raises((KeyboardInterrupt, RunInterrupted)):
        diagnose_recording(
            with_dead_time,
            LIBRARY,
            out=tmp_path,
            on_interim=who.on_interim,
            tell=who.tell,
            poll=who.poll,
            report_early=report_early,
            workers=2,
        )
    assert not list(tmp_path.iterdir())
    assert not threads_left()


@pytest.mark.slow
def test_a_search_that_is_over_has_its_own_report(with_dead_time: Recording, tmp_path: Path) -> None:
    who = Impatient(KeyboardInterrupt, words="computing the intervals")
    found = diagnose_recording(
        with_dead_time, LIBRARY, out=tmp_path, tell=who.tell, poll=who.poll, report_early=True
    ).report
    alone = diagnose_recording(with_dead_time, LIBRARY, out=tmp_path).report
    times = {"seconds": 0.0, "search": ()}
    assert found.model_copy(update=times) == alone.model_copy(update=times)
    assert "ended_early" not in [remark.code for remark in found.remarks]


def test_effects_that_were_fitted_together_to_a_part_have_a_ladder_of_the_whole() -> None:
    made = prepared(plan(sparse=True))
    maker = setup_of(made, sensor_noise(made.pieces)).fitter
    hidden = with_free(free_model(), maker, VoltageBias(), bias_a_v=0.2).active
    setup = setup_of(made_of.with_effects(made, list(hidden)), maker.noise)
    absent = [c.absent() for c in scaled_library([VoltageBias(), VoltageDelay()], made.manifest)]
    bare, part = setup.fitter.fit(free_model()), setup.part_fitter.fit(free_model())
    both = setup.part_fitter.fit(part.model.with_active(absent))
    first = (AcceptedModel(None, bare),)
    for is_part, fit in ((True, both), (False, setup.fitter.fit(both.model))):
        state = SearchState(setup, fit, bare.chi2_per_dof, is_part=is_part, is_joint=True)
        found = unfinished_search(Checkpoint(state, first))
        assert [step.added for step in found.steps] == [None, "voltage_bias"]
        assert all(step.fit.prepared is setup.prepared for step in found.steps)
        assert not found.doubtful
