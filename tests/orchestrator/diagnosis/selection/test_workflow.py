"""The course of a diagnosis, step by step."""

from __future__ import annotations

import numpy as np

from orchestrator.diagnosis.selection.workflow import improves_held_out
from plugins.effects.inverter import VoltageBias
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared, with_voltage


def test_an_effect_that_is_there_makes_what_was_held_out_fit_better() -> None:
    maker = fitter(with_voltage(prepared(plan()), np.array([0.3, -0.1])))
    bare = maker.fit(free_model())
    full = maker.fit(with_free(bare.model, maker, VoltageBias()))
    assert improves_held_out(bare, full)
    assert not improves_held_out(full, bare)
