"""What counts as right: names and their twins, exact sets, flags, floors, intervals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.blind.examine import Answer
from tests.blind.hidden import Case, draw_case
from tests.blind.score import FOUND_FIRST, judge, stated, wilson
from tests.blind.table import page

SEED = 5


def report(*names: str, verdict: str = "explained", twins: dict[str, list[str]] | None = None) -> dict[str, Any]:
    effects = [
        {
            "name": name,
            "parameters": {},
            "twins": (twins or {}).get(name, []),
            "relative_size": 1.0,
            "log_evidence": 9.0,
            "probability": 0.97,
        }
        for name in names
    ]
    ladder: list[dict[str, Any]] = [
        {"added": None, "chi2": 100.0, "rms_v": 0.1, "heldout_rms_v": 0.1, "current_rms_a": 0.1}
    ]
    ladder += [{"added": n, "chi2": 1.0, "rms_v": 3e-3, "heldout_rms_v": 3.3e-3, "current_rms_a": 4e-3} for n in names]
    return {"verdict": verdict, "effects": effects, "ladder": ladder, "noise_floor": {"rms_v": 3e-3}, "notes": [],
            "materiality": {"flux_percent": 0.2, "voltage_percent": 0.5}}  # fmt: skip


def answered(case: Case, found: dict[str, Any] | None, error: str | None = None) -> Answer:
    return Answer(case, found, error, 470_000, 5.0, 4.0, 500.0)


def test_a_name_on_clean_data_is_false() -> None:
    case = draw_case("clean", 0, SEED)
    assert judge(answered(case, report(verdict="clean"))).wrong == []
    assert "clean: no false name" in judge(answered(case, report("dead_time"))).wrong


def test_a_faint_effect_may_go_unnamed_but_not_by_another_name() -> None:
    case = draw_case("faint", 0, SEED)
    name = case.truths[0].name
    unnamed, named, wrong = (judge(answered(case, found)) for found in (report(), report(name), report("hysteresis")))
    assert 0.02 <= case.truths[0].size <= 0.2
    assert unnamed.wrong == named.wrong == []
    assert sum(named.right.values()) == sum(unnamed.right.values()) + 2
    assert "faint: no wrong name" in wrong.wrong


def test_what_is_listed_as_smaller_is_a_name_like_others() -> None:
    """Found where it is there, and false where it is not."""
    case = draw_case("faint", 0, SEED)
    smaller = report(case.truths[0].name, verdict="clean")
    smaller |= {"minor": smaller["effects"], "effects": []}
    listed, unnamed = judge(answered(case, smaller)), judge(answered(case, report(verdict="clean")))
    assert sum(listed.right.values()) == sum(unnamed.right.values()) + 1
    other = report("hysteresis", verdict="clean")
    other |= {"minor": other["effects"], "effects": []}
    assert "faint: no wrong name" in judge(answered(case, other)).wrong
    assert "clean: no false name" in judge(answered(draw_case("clean", 0, SEED), other)).wrong


def test_a_twin_counts_as_the_name() -> None:
    case = draw_case("single", 3, SEED)
    assert case.truths[0].name == "voltage_delay"
    assert judge(answered(case, report("current_filter", twins={"current_filter": ["voltage_delay"]}))).wrong == []
    assert "single: first name right" in judge(answered(case, report("current_filter"))).wrong


def removal(**of_error: float) -> dict[str, dict[str, float]]:
    return {name: {"of_error": e, "of_excitation": 0.1 * e, "of_flux": 0.0} for name, e in of_error.items()}


def test_in_clutter_what_is_printed_counts() -> None:
    case = draw_case("clutter", 3, SEED)
    assert case.truths[0].name == "voltage_delay"
    found = report("dead_time")
    found["joint"] = [{"name": "voltage_delay", "relative_size": 1.0, "z": 20.0}]
    assert judge(answered(case, found)).wrong == ["clutter: named, or listed as smaller"]
    found["minor"] = [{"name": "voltage_delay", "twins": []}]
    assert judge(answered(case, found)).wrong == []
    assert judge(answered(case, report("dead_time", "voltage_delay", "nobody_s"))).wrong == ["clutter: no false name"]


def test_first_in_clutter_is_what_the_plant_says_does_most_or_nearly() -> None:
    case, found = draw_case("clutter", 3, SEED), report("dead_time", "voltage_delay")
    for most, right in ((0.1, True), (0.95, True), (0.5, True), (2.0, False)):
        done = replace(answered(case, found), removal=removal(dead_time=0.9, voltage_delay=most))
        assert judge(done).right[FOUND_FIRST] is right


def test_material_effects_have_to_be_causes() -> None:
    case, found = draw_case("ordinary", 0, SEED), report("dead_time")
    found["minor"] = [{"name": "hysteresis", "twins": [], "probability": 1.0}]
    done = replace(answered(case, found), removal=removal(dead_time=0.9, hysteresis=0.1, bus_sag=0.01))
    assert judge(done).material == (("dead_time", True), ("hysteresis", False))
    lone = answered(draw_case("single", 0, SEED), report("dead_time"))
    assert "| ordinary: material ones named | 1 | 2 | 50 |" in page([judge(done), judge(lone)], SEED, "2026-11-26", 2)


def test_identical_effects_count_where_their_stage_is_missing() -> None:
    seed = next(s for s in range(999) if draw_case("nuisance", 17, s).truths[0].name == "voltage_bias")
    case = draw_case("nuisance", 17, seed)
    assert case.nuisance == "no_gates_off"
    assert judge(answered(case, report("current_offset"))).wrong == []


def test_an_exact_set_has_no_more_and_no_less() -> None:
    case = draw_case("double", 0, SEED)
    first, second = (truth.name for truth in case.truths)
    assert judge(answered(case, report(second, first))).right["double: exact set"]
    assert not judge(answered(case, report(first))).right["double: exact set"]
    assert not judge(answered(case, report(first, second, "some_third"))).right["double: exact set"]


@pytest.mark.parametrize("kind", ["left_out", "foreign"])
def test_what_nothing_explains_has_to_be_flagged(kind: str) -> None:
    case = draw_case(kind, 0, SEED)
    assert judge(answered(case, report("bus_sag", verdict="unknown_remains"))).wrong == []
    assert judge(answered(case, report("bus_sag"))).wrong != []


def test_one_slow_leg_is_reported_by_its_size_or_flagged() -> None:
    case = draw_case("switched_foreign", 1, SEED)
    bridge = case.bench.bridge
    longer = bridge.dead_a_s / ((bridge.dead_a_s + 2.0 * bridge.dead_s) / 3.0) - 1.0
    for size, right in ((longer, True), (1.1 * longer, True), (1.3 * longer, False), (0.0, False)):
        found = report("dead_time")
        found["effects"][0]["parameters"] = {"leg_a_longer": {"value": size, "low": size, "high": size, "unit": "1"}}
        assert (judge(answered(case, found)).wrong == []) is right
    assert judge(answered(case, report("dead_time"))).wrong != []
    assert judge(answered(case, report("dead_time", verdict="unknown_remains"))).wrong == []


def test_a_twin_is_the_right_name_for_what_was_left_out() -> None:
    case = draw_case("left_out", 3, SEED)
    assert case.without == ("voltage_delay",)
    assert judge(answered(case, report("current_filter"))).wrong == []
    assert judge(answered(case, report("current_filter", "bus_sag"))).wrong != []
    assert judge(answered(draw_case("left_out", 0, SEED), report("current_filter"))).wrong != []


def test_too_little_data_may_be_refused_and_nothing_else_may() -> None:
    silent = draw_case("nuisance", 12, SEED)
    assert silent.nuisance == "no_excitation"
    assert judge(answered(silent, None, "nothing flows")).wrong == []
    assert judge(answered(silent, report("dead_time"))).wrong != []
    assert judge(answered(draw_case("clean", 0, SEED), None, "refused")).wrong != []


def test_the_held_out_error_is_held_against_its_floor() -> None:
    found = judge(answered(draw_case("single", 0, SEED), report("dead_time")))
    assert found.closed == pytest.approx((0.1 - 3.3e-3) / (0.1 - 3e-3))
    assert found.over_floor == pytest.approx(1.1)
    noisier = report("dead_time")
    noisier["noise_floor"]["heldout_rms_v"] = 3.3e-3
    assert judge(answered(draw_case("single", 0, SEED), noisier)).over_floor == pytest.approx(1.0)


def test_an_interval_holds_the_truth_or_does_not() -> None:
    case = draw_case("single", 0, SEED)
    true = case.truths[0].parameters["voltage_v"]
    found = report("dead_time")
    found["effects"][0]["parameters"] = {"voltage_v": {"value": true, "low": true - 1, "high": true + 1, "unit": "V"}}
    assert judge(answered(case, found)).intervals == (("dead_time.voltage_v", True),)


def test_a_stated_probability_is_held_against_what_is_there() -> None:
    case = draw_case("single", 0, SEED)
    right, wrong = (judge(answered(case, report(name))) for name in ("dead_time", "hysteresis"))
    assert (right.stated, right.of_largest) == (((0.97, True),), 0.97)
    assert (wrong.stated, wrong.of_largest) == (((0.97, False),), 0.0)
    text = page([right, wrong], SEED, "2026-11-21", 164)
    assert "| 0.9 to 1.0 | 2 | 0.970 | 0.500 |" in text
    assert "0.485 at the mean" in text


def test_the_interval_of_a_proportion_is_wilsons() -> None:
    assert wilson(10, 10) == pytest.approx((0.7225, 1.0), abs=1e-3)
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(9, 18)[0] + wilson(9, 18)[1] == pytest.approx(1.0)


def test_the_page_lists_figures_and_every_wrong_answer() -> None:
    right = judge(answered(draw_case("clean", 0, SEED), report(verdict="clean")))
    wrong = judge(answered(draw_case("single", 0, SEED), report("bus_sag", verdict="mostly_explained")))
    text = page([right, wrong], SEED, "2026-11-21", 164)
    assert "| clean: no false name | 1 | 1 | 100 |" in text
    assert "| single: first name right | 0 | 1 | 0 |" in text
    assert f"| {wrong.answer.case.label} |" in text
    assert stated(wrong.answer) in text
