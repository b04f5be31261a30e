"""The second examiner's judge: names, twins, sizes in the same physical terms, and the page."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.blind.foreign.cases import EFFECTS, NO_CATALOGUE, Case, draw_case
from tests.blind.foreign.examine import Answer
from tests.blind.foreign.judge import judge, names_of
from tests.blind.foreign.machines import FAMILIES
from tests.blind.foreign.table import page

LARGE = {"flux_percent": 2.0, "voltage_percent": 2.0, "voltage_mv": 9.0, "rise_percent": 0.0, "watts": [4.0] * 400}


@pytest.fixture(autouse=True)
def one_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one that is tabulated soonest."""
    monkeypatch.setattr("tests.blind.foreign.cases.FAMILIES", {"synrm": FAMILIES["synrm"]})


def case_of(name: str, plan: str = "one_angle") -> Case:
    case = draw_case("single", list(EFFECTS).index(name), 0)
    return replace(case, rig=replace(case.rig, plan=plan))


def parameter(value: float, low: float, high: float) -> dict[str, Any]:
    return {"value": value, "low": low, "high": high, "unit": "1"}


def effect(name: str, twins: tuple[str, ...] = (), **parameters: dict[str, Any]) -> dict[str, Any]:
    return {"name": name, "twins": twins, "parameters": parameters}


def answer(case: Case, verdict: str, *effects: dict[str, Any], **more: Any) -> Answer:
    report = {"verdict": verdict, "effects": list(effects), "minor": [], "ladder": [{"chi2": 9.0}, {"chi2": 1.0}]}
    return Answer(case, report, None, {**LARGE, **more.pop("does", {})}, 10**5, 1.0, 100.0, **more)


def test_the_main_effect_has_to_be_named_first_and_alone() -> None:
    case = case_of("rotor_misalignment")
    right = judge(answer(case, "explained", effect("rotor_misalignment"))).right
    assert all(right.values())
    wrong = judge(answer(case, "unknown_remains", effect("bus_sag"), effect("rotor_misalignment"))).wrong
    assert wrong == ["single: main effect named first", "single: explained, or mostly", "single: no false name"]


def test_a_twin_counts_where_the_plan_cannot_tell_them_apart() -> None:
    drop = effect("device_drop")
    assert "dead_time" in names_of(case_of("dead_time", "one_angle"), drop)
    assert "dead_time" not in names_of(case_of("dead_time", "standard"), drop)
    assert "voltage_bias" not in names_of(case_of("current_offset", "one_angle"), effect("current_offset"))
    assert "voltage_bias" in names_of(case_of("current_offset", "no_holds"), effect("current_offset"))


def test_what_does_too_little_need_not_be_named() -> None:
    case = case_of("voltage_delay")
    small = {"flux_percent": 0.05, "voltage_percent": 0.1}
    assert judge(answer(case, "clean", does=small)).wrong == []
    assert judge(answer(case, "explained", effect("skin_effect"), does=small)).wrong


def test_what_is_in_no_catalogue_has_to_be_flagged() -> None:
    case = replace(case_of("voltage_delay"), kind="no_catalogue", truths=(), foreign="shorted_turn")
    assert judge(answer(case, "unknown_remains", effect("skin_effect"))).wrong == []
    assert judge(answer(case, "explained", effect("skin_effect"))).wrong


def test_what_a_catalogue_has_got_since_is_judged_like_a_single_effect() -> None:
    index = list(NO_CATALOGUE).index("shunts_of_unequal_gain")
    case = draw_case("no_catalogue", index, 0)
    (truth,) = case.truths
    two, third = (amount[0] for amount in truth.amounts.values())
    stated = effect(
        "shunt_reconstruction",
        gain_a_minus_b=parameter(two, two - 1e-3, two + 1e-3),
        gain_c_minus_ab=parameter(third, third - 1e-3, third + 1e-3),
    )
    right = judge(answer(case, "explained", stated))
    assert right.wrong == []
    assert all(size.inside for size in right.sizes)
    assert len(right.sizes) == 2
    assert judge(answer(case, "unknown_remains", effect("skin_effect"))).wrong


def test_a_usable_map_has_to_be_within_a_percent() -> None:
    case = case_of("rotor_misalignment")
    delivered = {"map_percent": 1.6, "inside": 0.3, "resistance_percent": 0.1, "usable": True}
    named = effect("rotor_misalignment")
    assert judge(answer(case, "explained", named, delivered=delivered)).wrong == ["usable or explained: map within 1 %"]
    held_back = {**delivered, "usable": False}
    wrong = judge(answer(case, "unknown_remains", named, delivered=held_back)).wrong
    assert wrong == ["single: explained, or mostly"]


def test_sizes_are_compared_in_the_same_physical_terms() -> None:
    case = case_of("rotor_misalignment")
    (true,) = {amount[0] for amount in case.truths[0].amounts.values()}
    radians = np.deg2rad(true)
    width = 0.1 * abs(radians)
    stated = effect("rotor_misalignment", angle_rad=parameter(radians, radians - width, radians + width))
    (size,) = judge(answer(case, "explained", stated)).sizes
    assert size.inside
    assert size.off == pytest.approx(0.0)
    far = effect("rotor_misalignment", angle_rad=parameter(2 * radians, 2 * radians - width, 2 * radians + width))
    (size,) = judge(answer(case, "explained", far)).sizes
    assert not size.inside
    assert size.off == pytest.approx(1.0)


def test_eddy_currents_are_compared_by_their_loss_at_the_injections_frequency() -> None:
    case = case_of("eddy_currents")
    ((siemens, _),) = case.truths[0].amounts.values()
    lag = 1e-4
    part = 1 / (1 + (2 * np.pi * case.rig.motor.plate.injection_hz * lag) ** 2)
    ohm = part / siemens
    stated = effect("eddy_currents", core_loss_ohm=parameter(ohm, 0.9 * ohm, 1.1 * ohm), lag_s=parameter(lag, lag, lag))
    (size,) = judge(answer(case, "explained", stated)).sizes
    assert size.stated[1] == pytest.approx(siemens)


def test_heating_is_compared_by_the_rise_in_the_end() -> None:
    """A hundred seconds of 4 W, with a time constant of 50 s."""
    case = case_of("winding_heating")
    stated = effect(
        "winding_heating", rise_per_watt=parameter(0.003, 0.002, 0.004), time_constant_s=parameter(50.0, 40.0, 60.0)
    )
    (size,) = judge(answer(case, "explained", stated, does={"rise_percent": 1.0})).sizes
    assert size.stated[1] == pytest.approx(100 * 0.003 * 4 * (1 - np.exp(-2.0)), rel=1e-3)
    assert size.inside


def test_the_page_shows_figures_and_every_miss() -> None:
    good = answer(case_of("rotor_misalignment"), "explained", effect("rotor_misalignment"))
    bad = answer(case_of("bus_sag"), "clean")
    text = page([judge(good), judge(bad)], 5, "2026-11-29", 100)
    assert "| single: main effect named first | 1 | 2 | 50 |" in text
    missed = text[text.index("## Wrong answers") :]
    assert "bus_sag" in missed
    assert "rotor_misalignment" not in missed
