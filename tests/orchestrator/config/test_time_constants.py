"""A winding that is too fast for its samples, or whose resistance hides its inductance, is reported with numbers."""

from __future__ import annotations

from dataclasses import replace

import pytest

from orchestrator.config import load_procedure, make_plan
from orchestrator.config.time_constants import plan_notes, time_constant_notes
from protocols import DriveChoice, Motor
from tests.support.benches import Bench


def motor(ohm: float, henry: float) -> Motor:
    return Motor(name="m", pole_pairs=2, stator_resistance_ohm=ohm, d_inductance_h=henry, q_inductance_h=1.05 * henry)


def test_telemetry_slower_than_the_winding_is_reported_in_samples() -> None:
    (note,) = time_constant_notes(motor(0.45, 0.2e-3), 1000.0)
    assert "L / R is 0.44 samples" in note
    assert "decays to 11%" in note
    assert "sample at 6750 Hz or more" in note


def test_a_resistance_above_the_reactance_is_reported_with_what_it_does_to_the_inductance() -> None:
    samples, reactance = time_constant_notes(motor(5.85, 360e-6), 20e3, [1000.0])
    assert "L / R is 1.2 samples" in samples
    assert "R is 2.6 times omega L at the injected 1000 Hz" in reactance
    assert "2.6 % of L" in reactance


@pytest.mark.parametrize(("ohm", "henry", "hz"), [(4.25, 43e-3, 1e4), (0.025, 20e-6, 2e4), (0.03, 0.4e-3, 1e4)])
def test_usual_windings_are_not_spoken_of(ohm: float, henry: float, hz: float) -> None:
    assert time_constant_notes(motor(ohm, henry), hz, [hz / 20.0]) == ()


def test_nothing_is_reported_of_a_nameplate_without_r_or_l() -> None:
    assert time_constant_notes(Motor(name="m", pole_pairs=2), 1000.0, [50.0]) == ()


def test_the_line_begins_where_a_straight_line_between_rows_is_off_by_a_percent() -> None:
    # (h R / 2 L)^2 / 3 = 0.01: L / R is 2.89 samples
    assert time_constant_notes(motor(1.0, 2.8e-3), 1000.0)
    assert not time_constant_notes(motor(1.0, 3.0e-3), 1000.0)


@pytest.mark.parametrize(
    ("drive", "faster"), [("simulated", " (`--set drive.sampling_frequency_hz=20000`)"), ("vesc", "")]
)
def test_a_plan_s_notes_state_the_settings_that_end_them(drive: str, faster: str, pm400: Bench) -> None:
    demo = load_procedure("demo")
    fast = demo.motor.model_copy(update={"d_inductance_h": 1.2e-3, "q_inductance_h": 1.3e-3})
    plan = make_plan(demo.model_copy(update={"motor": fast}), pm400.capabilities())
    at = next(k for k, stage in enumerate(demo.stages) if stage.kind == "injection")
    named = plan.procedure.model_copy(update={"drive": DriveChoice(name=drive)})
    samples, reactance = plan_notes(replace(plan, procedure=named), pm400.capabilities())
    assert "L / R is 2.8 samples" in samples
    assert samples.endswith(f"or log the control's own rows{faster}")
    assert reactance.endswith(f"inject at up to 2500 Hz (`--set stages.{at}.frequency_hz=2500`)")
