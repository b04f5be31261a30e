"""The diagnose stage: which plugins it needs, and what it goes on with."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from orchestrator.testing import StageConformance
from plugins.stages.diagnose import DiagnoseStage, publish_model
from protocols import MapEstimated, Message, PluginUse, ProcedureError, ResistanceEstimated, Stage, StageRun
from tests.orchestrator.estimation.test_delivery import AGAINST, deliver, model_map
from tests.support.benches import Bench


class TestDiagnose(StageConformance):
    def make_stage(self) -> Stage:
        return DiagnoseStage()


EXPERIMENT: dict[str, Any] = {"kind": "gates_off", "duration_s": 2.0}


def test_effects_that_are_taken_out_have_to_be_installed_and_rungs_of_the_map_have_not() -> None:
    stage = DiagnoseStage(without=("saturation", "dead_time"))
    assert list(stage.uses()) == [PluginUse("effects", None), PluginUse("effects", "dead_time", "without.1")]


def test_after_an_experiment_come_the_last_estimate_and_one_diagnosis_with_a_round_less(pm400: Bench) -> None:
    procedure = pm400.procedure({"kind": "estimate"}, {"kind": "estimate", "estimators": ["resistance"]})
    more = DiagnoseStage(rounds=2).following(EXPERIMENT, procedure)
    assert [entry.kind for entry in more] == ["gates_off", "estimate", "diagnose"]
    assert more[1].settings["estimators"] == ["resistance"]
    assert more[2].settings["rounds"] == 1


@pytest.mark.parametrize(
    ("experiment", "place"), [({"duration_s": 2.0}, "kind"), ({"kind": "gates_off", "duration_s": -1.0}, "duration_s")]
)
def test_an_experiment_that_is_no_stage_is_refused(pm400: Bench, experiment: dict[str, Any], place: str) -> None:
    procedure = pm400.procedure({"kind": "estimate"})
    with pytest.raises(ProcedureError, match=rf"next_experiment\.{place}"):
        DiagnoseStage().following(experiment, procedure)


def test_a_finished_run_is_gone_on_with_on_the_answer_that_its_procedure_gives(pm400: Bench) -> None:
    brake = {"kind": "operator", "prompt": "?", "brake": "engage", "answer": "yes"}
    for operator, answer in ([brake], "yes"), ([], None):
        question = DiagnoseStage().going_on(EXPERIMENT, pm400.procedure(*operator, {"kind": "estimate"}), 1)[0]
        assert (question.kind, question.settings["answer"]) == ("operator", answer)


@pytest.mark.parametrize("objections", [(), AGAINST])
def test_the_model_s_resistance_and_map_replace_the_estimators_where_nothing_speaks_against_them(
    objections: tuple[Any, ...], tmp_path: Path
) -> None:
    published: list[Message] = []
    concluded: list[Any] = []
    run = SimpleNamespace(publish=published.append, conclude=concluded.append)
    estimates = deliver(tmp_path, *objections)
    diagnosis = SimpleNamespace(estimates=estimates, delivery=SimpleNamespace(map=model_map()))
    publish_model(cast(StageRun, run), cast(Any, diagnosis))
    assert concluded == [estimates]
    if objections:
        assert published == []
        return
    resistance, found = published
    assert isinstance(resistance, ResistanceEstimated)
    assert resistance.estimate == estimates.resistance
    assert isinstance(found, MapEstimated)
    assert found.estimate.map.method == "model"
    assert len(found.estimate.points.i_dq) > 9
    assert "the model explains the recording" in found.estimate.remarks[0].text
