"""Slips on motors that the table of probabilities was not made with, and questions where no slip was made."""

from __future__ import annotations

import math

import numpy as np

from orchestrator.config._nameplate import broken_relations, mismatch, stated_values
from orchestrator.config._slips import likely_slips
from tests.orchestrator.config.random_motors import random_motors
from tests.orchestrator.config.test_slips import WRITTEN

MOTORS = [stated_values(motor) for motor in random_motors(0, 20)]
DRAWS = 10
LOW, HIGH = math.log(0.8), math.log(1.25)


def jittered(values: dict[str, float], random: np.random.Generator) -> dict[str, float]:
    """Each value 0.8 to 1.25 times what it was; frequency and torque follow from speed and power."""
    out = {name: value * math.exp(random.uniform(LOW, HIGH)) for name, value in values.items() if name != "pole_pairs"}
    pairs, speed_rpm = values["pole_pairs"], out["rated_speed_rpm"]
    followed = {
        "rated_frequency_hz": speed_rpm * pairs / 60.0,
        "rated_torque_nm": out["rated_power_w"] * 30.0 / (math.pi * speed_rpm),
    }
    return {**out, **followed, "pole_pairs": pairs}


def test_of_nameplates_that_are_a_quarter_off_one_in_twenty_at_most_is_requested_about_a_slip() -> None:
    random = np.random.default_rng(5)
    drawn = [jittered(values, random) for values in MOTORS for _ in range(DRAWS)]
    assert sum(bool(likely_slips(values)) for values in drawn) <= 0.05 * len(drawn)


def test_exact_nameplates_are_not_requested_about_a_slip() -> None:
    assert [values for values in MOTORS if likely_slips(values)] == []


def test_of_the_slips_that_show_nine_in_ten_are_named_first_or_second() -> None:
    """One shows where a relation is broken, or where what is right is likelier than what is written by 100 to 1."""
    shown, missed = 0, []
    for right in MOTORS:
        for slip, written_of in WRITTEN.items():
            if "flux" in slip and "pm_flux_wb" not in right:
                continue
            written = {**right, **written_of(right)}
            far = mismatch(written) - mismatch(right) > 2.0 * math.log(100.0)
            if written == right or not (broken_relations(written) or far):
                continue
            shown += 1
            named = [one.applied(written) for one in likely_slips(written)]
            if not any(all(math.isclose(one[name], right[name], rel_tol=0.02) for name in right) for one in named):
                missed.append(slip)
    assert shown >= 300
    assert len(missed) <= 0.1 * shown, missed
