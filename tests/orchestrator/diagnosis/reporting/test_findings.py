"""What was found, as it is reported: intervals hold what was put in, the map's own rungs have sizes."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.reporting.findings import beyond_the_rest, found_effects, map_effects
from protocols import FoundEffect
from tests.orchestrator.diagnosis.fitting.test_fit import fitted_bias
from tests.orchestrator.diagnosis.pieces import L_D, L_Q, fitter, free_model, plan, prepared, with_voltage

MAKER = fitter(with_voltage(prepared(plan(sparse=True)), np.array([0.3, 0.0])))


def test_intervals_hold_what_was_put_in_and_are_as_wide_as_asked_for() -> None:
    fit = fitted_bias(MAKER)
    (effect,) = found_effects(MAKER, fit, {}, {"voltage_bias": ["current_offset"]})
    assert effect.twins == ("current_offset",)
    for name, truth in (("bias_a_v", 0.3), ("bias_b_v", -0.15)):
        told = effect.parameters[name]
        assert told.value is not None
        assert told.low is not None
        assert told.high is not None
        assert told.low < truth < told.high
        assert told.unit == "V"


def test_a_map_that_is_constant_has_neither_saturation_nor_cross_saturation() -> None:
    fit = MAKER.renewed(free_model(), held=True)
    saturation, cross = map_effects(fit, {"saturation": 1.0, "cross_saturation": 0.0})
    assert saturation.parameters["relative_change"].value == pytest.approx(0.0, abs=1e-9 * (L_D + L_Q))
    assert cross.relative_size == pytest.approx(0.0, abs=1e-9)


def test_what_takes_away_less_than_is_left_is_not_listed() -> None:
    some = [
        FoundEffect(name=name, parameters={}, twins=(), relative_size=1.0, log_evidence=20.0, share=share)
        for name, share in (("a", 0.5), ("b", 0.02))
    ]
    assert [effect.name for effect in beyond_the_rest(some, 0.42)] == ["a"]
    assert [effect.name for effect in beyond_the_rest(some, 0.0)] == ["a", "b"]
