"""What speaks against the use of a model's map."""

from __future__ import annotations

from dataclasses import replace

import pytest

from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.delivery import objections_to, remembering_by_ripple_alone
from plugins.effects.iron import Hysteresis
from plugins.effects.resistance import PhaseResistanceImbalance, WindingHeating
from plugins.effects.sensors import CurrentGainMismatch, ThirdCurrentSensor
from protocols import SegmentStage, Verdict
from tests.orchestrator.diagnosis.pieces import fitter, free_model, plan, prepared


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fitter(prepared(plan(sparse=True))).fit(free_model())


def _codes(fit: Fit, verdict: Verdict, band_percent: float = 0.1, **moved: float) -> list[str]:
    return [one.code.removeprefix("model.") for one in objections_to(fit, verdict, band_percent, moved)]


def test_nothing_speaks_against_a_map_that_fits(fit: Fit) -> None:
    assert _codes(fit, "clean") == _codes(fit, "explained", dead_time=0.03) == []


def test_a_wide_band_speaks_against_a_map(fit: Fit) -> None:
    assert _codes(fit, "explained", 1.1) == ["uncertain_map"]


def test_what_moves_the_map_may_stand_in_while_something_unknown_remains(fit: Fit) -> None:
    assert _codes(fit, "unknown_remains", slot_harmonics=0.004, dead_time=0.002) == []
    found = objections_to(fit, "unknown_remains", 0.1, {"slot_harmonics": 0.004, "third_current_sensor": 0.0156})
    assert [one.values["effect"] for one in found] == ["third_current_sensor"]


def test_a_form_that_no_such_effect_has_may_stand_in_while_something_unknown_remains(fit: Fit) -> None:
    (heating,) = scaled_library([WindingHeating()], fit.prepared.manifest)
    for off, codes in ((3.0, []), (5.0, ["strained_form"])):
        active = heating.absent().release("time_constant_s").moved("time_constant_s", off)
        bent = replace(fit, model=fit.model.with_active([active]))
        assert _codes(bent, "unknown_remains") == codes
        assert _codes(bent, "explained") == []


def test_three_large_effects_at_once_may_be_another_that_acts_like_them(fit: Fit) -> None:
    """A sensor that received another phase was explained by gains 3 and 5 % off beside a resistance 5 % off."""
    effects = (CurrentGainMismatch(), ThirdCurrentSensor(), PhaseResistanceImbalance())
    library = scaled_library(effects, fit.prepared.manifest)
    for off, codes in ((1.2, []), (1.8, ["rare_together"])):
        active = [one.absent().release(*one.amplitudes).moved(one.amplitudes[0], off) for one in library]
        assert _codes(replace(fit, model=fit.model.with_active(active)), "explained") == codes
        assert _codes(replace(fit, model=fit.model.with_active(active[:2])), "explained") == []


def test_what_iron_remembers_is_not_reported_by_a_ripple_alone(fit: Fit) -> None:
    """A play of 32 mA was 19 mA (16 to 21) by injection, and the map 1.2 % off."""
    (hysteresis,) = scaled_library([Hysteresis()], fit.prepared.manifest)
    there = replace(fit, model=fit.model.with_active([hysteresis.absent().moved("half_width_a", 1.0)]))
    still = [p for p in fit.prepared.pieces if p.stage is not SegmentStage.CLASSICAL]
    rippled = replace(there, prepared=replace(fit.prepared, pieces=tuple(still)))
    assert remembering_by_ripple_alone(there, {"hysteresis": 0.01}) == []
    assert remembering_by_ripple_alone(rippled, {"hysteresis": 0.01}) == ["hysteresis"]
    assert remembering_by_ripple_alone(rippled, {"hysteresis": 0.0001}) == []


def test_an_effect_that_alone_widens_the_band_is_named_with_the_band_without_it(fit: Fit) -> None:
    (alone,) = objections_to(fit, None, 1.5, {}, ("own_drop", 0.0082))
    assert alone.text.endswith(
        "because of own drop alone, whose size this recording cannot determine; without it, to +-0.0082 %"
    )
    (besides,) = objections_to(fit, None, 1.5, {}, ("own_drop", 1.4))
    assert "own drop" not in besides.text


def test_stages_that_were_not_fitted_speak_against_a_map_that_is_wrong_between_its_points(fit: Fit) -> None:
    residuals = zip(fit.prepared.pieces, fit.residual, strict=True)
    wrong = replace(fit, residual=tuple(5.0 * e if piece.held_out else e for piece, e in residuals))
    assert "wrong_between_points" in _codes(wrong, "unknown_remains")
    assert "wrong_between_points" not in _codes(fit, "unknown_remains")
    assert _codes(wrong, "explained") == []
