"""What is proposed to be added parts what the plan leaves open, and drive and limits allow it."""

from __future__ import annotations

import pytest

from orchestrator.experiment_design.additions import allowed_stages, extended_plan
from orchestrator.experiment_design.outlook import outlook
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

LOOK_ALIKES = effects("dead_time", "device_drop", "current_offset", "voltage_bias")


@pytest.mark.slow
def test_what_is_added_parts_what_was_open() -> None:
    short = plan(HOLDS, SWEEPS)
    before = outlook(short, DRIVE, machine(), LOOK_ALIKES, noise_a=NOISE_A)
    assert not before.open
    settled = {question for addition in before.additions for question in addition.settles}
    assert settled == {("dead_time", "device_drop"), ("current_offset", "voltage_bias")}
    whole = extended_plan(short, DRIVE, [addition.stage for addition in before.additions])
    after = outlook(whole, DRIVE, machine(), LOOK_ALIKES, noise_a=NOISE_A)
    assert after.additions == ()
    assert after.open == ()


def test_what_the_drive_does_not_offer_is_not_proposed() -> None:
    one_pwm = DRIVE.model_copy(update={"pwm_frequencies_hz": (10_000.0,)})
    report = outlook(plan(HOLDS, SWEEPS), one_pwm, machine(), LOOK_ALIKES, noise_a=NOISE_A)
    assert [(one.effects, one.needs) for one in report.open] == [
        (("dead_time", "device_drop"), ("direct currents at a second PWM frequency",))
    ]


def test_stages_beyond_the_limits_are_left_out() -> None:
    far = {"kind": "resistance", "points_a": [[9.0, 0.0]], "settle_s": 0.5, "duration_s": 0.5}
    assert allowed_stages(plan(HOLDS, SWEEPS), DRIVE, [far, GATES_OFF]) == [GATES_OFF]
