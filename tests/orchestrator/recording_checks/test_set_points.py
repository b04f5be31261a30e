"""Scales, exchanged and inverted phases and the rotor's angle, each named with what undoes it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orchestrator.recording_checks import CorrectedRecording, find_convention
from protocols import Convention
from tests.support.cases import few
from tests.support.rewriting import Field, Rewritten, exchanged, gain

SCALES = [2 / 3, 1.5, math.sqrt(2.0), 1 / math.sqrt(2.0), math.sqrt(3.0), 1 / math.sqrt(3.0), 0.5, 2.0, 10.0, 0.1]
FIELDS: list[tuple[Field, str]] = [("i_ab", "currents"), ("v_ab", "voltages")]


def named(wrong: Rewritten) -> Convention:
    """What is convention, where it is inverse by its own correction."""
    convention = find_convention(wrong)
    assert convention is not None
    assert find_convention(CorrectedRecording(wrong, convention.correction)) is None
    return convention


@pytest.mark.parametrize(("field", "name"), FIELDS)
@few("factor", [*SCALES, math.sqrt(1.5), math.sqrt(2 / 3), 1e3, 1e-3], fast=3)
def test_a_scale_is_named_with_the_factor_that_undoes_it(
    right: Rewritten, field: Field, name: str, factor: float
) -> None:
    convention = named(right.mapped(field, factor * np.eye(2)))
    assert convention.kind == f"scaled_{name}"
    assert f"{factor:.4g}" in convention.what
    assert convention.correction.field == name
    assert convention.correction.factor == pytest.approx(1.0 / factor)


@few("field, name", FIELDS, fast=2)
@pytest.mark.parametrize("pair", ["ab", "bc", "ac"])
def test_exchanged_phases_are_named(right: Rewritten, field: Field, name: str, pair: str) -> None:
    convention = named(right.phases(field, exchanged(*pair)))
    assert convention.kind == f"swapped_{name}"
    assert f"phases {pair[0]} and {pair[1]}" in convention.what


@pytest.mark.parametrize(("field", "name"), FIELDS)
@few("phase, sensors", [("a", "ab"), ("b", "ab"), ("c", "bc"), ("a", "abc"), ("c", "abc")], fast=2)
def test_an_inverted_phase_is_named(right: Rewritten, field: Field, name: str, phase: str, sensors: str) -> None:
    convention = named(right.phases(field, gain(phase, -1.0), sensors))
    assert convention.kind == f"inverted_{name}"
    assert convention.what.endswith(f"phase {phase}")


def test_reversed_currents_are_named(right: Rewritten) -> None:
    convention = named(right.mapped("i_ab", -np.eye(2)))
    assert (convention.kind, convention.correction.factor) == ("reversed_currents", -1.0)


def test_exchanged_phases_are_seen_without_set_points(right: Rewritten) -> None:
    names = ("current_d_a", "current_q_a", "target_d_a", "target_q_a")
    convention = named(right.phases("i_ab", exchanged("b", "c")).without_settings(*names))
    assert convention.kind == "swapped_currents"
    assert "or the voltages are" in convention.what


def test_a_mechanical_angle_is_named(right: Rewritten) -> None:
    pairs = right.manifest.motor.pole_pairs
    convention = named(right.with_segments(lambda s: {"rotor_angle_rad": s.rotor_angle_rad / pairs}))
    assert (convention.kind, convention.correction.factor) == ("mechanical_angle", pairs)


def test_an_angle_in_degrees_is_named(right: Rewritten) -> None:
    convention = named(right.with_segments(lambda s: {"rotor_angle_rad": math.degrees(s.rotor_angle_rad)}))
    assert convention.kind == "angle_unit"


def test_an_angle_that_is_off_is_named_with_what_is_missing(right: Rewritten) -> None:
    convention = named(right.with_segments(lambda s: {"rotor_angle_rad": s.rotor_angle_rad - 0.5 * math.pi}))
    assert convention.kind == "rotor_angle"
    assert convention.correction.add == pytest.approx(0.5 * math.pi, rel=1e-3)


def test_set_points_in_rms_are_no_wrong_currents(right: Rewritten) -> None:
    def in_rms(settings: dict[str, float]) -> dict[str, float]:
        return {k: v / math.sqrt(2.0) if k.endswith(("d_a", "q_a")) else v for k, v in settings.items()}

    assert find_convention(right.with_segments(lambda s: {"settings": in_rms(s.settings)})) is None
