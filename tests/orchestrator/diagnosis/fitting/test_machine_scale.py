"""Sizes met in one machine become those of another by its nameplate."""

from __future__ import annotations

import pytest

from orchestrator.diagnosis.fitting.machine_scale import MachineScale
from protocols import PLAIN_UNITS, SCALED_UNITS, EffectParameter, ParameterRole

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
