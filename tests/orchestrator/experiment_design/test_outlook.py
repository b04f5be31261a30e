"""The answer before measuring: sizes in the effects' units, each pair once, and what is wrong in one line."""

from __future__ import annotations

import pytest

from orchestrator.experiment_design.outlook import IsolabilityReport, outlook
from protocols import NotMeasuredError
from tests.orchestrator.experiment_design.plans import (
    DRIVE,
    GATES_OFF,
    HOLDS,
    RIPPLE,
    SWEEPS,
    effects,
    machine,
    plan,
)


@pytest.fixture(scope="module")
def report() -> IsolabilityReport:
    names = ("voltage_bias", "eddy_currents", "current_offset")
    return outlook(plan(HOLDS, SWEEPS, RIPPLE), DRIVE, machine(), effects(*names), noise_a=0.2)


def test_the_least_value_is_the_size_in_the_effect_s_own_unit(report: IsolabilityReport) -> None:
    bias = next(e for e in report.effects if e.name == "voltage_bias")
    assert bias.unit == "V"
    assert bias.found_from is not None
    assert bias.least == pytest.approx(bias.found_from * bias.typical)


def test_what_is_strong_when_small_is_found_below_a_value(report: IsolabilityReport) -> None:
    eddy = next(e for e in report.effects if e.name == "eddy_currents")
    assert eddy.found_from is not None
    assert eddy.least == pytest.approx(eddy.typical / eddy.found_from)


def test_the_matrix_is_symmetric(report: IsolabilityReport) -> None:
    names = [e.name for e in report.effects]
    assert len(report.pairs) == len(names) * (len(names) - 1) // 2
    for a in names:
        for b in names:
            if a != b:
                assert report.parted_from(a, b) == report.parted_from(b, a)


def test_it_says_with_which_noise_and_survives_json(report: IsolabilityReport) -> None:
    assert report.noise_a == 0.2
    assert IsolabilityReport.model_validate_json(report.model_dump_json()) == report


def test_a_plan_without_a_current_has_nothing_to_tell() -> None:
    with pytest.raises(NotMeasuredError):
        outlook(plan(GATES_OFF), DRIVE, machine(), effects("voltage_bias"))
