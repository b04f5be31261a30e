"""What is behind a number: a motor that the simulated drive can be, and nothing that anybody chose."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.config import check_plan, load_procedure, make_plan
from orchestrator.engine import connected_drive
from plugins.commands.mystery import draw
from plugins.commands.mystery._command import procedure_of
from plugins.drives.simulated.effects import Effects
from protocols import shipped_procedures


def test_the_same_number_gives_the_same_motor_and_another_one_another() -> None:
    assert draw(7) == draw(7)
    assert draw(7) != draw(8)


def test_sometimes_nothing_is_hidden_and_never_more_than_three_effects() -> None:
    counts = [len(draw(n).plant["effects"]) for n in range(200)]
    assert {*counts} == {0, 1, 2, 3}
    assert counts.count(0) < 40


def test_every_effect_of_the_catalogue_is_hidden_in_some_motor() -> None:
    hidden = {name for n in range(200) for name in draw(n).plant["effects"]}
    known = set(Effects().model_dump())
    assert hidden == known


def test_sizes_are_spread_over_decades() -> None:
    volts = [e["voltage_v"] for n in range(300) if (e := draw(n).plant["effects"].get("dead_time"))]
    assert max(volts) > 5 * min(volts)


@pytest.mark.parametrize("number", [0, 1, 2, 3, 5, 8, 13, 21])
def test_its_campaign_passes_its_own_check(number: int, tmp_path: Path) -> None:
    procedure = procedure_of(number)
    with connected_drive(procedure, tmp_path) as (_, capabilities):
        check_plan(make_plan(procedure, capabilities), capabilities)


def test_the_campaign_is_no_shipped_procedure_and_does_not_tell_the_number() -> None:
    procedure = procedure_of(12345)
    assert procedure.name not in shipped_procedures()
    assert "12345" not in procedure.model_dump_json()
    assert load_procedure("full").stages[-1] != procedure.stages[-1]
