"""Power analysis: from which size on an effect is found, and how right the sizes are."""

from __future__ import annotations

import pytest

from orchestrator.fleet.campaign import PowerReport, power_of
from protocols.fleet import FleetEffect, FleetRow, HiddenEffect


def row(key: str, hidden: float | None, *found: FleetEffect, failed: str | None = None) -> FleetRow:
    truth = () if hidden is None else (HiddenEffect(name="dead_time", parameter="voltage_v", size=hidden),)
    return FleetRow(
        key=key,
        source=key,
        condition=f"bench {hidden}",
        hidden=truth,
        effects=None if failed else found,
        failed=failed,
    )


def effect(name: str = "dead_time", size: float = 1.0, **more: object) -> FleetEffect:
    fields = {
        "name": name,
        "parameter": "voltage_v",
        "size": size,
        "unit": "V",
        "low": size - 0.05,
        "high": size + 0.05,
    }
    return FleetEffect.model_validate({**fields, **more})


def judged(*rows: FleetRow) -> PowerReport:
    return power_of(rows, name="power", table="table", found_with=0.8)


def test_the_smallest_size_is_the_one_from_which_on_all_are_found() -> None:
    rows = [row(f"a{n}", 0.1, *([effect(size=0.1)] if n < 1 else [])) for n in range(4)]
    rows += [row(f"b{n}", 0.3, effect(size=0.3)) for n in range(4)]
    rows += [row(f"c{n}", 1.0, effect(size=1.2)) for n in range(4)]
    (smallest,) = judged(*rows).smallest
    assert (smallest.effect, smallest.size, smallest.probability) == ("dead_time", 0.3, 1.0)
    assert smallest.low == pytest.approx(0.51, abs=0.01)
    faint, middle, large = judged(*rows).rows
    assert (faint.found, faint.runs, middle.found) == (1, 4, 4)
    assert large.ratio == pytest.approx(1.2)
    assert large.inside == 0
    assert middle.inside == 4


def test_a_twin_counts_and_what_is_only_measured_is_not_named() -> None:
    twin = effect("device_drop", twins=("dead_time",))
    (power,) = judged(row("a", 1.0, twin), row("b", 1.0, effect(material=False))).rows
    assert (power.found, power.named) == (2, 1)


def test_nothing_found_is_stated_so() -> None:
    (smallest,) = judged(row("a", 0.1), row("b", 0.3)).smallest
    assert smallest.size is None


def test_names_of_what_was_not_hidden_are_false() -> None:
    found = judged(
        row("a", None, effect()),
        row("b", None),
        row("c", 1.0, effect(), effect("hysteresis")),
        row("d", 1.0, effect("device_drop", twins=("dead_time",))),
        row("e", None, effect(material=False)),
        row("f", 1.0, failed="bad"),
    )
    assert (found.false_names, found.judged, found.failed, found.runs) == (2, 5, 1, 6)
    assert [(failure.what, failure.count) for failure in found.failures] == [("bad", 1)]
