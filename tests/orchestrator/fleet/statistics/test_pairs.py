"""Motors measured twice: what was repaired is named, and what was not touched is not."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import numpy as np
import pytest

from orchestrator.fleet.statistics import FleetTable, fleet_of, report_of
from protocols import InputError
from protocols.fleet import FleetRow
from tests.orchestrator.fleet.statistics.example_fleet import Fleet, effect, table_of


def again(rows: list[FleetRow], **changes: Any) -> list[FleetRow]:
    """The same motors a month later, measured anew: other errors, and what has changed."""
    rng = np.random.default_rng(9)
    out = []
    for row in rows:
        assert row.R_s_ohm is not None
        r_s = row.R_s_ohm + 0.002 * rng.normal()
        later = {"key": f"{row.key}b", "source": f"{row.source}b", "R_s_ohm": r_s}
        assert row.started_at is not None
        times = {
            "started_at": row.started_at + timedelta(days=30),
            "R_s_low_ohm": r_s - 0.004,
            "R_s_high_ohm": r_s + 0.004,
        }
        out.append(row.model_copy(update={**later, **times, **changes}))
    return out


def table(rows: list[FleetRow], place: str = "after") -> FleetTable:
    return fleet_of(table_of(rows), place)


def test_a_motor_that_changed_is_named_with_its_interval_and_the_others_are_not() -> None:
    before = Fleet(20).rows()
    after = again(before)
    r_s = after[4].R_s_ohm
    assert r_s is not None
    after[4] = after[4].model_copy(
        update={"R_s_ohm": r_s + 0.05, "R_s_low_ohm": r_s + 0.046, "R_s_high_ohm": r_s + 0.054}
    )
    report = report_of(table(after), against=table(before, "before"))
    pairs = report.pairs
    assert pairs is not None
    assert (pairs.count, pairs.unpaired, pairs.against) == (20, 0, "before")
    (change,) = pairs.changes
    assert (change.serial, change.quantity) == ("0004", "R_s_20_ohm")
    changes = next(remark.text for remark in report.remarks if remark.code == "changed_motors")
    assert changes == "1 motor changed by more than the recordings' intervals, first serial 0004: R_s at 20 °C"
    assert change.low is not None
    assert change.high is not None
    assert change.low < 0.05 < change.high
    assert change.high - change.low == pytest.approx(2 * np.hypot(0.004, 0.004), rel=0.05)
    assert not any(one.significant for one in pairs.quantities)


def test_a_change_common_to_all_motors_is_reported_without_intervals_of_each() -> None:
    before = Fleet(20).rows()
    after = [row.model_copy(update={"psi_pm_wb": (row.psi_pm_wb or 0.0) + 0.002}) for row in again(before)]
    report = report_of(table(after), against=table(before))
    assert report.pairs is not None
    (psi,) = [one for one in report.pairs.quantities if one.significant]
    assert (psi.name, psi.count) == ("psi_pm_wb", 20)
    assert psi.shift == pytest.approx(0.002)
    assert "changed" in [remark.code for remark in report.remarks]


def test_an_effect_that_went_with_the_repair_is_named() -> None:
    before, after = Fleet(12).rows(), again(Fleet(12).rows())
    worn = effect("dead_time", "voltage_v", 2.0, 0.2, "V")
    before[3] = before[3].model_copy(update={"effects": (*(before[3].effects or ()), worn)})
    unsure = effect("current_offset", "offset_a_a", 0.01, 0.02, "A")
    before[5] = before[5].model_copy(update={"effects": (*(before[5].effects or ()), unsure)})
    everywhere = [row.model_copy(update={"effects": (*(row.effects or ()), worn, unsure)}) for row in after[:2]]
    pairs = report_of(table([*everywhere, *after[2:]]), against=table(before)).pairs
    assert pairs is not None
    changes = {(one.serial, one.quantity, one.difference) for one in pairs.changes}
    assert changes == {(serial, "dead_time.voltage_v", None) for serial in ("0000", "0001", "0003")}


def test_within_one_table_the_first_recording_is_held_against_the_last() -> None:
    before = Fleet(12).rows()
    after = again(before[:5], psi_pm_wb=0.3)
    pairs = report_of(table([*after, *before]), within=True).pairs
    assert pairs is not None
    assert (pairs.count, pairs.unpaired, pairs.against) == (5, 7, "pairs")
    assert not pairs.quantities  # too few for a middle
    with pytest.raises(InputError, match="no serial number is measured twice"):
        report_of(table(before), within=True)
