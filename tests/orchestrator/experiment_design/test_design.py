"""A designed plan does what it is for when it is rehearsed as a whole, and leaves in place what measures nothing."""

from __future__ import annotations

import pytest

from orchestrator.config import check_plan
from orchestrator.experiment_design.design import ProcedureDesign, design, other_stages
from orchestrator.experiment_design.outlook import outlook
from protocols import ProcedureError
from tests.orchestrator.experiment_design.plans import (
    DRIVE,
    GATES_OFF,
    HOLDS,
    NOISE_A,
    SWEEPS,
    effects,
    machine,
    plan,
)

BEFORE = {"kind": "operator", "prompt": "held?", "answer": "yes"}
AFTER = {"kind": "estimate"}
PAIR = ("dead_time", "device_drop")


@pytest.fixture(scope="module")
def designed() -> ProcedureDesign:
    whole = plan(GATES_OFF, BEFORE, HOLDS, SWEEPS, AFTER)
    return design(whole, DRIVE, machine(), effects(*PAIR), size=0.5, noise_a=NOISE_A)


@pytest.mark.slow
def test_it_tells_apart_what_the_plan_it_is_from_did_not(designed: ProcedureDesign) -> None:
    before = outlook(plan(HOLDS, SWEEPS), DRIVE, machine(), effects(*PAIR), noise_a=NOISE_A)
    after = outlook(designed.plan, DRIVE, machine(), effects(*PAIR), noise_a=NOISE_A)
    parted_before, parted_after = before.parted_from(*PAIR), after.parted_from(*PAIR)
    assert parted_before is None or parted_before > 1.0
    assert parted_after is not None
    assert parted_after <= 0.5
    assert {point.excitation.pwm_frequency_hz for point in designed.plan.points} >= {20_000.0}


def test_limits_and_drive_allow_it_and_the_theorem_holds(designed: ProcedureDesign) -> None:
    assert check_plan(designed.plan, DRIVE).points == len(designed.plan.points)
    assert designed.approximate.excess <= 0.01


def test_what_measures_nothing_stays_in_its_place(designed: ProcedureDesign) -> None:
    kinds = [stage.name for stage in designed.plan.stages]
    assert kinds[0] == "operator"
    assert kinds[-1] == "estimate"
    assert other_stages(plan(GATES_OFF, BEFORE, HOLDS, SWEEPS, AFTER)) == ([1], [4])


def test_a_pair_that_nothing_tells_apart_is_stated() -> None:
    pair = effects("rotor_misalignment", "slot_harmonics")
    with pytest.raises(ProcedureError, match="rotor_misalignment or slot_harmonics"):
        design(plan(HOLDS, SWEEPS), DRIVE, machine(), pair, noise_a=NOISE_A)


def test_a_procedure_that_measures_nothing_has_no_place_for_it() -> None:
    with pytest.raises(ProcedureError, match="none that measures"):
        other_stages(plan(GATES_OFF, AFTER))
