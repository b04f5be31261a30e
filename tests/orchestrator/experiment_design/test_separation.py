"""What a stage is predicted to tell of two effects is what it tells once it is measured."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from orchestrator.experiment_design import separation as planning
from orchestrator.experiment_design.separation import ConfoundedPair, confounded_pair, planned_pieces, separation
from plugins.effects.inverter import VoltageBias
from plugins.effects.sensors import CurrentOffset
from protocols import Effect, ModelNoise, SegmentStage
from tests.orchestrator.diagnosis.fitting.test_fit import with_free
from tests.orchestrator.diagnosis.pieces import (
    L_D,
    Plan,
    fitter,
    free_model,
    hold,
    plan,
    prepared,
    setup_of,
    with_voltage,
)

BIAS_V = np.array([0.05, 0.0])
PLANS = [p for p in plan(sparse=True) if p.stage is not SegmentStage.GATES_OFF]
GATES_OFF = {"kind": "gates_off", "duration_s": 0.2}


def _measured(plans: list[Plan]) -> PreparedRecording:
    return with_voltage(prepared(plans, noise_a=1e-3), BIAS_V)


def _fitted(maker: Fitter, effect: Effect) -> Fit:
    return maker.fit(with_free(free_model(), maker, effect))


@pytest.fixture(scope="module")
def setup() -> DiagnosisSetup:
    return setup_of(fitter(_measured(PLANS)))


def test_gates_off_separates_a_bias_from_an_offset_as_much_as_was_predicted(setup: DiagnosisSetup) -> None:
    (offset,) = scaled_library([CurrentOffset()], setup.prepared.manifest)
    fit = _fitted(setup.fitter, VoltageBias())
    pair = confounded_pair(setup, fit, fit.model.active[0], offset)
    assert pair is not None
    predicted = separation(setup, pair, GATES_OFF)
    more = fitter(_measured([*PLANS, Plan(SegmentStage.GATES_OFF, np.zeros((2000, 2)))]))
    before = _fitted(setup.fitter, CurrentOffset()).objective - fit.objective
    after = _fitted(more, CurrentOffset()).objective - _fitted(more, VoltageBias()).objective
    assert predicted > 25.0
    assert after - before == pytest.approx(predicted, rel=0.25)


def test_a_stage_that_lasts_longer_separates_more(setup: DiagnosisSetup) -> None:
    (offset,) = scaled_library([CurrentOffset()], setup.prepared.manifest)
    fit = _fitted(setup.fitter, VoltageBias())
    pair = confounded_pair(setup, fit, fit.model.active[0], offset)
    assert pair is not None
    short, long = (separation(setup, pair, {**GATES_OFF, "duration_s": s}) for s in (0.2, 2.0))
    assert 0.0 < short < long


def test_an_effect_is_no_rival_of_itself(setup: DiagnosisSetup) -> None:
    (bias,) = scaled_library([VoltageBias()], setup.prepared.manifest)
    fit = _fitted(setup.fitter, VoltageBias())
    assert confounded_pair(setup, fit, fit.model.active[0], bias) is None


def test_planned_segments_have_the_currents_that_were_requested(setup: DiagnosisSetup) -> None:
    stage = {"kind": "resistance", "points_a": [[1.0, -0.5]], "duration_s": 0.5}
    ((one, weight),) = planned_pieces(setup, free_model(), stage)
    np.testing.assert_allclose(one.signals.i_ab.mean(axis=0), [1.0, -0.5], rtol=1e-9)
    seconds = len(one.signals.v_dc) / one.signals.sampling_frequency_hz
    assert weight * seconds == pytest.approx(0.5)
    points = {"points_a": [[0.0, 0.0]], "amplitudes_v": [40.0], "frequency_hz": 500.0}
    wave = {"kind": "injection", **points, "duration_s": 1.0}
    ((ripple, _),) = planned_pieces(setup, free_model(), wave)
    assert ripple.windows.period == pytest.approx(20.0)
    # A square wave of 40 V at 500 Hz swings the flux by 20 mWb to either side.
    swing = np.ptp(ripple.signals.i_ab[:, 0]) * L_D
    assert swing == pytest.approx(2.0 * 0.02, rel=0.1)


@pytest.mark.parametrize("stage", [GATES_OFF, {"kind": "resistance", "points_a": [[1.0, -0.5]], "duration_s": 0.5}])
def test_a_stage_of_too_few_readings_separates_nothing(
    setup: DiagnosisSetup, stage: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planning, "windows_of", lambda *_: None)
    assert planned_pieces(setup, free_model(), stage) == []


def test_a_planned_hold_has_the_commands_that_the_model_s_losses_need(setup: DiagnosisSetup) -> None:
    fit = _fitted(setup.fitter, VoltageBias())
    stage = {"kind": "resistance", "points_a": [[1.0, -0.5]], "duration_s": 0.5}
    ((one, _),) = planned_pieces(setup, fit.model, stage)
    bias = [fit.model.active[0].values[name] for name in ("bias_a_v", "bias_b_v")]
    expected = fit.model.r_s * np.array([1.0, -0.5]) + [bias[0], (bias[0] + 2.0 * bias[1]) / np.sqrt(3.0)]
    np.testing.assert_allclose(one.signals.v_ab.mean(axis=0), expected, atol=1e-6)


def test_a_planned_segment_has_the_information_of_one_that_is_measured_as_long(setup: DiagnosisSetup) -> None:
    scattered = setup.fitter.with_noise(ModelNoise(offset_scatter_a=1e-3))
    model = free_model()
    stage = {"kind": "resistance", "points_a": [[1.0, 0.0]], "duration_s": 2.0}
    ((short, weight),) = planned_pieces(setup, model, stage)
    biased = scaled_library([VoltageBias()], setup.prepared.manifest)[0].absent().moved("bias_a_v", 1.0)
    pair = ConfoundedPair(model, model.with_active([biased]), np.zeros((0, 0)), {})
    whole = prepared([Plan(SegmentStage.RESISTANCE, hold(1.0, 0.0, samples=20_000))], noise_a=0.0).pieces[0]
    planned = weight * planning._normal(planning._as_one_segment(scattered, weight), pair, [short], with_prior=False)
    measured = planning._normal(scattered, pair, [whole], with_prior=False)
    np.testing.assert_allclose(planned[-1, -1], measured[-1, -1], rtol=0.05)
