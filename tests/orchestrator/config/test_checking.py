"""The dry run: sums that add up, and refusals that name the stage, the field and the remedy."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.config import PlanSummary, check_plan, load_procedure, make_plan
from orchestrator.engine import connected_drive
from protocols import CapabilityError, ProcedureError, shipped_procedure
from tests.support.benches import KINDS, SERVO, Bench

HOLD = {"kind": "resistance", "points_a": [[3.0, 4.0]], "settle_s": 1.0, "duration_s": 3.0}
INJECTION = {"kind": "injection", "points_a": [[1.0, 0.0]], "amplitudes_v": [40.0], "settle_s": 0.25, "duration_s": 1.0}


def summary_of(bench: Bench, *stages: dict[str, Any], **fields: Any) -> PlanSummary:
    drive = bench.capabilities(max_current_a=100.0)
    return check_plan(make_plan(bench.procedure(*stages, **fields), drive), drive)


def refusal(bench: Bench, *stages: dict[str, Any], drive: dict[str, Any] | None = None, **fields: Any) -> str:
    capabilities = bench.capabilities(**(drive or {}))
    plan = make_plan(bench.procedure(*stages, **fields), capabilities)
    with pytest.raises(CapabilityError) as caught:
        check_plan(plan, capabilities)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_hold_dissipates_three_halves_r_i_squared_with_its_settling(pm400: Bench) -> None:
    summary = summary_of(pm400, HOLD)
    assert summary.energy_j == pytest.approx(1.5 * 4.25 * 25.0 * 4.0)
    assert summary.rms_current_a == pytest.approx(5.0)
    assert summary.peak_current_a == 5.0
    assert (summary.duration_s, summary.captured_s, summary.rows) == (4.0, 3.0, 30_000)
    assert "rms current" in summary.notes[0]


@pytest.mark.parametrize(("axis", "held"), [("q", 2.0), ("d", -1.0), ("dq", 0.0)])
def test_a_trapezoid_dissipates_what_its_waveform_integrates_to(pm400: Bench, axis: str, held: float) -> None:
    stage = {"kind": "classical", "axes": [axis], "amplitude_a": 3.0, "held_a": [held], "settle_s": 0.5, "periods": 3}
    t = np.linspace(0.0, 2.0, 200_001)
    swept = np.interp(t, [0.0, 0.25, 0.75, 1.25, 1.75, 2.0], [0.0, 3.0, 3.0, -3.0, -3.0, 0.0])
    squared = 3 * np.trapezoid(swept**2 + held**2, t) + 0.5 * held**2
    summary = summary_of(pm400, stage)
    assert summary.energy_j == pytest.approx(1.5 * 4.25 * squared, rel=1e-6)
    assert summary.peak_current_a == pytest.approx(math.hypot(3.0, held))


def test_the_ripple_of_the_injection_counts(pm400: Bench) -> None:
    summary = summary_of(pm400, INJECTION)
    ripple = 40.0 / (4 * 500.0) / 0.04325
    assert summary.peak_current_a == pytest.approx(1.0 + ripple)
    assert summary.energy_j == pytest.approx(1.5 * 4.25 * (1.25 + ripple**2 / 3), rel=1e-9)


@pytest.mark.parametrize(
    "stage",
    [
        INJECTION | {"amplitudes_v": [1e300]},
        HOLD | {"points_a": [[1e300, 0.0]]},
        {"kind": "classical", "amplitude_a": 1e300},
    ],
    ids=lambda stage: str(stage["kind"]),
)
def test_what_has_no_square_is_refused_like_anything_too_large(pm400: Bench, stage: dict[str, Any]) -> None:
    assert re.search(r"e\+(29\d|300) [AV]", refusal(pm400, stage))


def test_a_step_that_ends_at_once_is_no_step(pm400: Bench) -> None:
    drive = pm400.capabilities(**dict.fromkeys(("excitations", "watchdog_covers"), KINDS | {"steps"}))
    with pytest.raises(ProcedureError, match=r"stages\.0: steps: .* impossible duration_s: .* too small a number"):
        make_plan(pm400.procedure({"kind": "steps", "voltages_v": [1e300, 1e300]}), drive)


def test_the_peak_voltage_is_resistive_drop_and_injection(pm400: Bench) -> None:
    slow = {**INJECTION, "control": {"bandwidth_hz": 1.0}}
    assert summary_of(pm400, slow).peak_voltage_v == pytest.approx(4.25 + 40.0)


def test_the_current_controls_step_counts_but_never_past_the_limit(pm400: Bench) -> None:
    stage = {"kind": "resistance", "points_a": [[-3.0, 0.0], [3.0, 0.0]], "settle_s": 0.2, "duration_s": 0.5}
    fast = {**stage, "control": {"bandwidth_hz": 200.0}}
    resistive = 4.25 * 3.0
    assert resistive < (summary_of(pm400, stage).peak_voltage_v or 0.0) < 150.0
    assert summary_of(pm400, fast).peak_voltage_v == 150.0


def test_stages_add_up(pm400: Bench) -> None:
    summary = summary_of(pm400, {"kind": "gates_off"}, HOLD, INJECTION)
    assert [row.stage for row in summary.stages] == ["gates_off", "resistance", "injection"]
    assert sum(row.points for row in summary.stages) == summary.points == 3
    assert sum(row.duration_s for row in summary.stages) == pytest.approx(summary.duration_s)
    assert sum(row.energy_j or 0.0 for row in summary.stages) == pytest.approx(summary.energy_j)
    assert max(row.peak_current_a for row in summary.stages) == summary.peak_current_a


def test_the_paper_takes_its_300_s_of_sweeps_and_4575_s_of_injection(pm400: Bench) -> None:
    drive = pm400.capabilities(max_current_a=6.0)
    summary = check_plan(make_plan(load_procedure("paper"), drive), drive)
    assert summary.captured_s == pytest.approx(300.0 + 915 * 5.0, abs=10.0)
    assert summary.rows == pytest.approx(49e6, rel=0.01)
    assert 4.24 < summary.peak_current_a < 5.0


def test_the_demo_takes_about_a_minute(pm400: Bench) -> None:
    drive = pm400.capabilities()
    assert check_plan(make_plan(load_procedure("demo"), drive), drive).duration_s == pytest.approx(60.0, abs=15.0)


@pytest.mark.parametrize(("name", "page"), [("demo", "README.md"), ("adaptive", "docs/adaptive.md")])
def test_a_procedure_and_its_page_state_the_duration_that_is_planned(name: str, page: str) -> None:
    procedure = load_procedure(name)
    with connected_drive(procedure, private=None) as (_, drive):
        planned = f"{check_plan(make_plan(procedure, drive), drive).duration_s:.0f} s of the drive's time"
    for text in ((Path(__file__).parents[3] / page).read_text(encoding="utf-8"), procedure.summary):
        assert planned in text
    assert planned in shipped_procedure(name)


def test_without_a_drive_the_procedures_own_limits_are_checked(pm400: Bench) -> None:
    plan = make_plan(pm400.procedure(INJECTION), None)
    assert check_plan(plan, None).rows is None
    tight = pm400.procedure(INJECTION, limits={"current_a": 1.2, "voltage_v": 150.0})
    with pytest.raises(CapabilityError, match=r"limits\.current_a"):
        check_plan(make_plan(tight, None), None)


LIMITS = {"current_a": 5.0, "voltage_v": 150.0}


@pytest.mark.parametrize(
    ("stages", "fields", "drive", "where", "problem"),
    [
        ([HOLD], {"limits": {**LIMITS, "current_a": 4.9}}, {}, "stages.0.points_a", "at (3, 4) A"),
        (
            [{"kind": "injection", "range_a": 4.0}],
            {},
            {},
            "stages.0.range_a",
            "ripple; limits.current_a is 5 A",
        ),
        ([{"kind": "injection", "points_a": [[4, 4]]}], {}, {}, "stages.0.points_a", "(4, 4) A"),
        ([{"kind": "classical", "amplitude_a": 6.0}], {}, {}, "stages.0.amplitude_a", "reaches"),
        ([{"kind": "alignment", "current_a": 6.0}], {}, {}, "stages.0.current_a", "reaches 6 A"),
        (
            [{"kind": "lock_check", "torque_current_a": 6.0}],
            {},
            {},
            "stages.0.torque_current_a",
            "limits.current_a is 5 A",
        ),
        ([INJECTION], {"limits": {**LIMITS, "voltage_v": 44.0}}, {}, "stages.0.amplitudes_v", "needs 44.25 V"),
        ([INJECTION], {}, {"dc_bus_voltage_v": 75.0}, "stages.0.amplitudes_v", "a bus of 75 V"),
        ([HOLD], {"limits": {**LIMITS, "current_a": 50.0}}, {}, "limits.current_a", "the drive takes 6 A"),
        ([HOLD], {"limits": {**LIMITS, "voltage_v": 400.0}}, {}, "limits.voltage_v", "the drive gives"),
        ([HOLD], {"limits": {**LIMITS, "energy_j": 600.0}}, {}, "limits.energy_j", "stages.0 (resistance)"),
        ([HOLD], {"limits": {**LIMITS, "duration_s": 3.0}}, {}, "limits.duration_s", "stages.0 (resistance)"),
        ([HOLD], {}, {"longest_excitation_s": 0.5}, "stages.0.duration_s", "longest capture after"),
        ([INJECTION], {}, {"frequency_step_hz": 300.0}, "stages.0.frequency_hz", "no nearby multiple"),
        ([INJECTION], {}, {"excitations": KINDS - {"injection"}}, "stages.0", "it has gates_off, hold, trapezoid"),
        (
            [{**HOLD, "pwm_frequencies_hz": [15_000.0]}],
            {},
            {},
            "stages.0.pwm_frequencies_hz",
            "(10000, 20000 Hz)",
        ),
        (
            [{"kind": "gates_off"}, HOLD, {"kind": "classical"}, INJECTION],
            {},
            {"excitations": frozenset({"hold"})},
            "stages.0, stages.2, stages.3",
            "has no gates_off, injection, trapezoid; it has hold",
        ),
        ([HOLD], {}, {"watchdog_s": None}, "drive.name", "has no dead man"),
        ([HOLD], {}, {"watchdog_s": None}, "drive.name", '"I stand beside the drive and can cut its power"'),
        ([HOLD], {}, {"watchdog_covers": KINDS - {"hold"}}, "drive.name", "does not work during hold"),
        ([HOLD], {}, {"motor_name": "another"}, "motor.name", "set up for 'another'"),
        ([{**INJECTION, "frequency_hz": 470.0}], {}, {}, "stages.0.frequency_hz", "the nearest is 454.5454545 Hz"),
        ([{**INJECTION, "frequency_hz": 10_000 / 15}], {}, {}, "stages.0.frequency_hz", "the nearest is 625 Hz"),
        ([{**INJECTION, "frequency_hz": 5000.0}], {}, {}, "stages.0.frequency_hz", "the nearest is 2500 Hz"),
        (
            [{"kind": "classical", "period_s": 0.05, "amplitude_a": 0.5, "held_a": [0]}],
            {},
            {},
            "stages.0.period_s",
            "0.1 s",
        ),
        ([{**HOLD, "control": {"bandwidth_hz": 900.0}}], {}, {}, "stages.0.control.bandwidth_hz", "at most 500 Hz"),
        (
            [{"kind": "operator", "prompt": "?", "brake": "release"}, HOLD],
            {},
            {},
            "stages.1.points_a",
            "brake is released",
        ),
        ([{"kind": "operator", "prompt": "?", "brake": "release"}, INJECTION], {}, {}, "stages.1", "brake: engage"),
        ([{"kind": "lock_check", "amplitude_v": 160.0}], {}, {}, "stages.0.amplitude_v", "limits.voltage_v is 150 V"),
    ],
)
def test_a_plan_that_asks_for_too_much_is_refused_by_stage_and_field(
    pm400: Bench, stages: list[dict[str, Any]], fields: dict[str, Any], drive: dict[str, Any], where: str, problem: str
) -> None:
    text = refusal(pm400, *stages, drive=drive, **fields)
    assert text.startswith(f"bench: {where}: "), text
    assert problem in text


def test_energy_without_a_resistance_cannot_be_checked_and_is_refused(pm400: Bench) -> None:
    motor = {"name": "unknown", "pole_pairs": 2}
    text = refusal(pm400, HOLD, motor=motor, limits={**LIMITS, "energy_j": 1e9})
    assert "motor.stator_resistance_ohm is missing" in text


def test_an_odd_number_of_samples_is_good_enough_for_a_sine(pm400: Bench) -> None:
    summary_of(pm400, {**INJECTION, "frequency_hz": 10_000 / 15, "waveform": "sine"})


def test_a_drive_without_a_dead_man_is_taken_on_the_operators_sentence(pm400: Bench) -> None:
    drive = pm400.capabilities(watchdog_s=None, watchdog_covers=frozenset())
    sentence = "I stand beside the drive and can cut its power"
    check_plan(make_plan(pm400.procedure(HOLD, accept_no_watchdog=sentence), drive), drive)


def test_gates_off_needs_no_dead_man_of_its_own(pm400: Bench) -> None:
    drive = pm400.capabilities(watchdog_covers=KINDS - {"gates_off"})
    check_plan(make_plan(pm400.procedure({"kind": "gates_off"}, HOLD), drive), drive)


def test_direct_current_on_d_is_allowed_while_the_rotor_is_free(pm400: Bench) -> None:
    release = {"kind": "operator", "prompt": "?", "brake": "release"}
    summary_of(pm400, release, {"kind": "alignment"}, {"kind": "resistance", "anchor": True})


def test_the_drive_that_the_procedure_was_written_for_is_accepted(pm400: Bench) -> None:
    drive = pm400.capabilities(motor_name="400 W test PMSM")
    check_plan(make_plan(pm400.procedure(HOLD), drive), drive)


def test_a_bus_as_the_rated_voltage_is_blamed_where_the_limit_follows_from_it() -> None:
    bench = replace(SERVO, motor={**SERVO.motor, "rated_voltage_rms_v": 48.0})
    complaint = refusal(bench, HOLD, limits={"current_a": 21.0, "voltage_v": 39.19}, drive={"max_voltage_v": 27.71})
    assert "motor.rated_voltage_rms_v: 48 V is more than the 33.94 V line to line rms of the drive" in complaint
    assert "set limits.voltage_v to 27.71" in complaint


def test_what_contradicts_itself_is_a_warning_and_no_note(pm400: Bench) -> None:
    summary = summary_of(replace(pm400, motor={**pm400.motor, "rated_torque_nm": 1e-3}), HOLD)
    assert any("contradict each other" in warning for warning in summary.warnings)
    assert not any("contradict" in note for note in summary.notes)
