"""Plans are fitted to what a scope or a table can do, and say so; a drive without bounds gets what it always got."""

from __future__ import annotations

from typing import Any

import pytest

from orchestrator.config import Plan, check_plan, make_plan
from protocols import CapabilityError, Injection, Trapezoid
from tests.orchestrator.testing.example_drive import ExampleDrive
from tests.support.benches import Bench

HOLD = {"kind": "resistance", "points_a": [[1.0, 0.0]], "settle_s": 0.5, "duration_s": 2.0}
INJECTION = {
    "kind": "injection",
    "points_a": [[1.0, 0.0]],
    "amplitudes_v": [40.0],
    "frequency_hz": 500.0,
    "rotation_hz": 2.0,
    "settle_s": 0.5,
    "duration_s": 1.0,
}


def fitted(bench: Bench, stage: dict[str, Any], **says: Any) -> Plan:
    drive = ExampleDrive.capabilities.model_copy(update=says)
    plan = make_plan(bench.procedure(stage), drive)
    check_plan(plan, drive)
    return plan


def test_a_long_dwell_becomes_several_captures_of_which_the_first_settles(pm400: Bench) -> None:
    plan = fitted(pm400, HOLD, longest_capture_s=0.5)
    assert [p.id for p in plan.points] == [f"resistance-{k:03d}" for k in range(4)]
    assert [(p.excitation.settling_s, p.captured_s) for p in plan.points] == [(0.5, 0.5)] + [(0.0, 0.5)] * 3
    assert "stages.0 (resistance): 2 s become 4 captures of 0.5 s each" in plan.notes


def test_a_drive_that_captures_next_to_nothing_is_refused_by_its_limit_at_once(pm400: Bench) -> None:
    with pytest.raises(CapabilityError, match="captures 2 s; the drive's longest capture is 1e-09 s"):
        fitted(pm400, HOLD, longest_capture_s=1e-9)


def test_what_is_one_segment_to_its_stage_is_shortened(pm400: Bench) -> None:
    plan = fitted(pm400, {"kind": "alignment", "duration_s": 2.0}, longest_capture_s=0.5)
    assert [p.captured_s for p in plan.points] == [0.5]
    assert any("2 s become 0.5 s, the drive's longest capture" in note for note in plan.notes)


def test_periods_are_captured_one_by_one_and_faster_where_not_one_fits(pm400: Bench) -> None:
    stage = {"kind": "classical", "axes": ["q"], "held_a": [0.0], "amplitude_a": 2.0, "period_s": 2.0, "periods": 3}
    assert [p.captured_s for p in fitted(pm400, stage, longest_capture_s=2.5).points] == [2.0, 2.0, 2.0]
    faster = fitted(pm400, stage, longest_capture_s=1.0)
    assert all(isinstance(p.excitation, Trapezoid) and p.excitation.period_s == 1.0 for p in faster.points)
    assert {p.settings["period_s"] for p in faster.points} == {1.0}


@pytest.mark.parametrize(
    ("says", "frequency", "rotation", "duration"),
    [
        ({}, 500.0, 2.0, 1.0),
        ({"longest_capture_s": 0.7}, 500.0, 2.0, 0.5),
        ({"longest_capture_s": 0.2}, 500.0, 5.0, 0.2),
        ({"longest_excitation_s": 1.1}, 500.0, 2.0, 0.5),
        ({"rotation_step_hz": 4.0}, 500.0, 4.0, 0.5),
        ({"longest_capture_s": 0.3, "rotation_step_hz": 1.0}, 500.0, 4.0, 0.25),
        ({"frequency_step_hz": 125.0}, 500.0, 2.0, 1.0),
        ({"frequency_step_hz": 208.0 + 1.0 / 3.0}, 416.0 + 2.0 / 3.0, 2.0, 1.0),
    ],
)
def test_an_injection_keeps_whole_turns_on_the_drives_grid(
    pm400: Bench, says: dict[str, float], frequency: float, rotation: float, duration: float
) -> None:
    plan = fitted(pm400, INJECTION, **says)
    (point,) = plan.points
    assert isinstance(point.excitation, Injection)
    found = (point.excitation.frequency_hz, point.excitation.rotation_hz, point.excitation.duration_s)
    assert found == pytest.approx((frequency, rotation, duration))
    assert point.settings["frequency_hz"] == pytest.approx(frequency)
    assert point.settings["rotation_hz"] == pytest.approx(rotation)
    assert any("stages.0 (injection)" in note for note in plan.notes) == (found != (500.0, 2.0, 1.0))


def test_a_wave_that_is_not_played_becomes_the_one_that_is(pm400: Bench) -> None:
    plan = fitted(pm400, INJECTION, injection_waveforms=frozenset({"sine"}))
    (point,) = plan.points
    assert isinstance(point.excitation, Injection)
    assert point.excitation.waveform == "sine"
    assert any("waveform square becomes sine" in note for note in plan.notes)


def test_what_an_injection_discards_counts_where_its_memory_begins_with_it(pm400: Bench) -> None:
    (point,) = fitted(pm400, {**INJECTION, "discard_s": 0.25}, longest_injection_s=0.75).points
    assert point.captured_s == pytest.approx(0.5)


def test_an_injection_elsewhere_than_at_zero_is_refused_beforehand_where_the_drive_has_none(pm400: Bench) -> None:
    with pytest.raises(CapabilityError, match="injects at zero only"):
        fitted(pm400, INJECTION, injects_at_zero_only=True)
    (point,) = fitted(pm400, {**INJECTION, "points_a": [[0.0, 0.0]]}, injects_at_zero_only=True).points
    assert point.excitation.longest_current_a == 0.0


def test_a_bandwidth_that_is_ignored_is_noted_once_and_not_checked_against_the_sampling(pm400: Bench) -> None:
    plan = fitted(pm400, {**HOLD, "control": {"bandwidth_hz": 900.0}}, heeds_bandwidth=False)
    assert sum("ignores control.bandwidth_hz" in note for note in plan.notes) == 1
