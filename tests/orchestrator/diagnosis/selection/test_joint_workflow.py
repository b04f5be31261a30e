"""Where the joint fit has nothing to say, the search one by one has the word."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis._prepare import setup_of
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.selection import joint_workflow
from orchestrator.diagnosis.selection.forward_search import Search, Step
from orchestrator.diagnosis.weak_form.noise import sensor_noise
from plugins.effects.timing import VoltageDelay
from tests.orchestrator.diagnosis.pieces import free_model, plan, prepared


def test_effects_that_the_whole_recording_does_not_ask_for_make_no_ladder(monkeypatch: pytest.MonkeyPatch) -> None:
    made = prepared(plan(sparse=True))
    setup = setup_of(made, sensor_noise(made.pieces, made.criteria.weak_form))
    library = scaled_library([VoltageDelay()], made.manifest)
    bare = setup.fitter.fit(free_model())
    of_a_part = setup.coarse_fitter.fit(free_model().with_active([library[0].absent()]))
    monkeypatch.setattr(joint_workflow, "joint_search", lambda *_: (of_a_part, {}))
    assert joint_workflow.all_together(setup, [Step(None, bare)], Search([Step(None, bare)]), library) is None
