"""Limits of a motor: files of limits, and the judgement of each recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.fleet.statistics import fleet_of, read_limits, report_of, require_known
from protocols import InputError
from protocols.fleet_report import FleetJudgement, FleetLimits
from tests.orchestrator.fleet.statistics.example_fleet import Fleet, effect, table_of

NUMBERS = st.floats(-1e9, 1e9)


def judge(limits: dict[str, Any], change: dict[str, Any] | None = None, fleet: Fleet | None = None) -> FleetJudgement:
    """Twelve motors, the first of which is changed."""
    fleet = fleet or Fleet(12)
    fleet.changes = {0: lambda row: row.update(change or {})}
    report = report_of(fleet_of(table_of(fleet.rows()), "line"), limits=FleetLimits.model_validate(limits))
    assert report.judgement is not None
    return report.judgement


def first_not_passed(judgement: FleetJudgement) -> tuple[str, tuple[str, ...]]:
    first = [one for one in judgement.others if one.recording.serial == "0000"]
    return (first[0].judgement, first[0].reasons) if first else ("pass", ())


def test_inside_passes_outside_fails_and_an_interval_over_the_limit_is_undecided() -> None:
    limits = {"quantities": {"R_s_ohm": {"low": 3.0, "high": 5.0}}}
    assert judge(limits).passed == 12

    def at(r_s: float) -> dict[str, Any]:
        return {"R_s_ohm": r_s, "R_s_low_ohm": r_s - 0.004, "R_s_high_ohm": r_s + 0.004}

    assert first_not_passed(judge(limits, at(5.01))) == ("fail", ("R_s 5.010 Ω (95 %: 5.006 to 5.014) above 5 Ω",))
    unsure = ("unsure", ("R_s 2.999 Ω (95 %: 2.995 to 3.003) may be below 3 Ω",))
    assert first_not_passed(judge(limits, at(2.999))) == unsure
    assert first_not_passed(judge({**limits, "guard": False}, at(2.999))) == ("fail", ("R_s 2.999 Ω below 3 Ω",))


def test_what_was_not_measured_did_not_pass() -> None:
    limits = {"quantities": {"L_d_h": {"high": 1.0}}, "verdicts": ["explained"], "usable": True}
    assert judge(limits).passed == 12
    none = {"L_d_h": None, "verdict": None, "usable": None}
    judgement = judge(limits, none)
    assert first_not_passed(judgement) == (
        "not_measured",
        ("L_d not measured", "not diagnosed", "no map that is judged"),
    )
    assert judgement.not_measured == 1
    bad = {"verdict": "unknown_remains", "usable": False}
    assert first_not_passed(judge(limits, bad))[1] == ("verdict unknown_remains", "map not reliable")


def test_an_effect_that_was_looked_for_and_not_found_is_nothing() -> None:
    limits = {"quantities": {"dead_time.voltage_v": {"high": 1.0}}}
    there = (effect("dead_time", "voltage_v", 2.0, 0.2, "V"),)
    judgement = judge(limits, {"effects": there})
    assert first_not_passed(judgement)[0] == "fail"
    assert judgement.passed == 11
    assert judge(limits).passed == 12  # in no recording at all
    assert judge(limits, fleet=Fleet(12, effects=False)).not_measured == 12
    needed = {"quantities": {"phase_resistance_imbalance.extra_b_ohm": {"low": 0.001}}, "guard": False}
    assert first_not_passed(judge(needed, {"effects": ()}))[1] == ("phase resistance imbalance: extra b not found",)


def test_a_limited_quantity_gets_its_capability() -> None:
    limits = FleetLimits.model_validate({"quantities": {"L_d_h": {"low": 0.0433 * 0.96, "high": 0.0433 * 1.04}}})
    report = report_of(fleet_of(table_of(Fleet(200).rows()), "line"), limits=limits)
    (judgement,) = [one.capability for one in report.quantities if one.capability is not None]
    assert judgement.cpk == pytest.approx(4.0 / 3.0, abs=0.2)
    assert judgement.cpk_low is not None
    assert judgement.cpk_high is not None
    assert judgement.cpk_low < 4.0 / 3.0 < judgement.cpk_high
    assert judgement.beyond == 0
    assert judgement.beyond_high == pytest.approx(0.018, abs=0.001)


@given(st.dictionaries(st.sampled_from(["R_s_ohm", "L_d_h", "dead_time.voltage_v"]), st.tuples(NUMBERS, NUMBERS)))
def test_limits_in_order_are_read_as_written_and_others_named(
    tmp_path_factory: pytest.TempPathFactory, ends: dict[str, tuple[float, float]]
) -> None:
    path = tmp_path_factory.mktemp("limits") / "limits.yaml"
    quantities = {name: {"low": low, "high": high} for name, (low, high) in ends.items()}
    path.write_text(yaml.safe_dump({"quantities": quantities, "guard": False}))
    wrong = [name for name, (low, high) in ends.items() if low > high]
    if not wrong:
        judgement = read_limits(path)
        assert {name: (limit.low, limit.high) for name, limit in judgement.quantities.items()} == ends
        return
    with pytest.raises(InputError, match="is above high") as error:
        read_limits(path)
    assert str(error.value).startswith(f"{path}:")
    assert error.value.field.removeprefix("quantities.") in wrong


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("quantities: {R_s_ohm: {}}", "quantities.R_s_ohm: expected low, high or both"),
        ("quantities: {R_s_ohm: {lo: 1}}", "quantities.R_s_ohm.lo: unknown key; did you mean 'low'?"),
        ("quantities: {R_s_ohm: {low: cold}}", "quantities.R_s_ohm.low: expected a number, got 'cold'"),
        ("quantities: {R_s_ohm: {low: .nan}}", "quantities.R_s_ohm.low: expected a finite number"),
        ("verdicts: [fine]", "verdicts.0: expected 'clean', 'explained'"),
        ("quantity: {}", "quantity: unknown key; did you mean 'quantities'?"),
        ("[1, 2]", "expected keys and values"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "limits.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_limits(path)
    assert problem in str(error.value)
    assert "\n" not in str(error.value)


def test_a_quantity_that_nobody_knows_is_named_with_the_nearest() -> None:
    table = fleet_of(table_of(Fleet(12).rows()), "line")
    known = FleetLimits.model_validate({"quantities": {"dead_time.voltage_v": {"high": 1.0}, "L_q_h": {"low": 0.0}}})
    require_known(known, "limits.yaml", table, ["dead_time.voltage_v"])
    for name, problem in (
        ("L_dd_h", "did you mean 'L_d_h'?"),
        ("dead_time.voltage", "did you mean 'dead_time.voltage_v'?"),
    ):
        wrong = FleetLimits.model_validate({"quantities": {name: {"high": 1.0}}})
        with pytest.raises(InputError) as error:
            require_known(wrong, "limits.yaml", table, ["dead_time.voltage_v"])
        assert str(error.value) == f"limits.yaml: quantities.{name}: unknown quantity; {problem}"
    with pytest.raises(InputError, match="unknown quantity; valid: L_d_h, ") as error:  # and not all the library's
        require_known(
            FleetLimits.model_validate({"quantities": {"zzz": {"low": 1.0}}}),
            "limits.yaml",
            table,
            ["dead_time.voltage_v"],
        )
    assert "dead_time" not in str(error.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_limits(tmp_path / "none.yaml")
