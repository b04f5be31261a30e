"""Parameters on a line: coordinates and values belong to each other, and sizes are relative to the typical one."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis.fitting.candidates import (
    MachineScale,
    scaled_library,
    standardised,
    typical_standardised_value,
    value_at,
)
from plugins.effects.inverter import DeadTime
from plugins.effects.iron import EddyCurrents
from plugins.effects.resistance import WindingHeating
from protocols import PLAIN_UNITS, SCALED_UNITS, Effect, EffectParameter, ParameterRole
from tests.orchestrator.diagnosis.pieces import plan, prepared

MANIFEST = prepared(plan(sparse=True)).manifest
EFFECTS: list[Effect] = [DeadTime(), EddyCurrents(), WindingHeating()]
PARAMETERS = [p for c in scaled_library(EFFECTS, MANIFEST) for p in c.parameters]
AMPLITUDES = [p for p in PARAMETERS if p.role is ParameterRole.AMPLITUDE]


@pytest.mark.parametrize("p", PARAMETERS)
def test_coordinate_and_value_are_each_others_inverse(p: EffectParameter) -> None:
    for part in (0.3, 0.6, 0.9):
        value = p.neutral + part * (p.typical - p.neutral) if p.role is ParameterRole.AMPLITUDE else p.typical
        assert value_at(p, standardised(p, value)) == pytest.approx(value, rel=1e-9)


@pytest.mark.parametrize("p", PARAMETERS)
def test_no_coordinate_leaves_the_bounds(p: EffectParameter) -> None:
    for x in (-1e9, -3.0, 0.0, 3.0, 1e9):
        assert p.low <= value_at(p, x) <= p.high


@pytest.mark.parametrize("p", AMPLITUDES)
def test_absence_is_the_origin_of_an_amplitude(p: EffectParameter) -> None:
    assert standardised(p, p.neutral) == 0.0
    assert abs(typical_standardised_value(p)) > 0.0


def test_an_effect_of_typical_size_has_the_relative_size_one() -> None:
    for candidate in scaled_library(EFFECTS, MANIFEST):
        active = candidate.absent()
        assert active.is_absent
        for name in candidate.amplitudes:
            active = active.moved(name, typical_standardised_value(candidate.named(name)))
        assert active.relative_size == pytest.approx(1.0)
        assert not active.is_absent


def test_what_is_left_out_of_the_library_is_not_there() -> None:
    assert [c.name for c in scaled_library(EFFECTS, MANIFEST, ["eddy_currents"])] == ["dead_time", "winding_heating"]


def test_what_rests_is_neutral_and_not_free_and_all_else_is_as_it_was() -> None:
    (candidate,) = scaled_library([DeadTime()], MANIFEST)
    bent = candidate.absent().moved("voltage_v", 1.0).release("softness", "wide").moved("softness", -1.0)
    resting = bent.fix("softness")
    assert resting.values == {**bent.values, "softness": candidate.named("softness").neutral}
    assert bent.free_refinements == ("softness", "wide")
    assert resting.free_refinements == ("wide",)
    assert resting.free == tuple(name for name in bent.free if name != "softness")


def test_a_second_form_begins_at_rest_and_with_what_the_first_was_bent_by() -> None:
    (dead_time,) = scaled_library([DeadTime()], MANIFEST)
    plain = dead_time.absent()
    bent = plain.release("leg_a_longer").moved("leg_a_longer", 3.0)
    (only,) = plain.alternative_forms()
    resting, keeping = bent.alternative_forms()
    assert only.values["switched"] == resting.values["switched"] == keeping.values["switched"] == 1.0
    assert only.values["leg_a_longer"] == resting.values["leg_a_longer"] == 0.0
    assert keeping.values["leg_a_longer"] == bent.values["leg_a_longer"]
    assert keeping.alternative_forms() == []


TWICE = MachineScale(amps=2.0, volts=3.0, ohms=5.0, webers=7.0)


def test_every_unit_that_scales_does_and_no_other() -> None:
    assert {unit: TWICE.of_unit(unit) for unit in SCALED_UNITS} == {
        "A": 2.0, "V": 3.0, "ohm": 5.0, "Wb": 7.0, "H": 3.5, "W": 20.0, "Nm": 14.0,
    }  # fmt: skip
    assert [TWICE.of_unit(unit) for unit in PLAIN_UNITS] == [1.0] * len(PLAIN_UNITS)


def test_products_and_quotients_scale_by_their_factors() -> None:
    assert TWICE.of_unit("1/W") == pytest.approx(1 / 20.0)
    assert TWICE.of_unit("1/A^2") == pytest.approx(0.25)
    assert TWICE.of_unit("rad/Nm") == pytest.approx(1 / 14.0)


def test_a_shape_s_prior_is_in_its_logarithm_and_stays() -> None:
    p = EffectParameter("x", "A", typical=1.0, prior_width=0.5, low=0.1, high=9.0, neutral=1.0)
    knee = EffectParameter(
        "x", "A", typical=1.0, prior_width=0.5, low=0.1, high=9.0, neutral=1.0, role=ParameterRole.SHAPE
    )
    scaled, bent = TWICE.scaled(p), TWICE.scaled(knee)
    assert (scaled.typical, scaled.low, scaled.high, scaled.neutral, scaled.prior_width) == (2.0, 0.2, 18.0, 2.0, 1.0)
    assert (bent.typical, bent.prior_width) == (2.0, 0.5)


def test_a_second_form_is_where_it_is_for_the_machine() -> None:
    p = EffectParameter(
        "x", "A", typical=1.0, prior_width=0.5, low=0.1, high=9.0, neutral=1.0, role=ParameterRole.SHAPE, other_form=3.0
    )
    assert TWICE.scaled(p).other_form == 6.0
