"""An effect's parameters are declared once, by role, and refused where they cannot be fitted."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from protocols import (
    EffectParameters,
    ParameterRole,
    PluginError,
    amplitude,
    refinement,
    shape,
    unit_powers,
)


class Rounded(EffectParameters):
    softness: float = refinement("1", neutral=0.5, prior_width=0.3, low=0.02, high=1.0)


class Step(Rounded):
    threshold_a: float = shape("A", typical=0.1, prior_width=1.0, low=1e-3, high=1.0)
    voltage_v: float = amplitude("V", typical=8.0, prior_width=6.0, low=-20.0, high=20.0)


def test_a_field_is_read_as_an_attribute_and_has_the_default_that_it_was_declared_with() -> None:
    absent = Step()
    assert (absent.voltage_v, absent.threshold_a, absent.softness) == (0.0, 0.1, 0.5)
    assert Step(voltage_v=3.0).voltage_v == 3.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        absent.voltage_v = 1.0  # type: ignore[misc]


def test_amplitudes_come_first_whatever_is_inherited() -> None:
    declared = Step.declared()
    assert [p.name for p in declared] == ["voltage_v", "threshold_a", "softness"]
    assert [p.role for p in declared] == list(ParameterRole)
    assert (declared[0].unit, declared[0].typical, declared[0].prior_width, declared[0].low) == ("V", 8.0, 6.0, -20.0)
    assert declared[1].neutral == declared[1].typical
    assert declared[2].typical == declared[2].neutral


GOOD: dict[str, Any] = {"unit": "V", "typical": 0.15, "prior_width": 0.3, "low": -5.0, "high": 5.0}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"typical": 0.0}, "typical 0 of an amplitude is zero"),
        ({"low": 6.0}, "low 6 is not below high 5"),
        ({"low": 0.1}, "neutral 0 is not between low 0.1 and high 5"),
        ({"prior_width": 0.0}, "prior_width 0 is not positive"),
        ({"typical": 7.0}, "typical 7 is not between"),
        ({"high": float("inf")}, "high is inf"),
        ({"unit": "kV"}, "unit 'kV' cannot be scaled to a machine; expected a product or quotient of A, V, ohm, Wb"),
        ({"unit": "us"}, "s, Hz, rad, K; write s, and 1e-6 in the sizes"),
        ({"unit": " "}, "unit ' '"),
    ],
)
def test_a_parameter_that_cannot_be_fitted_is_refused_when_its_class_is_defined(
    changed: dict[str, Any], message: str
) -> None:
    with pytest.raises(PluginError) as caught:

        class Wrong(EffectParameters):
            offset_v: float = amplitude(**(GOOD | changed))

    assert message in str(caught.value)
    assert "Wrong.offset_v" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_shape_that_may_be_zero_and_a_field_without_a_role_are_refused() -> None:
    with pytest.raises(PluginError, match=r"Wrong\.knee_a: low 0 of a shape is not positive"):

        class Wrong(EffectParameters):
            knee_a: float = shape("A", typical=0.1, prior_width=1.0, low=0.0, high=1.0)

    with pytest.raises(PluginError, match=r"Plain\.knee_a: declared without a role"):

        class Plain(EffectParameters):
            knee_a: float = 0.1


@pytest.mark.parametrize(
    ("unit", "powers"),
    [
        ("1", {"1": 1}),
        ("A", {"A": 1}),
        ("1/A^2", {"1": 1, "A": -2}),
        ("rad/Nm", {"rad": 1, "Nm": -1}),
        ("V s/A", {"V": 1, "s": 1, "A": -1}),
    ],
)
def test_a_unit_is_a_product_or_a_quotient_of_known_ones(unit: str, powers: dict[str, int]) -> None:
    assert unit_powers(unit) == powers


@pytest.mark.parametrize("unit", ["", "mV", "V/", "/V", "V/A/s", "A^-2", "A^0", "A^x", "v", "A  V", " A"])
def test_another_unit_is_refused(unit: str) -> None:
    with pytest.raises(ValueError, match="cannot be scaled"):
        unit_powers(unit)
