"""The drive's side: control, injection, what a capture is, what is refused, alignment and brake."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plugins.drives.simulated import SimulatedDrive, SimulatedOptions, map_motor
from plugins.drives.simulated import _state as layout
from protocols import (
    Capabilities,
    CurrentControl,
    Drive,
    DriveRefused,
    DriveSetup,
    DriveState,
    Excitation,
    GatesOff,
    Hold,
    Injection,
    InputError,
    Limits,
    Motor,
    ResumableDrive,
    Trapezoid,
)
from tests.plugins.drives.simulated.conftest import LARGE, MOTORS, PM400, Bench, joined, options_of, rows

INJECTION = Injection(
    target_d_a=0.5, target_q_a=-1.0, settle_s=0.4, duration_s=1.0, amplitude_v=40.0, frequency_hz=500.0, rotation_hz=2.0
)


def hold(d: float, q: float, **more: Any) -> Hold:
    return Hold(**{"current_d_a": d, "current_q_a": q, "settle_s": 0.3, "duration_s": 0.2, **more})


def theta(drive: SimulatedDrive) -> float:
    return float(drive._plant.memory.state[layout.THETA])


def test_it_is_a_drive_with_a_memory(bench: Bench) -> None:
    drive = bench()
    assert isinstance(drive, Drive)
    assert isinstance(drive, ResumableDrive)


@pytest.mark.parametrize("motor", MOTORS)
def test_a_motor_of_any_size_settles_within_a_few_time_constants(bench: Bench, motor: Motor) -> None:
    drive = bench(motor)
    rated = motor.rated_current_a or 0.0
    i, _ = rows(drive, hold(0.5 * rated, -0.6 * rated, settle_s=0.0, duration_s=0.3))
    settled = i[round(5 / (2 * math.pi * 25.0) * 10_000) :]
    assert np.abs(settled[:, 0] - 0.5 * rated).max() < 0.05 * rated
    assert np.abs(settled[:, 1] + 0.6 * rated).max() < 0.05 * rated
    assert np.abs(i[-100:].mean(axis=0) - rated * np.array([0.5, -0.6])).max() < 1e-3 * rated


def test_control_holds_against_eight_volts_of_dead_time(bench: Bench) -> None:
    drive = bench(effects={"dead_time": {"voltage_v": 8.0}}, noise=True)
    for target in ((0.1, 0.0), (3.0, 0.0), (-3.0, 2.0), (0.0, 0.05)):
        i, _ = rows(drive, hold(*target, settle_s=0.5))
        assert i.mean(axis=0) == pytest.approx(target, abs=3e-3)


@pytest.mark.parametrize("bandwidth", [5.0, 25.0, 200.0])
def test_the_bandwidth_is_what_was_requested(bench: Bench, bandwidth: float) -> None:
    """A small step of the second-order loop overshoots little and arrives within its own time."""
    magnetics = {"kind": "nameplate", "d_fall": 0.0, "q_fall": 0.0, "cross": 0.0}
    drive = bench(plant={"magnetics": magnetics})
    i, _ = rows(drive, hold(0.0, 0.1, settle_s=0.0, duration_s=0.6, control=CurrentControl(bandwidth_hz=bandwidth)))
    arrival = int(np.argmax(i[:, 1] > 0.063)) / 10_000 * 2 * math.pi * bandwidth
    assert 0.2 < arrival < 2.0
    assert i[:, 1].max() < 0.1 * 1.3


def test_integrals_do_not_wind_up_at_the_voltage_limit(bench: Bench) -> None:
    drive = bench(max_voltage_v=12.0)
    i, v = rows(drive, hold(0.0, 5.0, settle_s=0.0, duration_s=1.0))
    assert np.hypot(v[:, 0], v[:, 1]).max() <= 12.0 * (1 + 1e-6)
    assert i[-1, 1] == pytest.approx(12.0 / 4.25, abs=0.01)
    i, _ = rows(drive, hold(0.0, 1.0, settle_s=0.0, duration_s=0.2))
    assert np.abs(i[600:, 1] - 1.0).max() < 0.05


def test_a_trapezoid_is_the_papers(bench: Bench) -> None:
    drive = bench()
    trapezoid = Trapezoid(swept_axis="q", held_a=1.0, amplitude_a=3.0, period_s=2.0, periods=2, settle_s=0.3)
    i, _ = rows(drive, trapezoid)
    assert len(i) == 40_000
    t = np.arange(40_000) / 10_000 % 2.0
    wanted = np.interp(t, [0.0, 0.25, 0.75, 1.25, 1.75, 2.0], [0.0, 3.0, 3.0, -3.0, -3.0, 0.0])
    assert np.abs(i[:, 1] - wanted).max() < 0.15
    assert np.abs(i[6_500:7_500, 1] - 3.0).max() < 2e-3
    assert np.abs(i[:, 0] - 1.0).max() < 0.1
    both, _ = rows(drive, trapezoid.model_copy(update={"swept_axis": "dq"}))
    assert both[7_000] == pytest.approx([3 / math.sqrt(2)] * 2, abs=2e-3)


def test_a_trapezoid_whose_corners_fall_between_samples_keeps_its_length(bench: Bench) -> None:
    drive = bench()
    odd = Trapezoid(swept_axis="d", amplitude_a=1.0, period_s=0.033_33, periods=7, settle_s=0.1)
    blocks = list(drive.execute(odd))
    assert sum(map(len, blocks)) == round(7 * 0.033_33 * 10_000)


def test_injection_is_a_rotating_square_wave_on_a_frozen_voltage(bench: Bench) -> None:
    drive = bench(effects={"dead_time": {"voltage_v": 8.0}})
    i, v = rows(drive, INJECTION)
    t = np.arange(10_000) / 10_000
    wave = np.where(np.arange(10_000) % 20 < 10, 40.0, -40.0)
    turn = 2 * math.pi * 2.0 * t
    base = v - wave[:, None] * np.column_stack((np.cos(turn), np.sin(turn)))
    assert np.ptp(base, axis=0).max() < 1e-4
    late = i[5_000:]
    assert late.mean(axis=0) == pytest.approx([0.5, -1.0], abs=0.02)
    assert 0.4 < np.abs(late[:, 0] - 0.5).max() < 0.6  # +-20 mWb on 43 mH
    assert np.abs(i[:10, 0] - 0.5).max() > 0.8  # the wave starts a period: one-sided at first


def test_a_sine_may_be_injected_and_discarding_goes_on_in_phase(bench: Bench) -> None:
    sine = INJECTION.model_copy(update={"waveform": "sine", "discard_s": 0.0503, "duration_s": 0.2})
    _, v = rows(bench(), sine)
    t = (np.arange(2_000) + 503) / 10_000
    wave = 40.0 * np.sin(2 * math.pi * 500.0 * t)
    base = v - wave[:, None] * np.column_stack((np.cos(4 * math.pi * t), np.sin(4 * math.pi * t)))
    assert np.ptp(base, axis=0).max() < 1e-4


def test_an_excitation_may_lie_at_any_believed_angle(bench: Bench) -> None:
    drive = bench(plant={"rotor": {"rest_angle_rad": 1.0}})
    i, v = rows(drive, hold(1.0, 2.0, rotor_angle_rad=1.0))
    c, s = math.cos(1.0), math.sin(1.0)
    assert i.mean(axis=0) == pytest.approx([c - 2 * s, s + 2 * c], abs=1e-3)
    assert v.mean(axis=0) == pytest.approx(4.25 * i.mean(axis=0), abs=1e-2)
    assert drive.telemetry().i_d_a == pytest.approx(1.0, abs=1e-3)


def test_captures_are_gap_free_blocks_of_half_a_second_at_most(bench: Bench) -> None:
    drive = bench(gap_s=0.25)
    first = list(drive.execute(hold(1.0, 0.0, duration_s=1.3)))
    assert [len(b) for b in first] == [5_000, 5_000, 3_000]
    assert [b.start_s for b in first] == pytest.approx([0.3, 0.8, 1.3], abs=1e-12)
    second = list(drive.execute(hold(1.0, 0.0, duration_s=0.1)))
    assert second[0].start_s == pytest.approx(1.6 + 0.25 + 0.3, abs=1e-12)
    assert drive.telemetry().time_s == pytest.approx(2.25, abs=1e-12)


def test_a_thermometer_in_the_winding_is_recorded_as_the_winding_warms(bench: Bench) -> None:
    heating = {"winding_heating": {"rise_per_watt": 0.003, "time_constant_s": 20.0}}
    drive = bench(effects=heating, thermometer=True)
    blocks = list(drive.execute(hold(3.0, 0.0, duration_s=4.0)))
    assert all(b.temperature_c is not None for b in blocks)
    warmth = np.concatenate([b.temperature_c for b in blocks if b.temperature_c is not None])
    risen = float(drive._plant.memory.state[layout.HEAT])
    assert warmth[-1] == pytest.approx(20.0 + risen / 0.00393, rel=1e-3)
    assert np.diff(warmth).min() >= 0.0
    # 57 W (and more as it warms) for 4 s, of which a lag of 20 s shows 18 %, make 0.03 more resistance.
    assert warmth[-1] - warmth[0] == pytest.approx(0.18 * 57.4 * 0.003 / 0.00393, rel=0.1)
    assert drive.telemetry().temperature_c == pytest.approx(warmth[-1], rel=1e-3)


def test_without_a_thermometer_no_temperature_is_recorded(bench: Bench) -> None:
    drive = bench()
    assert all(b.temperature_c is None for b in drive.execute(hold(1.0, 0.0)))
    assert drive.telemetry().temperature_c is None


def test_a_row_is_the_current_before_its_voltage_acts(bench: Bench) -> None:
    """psi(i[k+1]) - psi(i[k]) = (v[k] - R i) Ts, on the row of the voltage's edge too."""
    magnetics = {"kind": "nameplate", "d_fall": 0.0, "q_fall": 0.0, "cross": 0.0}
    for delay in (0.0, 1.0, 1.5):
        drive = bench(plant={"magnetics": magnetics}, voltage_delay_samples=delay)
        still = INJECTION.model_copy(update={"rotation_hz": 0.0, "duration_s": 0.1})
        i, v = rows(drive, still)
        moved = np.diff(i[:, 0]) * 0.04325 + 4.25 * 0.5 * (i[1:, 0] + i[:-1, 0]) * 1e-4
        whole, part = int(delay), delay - int(delay)
        acted = (1 - part) * np.roll(v[:, 0], whole) + part * np.roll(v[:, 0], whole + 1)
        assert moved[5:] == pytest.approx(acted[5:-1] * 1e-4, abs=1.2e-5)  # of 4e-3; an edge may lie within


def test_the_operating_point_is_held_after_the_last_block(bench: Bench) -> None:
    drive = bench(gap_s=0.5)
    rows(drive, INJECTION)
    i, _ = rows(drive, hold(0.5, -1.0, settle_s=0.0))
    assert np.abs(i - [0.5, -1.0]).max() < 0.02


def test_alignment_turns_the_free_rotor_onto_the_current(bench: Bench) -> None:
    drive = bench(plant={"brake": {"start": "released"}}, seed=5)
    assert abs(theta(drive)) > 0.1
    rows(drive, hold(PM400.rated_current_a or 0.0, 0.0, settle_s=1.5, rotor_angle_rad=0.4))
    off = math.remainder(theta(drive) - 0.4, 2 * math.pi)
    assert abs(off) < 2e-3
    drive.set_brake(True)
    rows(drive, hold(0.0, 2.0, rotor_angle_rad=0.4))
    assert math.remainder(theta(drive) - 0.4, 2 * math.pi) == pytest.approx(off, abs=1e-12)


def test_the_free_rotors_rest_angle_comes_from_the_seed(bench: Bench) -> None:
    angles = [theta(bench(plant={"brake": {"start": "released"}}, seed=s)) for s in (1, 1, 2)]
    assert angles[0] == angles[1] != angles[2]


@pytest.mark.parametrize("brake", [{"works": False}, {"slip_torque_nm": 0.5}], ids=["never engages", "slips"])
def test_a_bad_brake_lets_the_rotor_turn_under_torque(bench: Bench, brake: dict[str, Any]) -> None:
    drive = bench(plant={"brake": brake, "rotor": {"rest_angle_rad": 0.0}})
    drive.set_brake(True)
    rows(drive, hold(0.0, 2.0))
    assert abs(theta(drive)) > 0.3


def test_engaging_the_brake_turns_the_shaft_by_the_misalignment(bench: Bench) -> None:
    drive = bench(plant={"brake": {"start": "released"}}, effects={"rotor_misalignment": {"angle_rad": 0.05}})
    rows(drive, hold(2.0, 0.0, settle_s=1.5))
    before = theta(drive)
    drive.set_brake(True)
    drive.set_brake(True)
    assert theta(drive) - before == pytest.approx(0.05)


def test_a_drive_without_a_brake_says_so(bench: Bench) -> None:
    drive = bench(has_brake=False)
    with pytest.raises(DriveRefused, match="no brake"):
        drive.set_brake(True)


@pytest.mark.parametrize(
    ("excitation", "complaint"),
    [
        (hold(4.0, 4.5), "above the limit"),
        (hold(1.0, 0.0).model_copy(update={"current_q_a": math.nan}), "current_q_a is not a finite"),
        (hold(1.0, 0.0, pwm_frequency_hz=7_000.0), "PWM frequency"),
        (hold(1.0, 0.0, control=CurrentControl(bandwidth_hz=2_000.0)), "bandwidth"),
        (hold(1.0, 0.0, duration_s=1e-5), "less than a sample"),
        (hold(1.0, 0.0, duration_s=20.0), "longer than"),
        (INJECTION.model_copy(update={"amplitude_v": 400.0}), "above the limit"),
        (INJECTION.model_copy(update={"frequency_hz": 6_000.0}), "half the sampling"),
        (Trapezoid(swept_axis="q", held_a=3.0, amplitude_a=5.5, period_s=1.0, periods=1, settle_s=0.1), "above"),
    ],
)
def test_what_it_cannot_do_is_refused_before_anything_moves(
    bench: Bench, excitation: Excitation, complaint: str
) -> None:
    drive = bench(longest_capture_s=10.0)
    with pytest.raises(DriveRefused, match=complaint):
        drive.execute(excitation)
    assert drive.telemetry().time_s == 0.0


def test_limits_above_its_own_are_refused(bench: Bench) -> None:
    drive = bench(armed=False)
    own = drive.connect()
    with pytest.raises(DriveRefused, match="current limit"):
        drive.arm(Limits(current_a=1.01 * own.max_current_a, voltage_v=10.0))
    with pytest.raises(DriveRefused, match="voltage limit"):
        drive.arm(Limits(current_a=1.0, voltage_v=1.01 * own.max_voltage_v))
    with pytest.raises(DriveRefused, match="not armed"):
        drive.execute(hold(1.0, 0.0))


def test_nothing_is_done_before_connecting() -> None:
    drive = SimulatedDrive(DriveSetup(motor=PM400, options=options_of(), seed=1))
    with pytest.raises(DriveRefused, match="not connected"):
        drive.telemetry()
    with pytest.raises(DriveRefused, match="not connected"):
        drive.arm(Limits(current_a=1.0, voltage_v=10.0))


def test_an_excitation_given_up_does_not_go_on(bench: Bench) -> None:
    drive = bench()
    running = drive.execute(hold(1.0, 0.0, duration_s=2.0))
    next(running)
    drive.ramp_down()
    with pytest.raises(DriveRefused, match="given up"):
        next(running)


def test_ramp_down_and_disarm_bring_the_current_to_zero_any_number_of_times(bench: Bench) -> None:
    drive = bench(effects={"dead_time": {"voltage_v": 8.0}})
    rows(drive, INJECTION)
    drive.ramp_down()
    assert drive.telemetry().state is DriveState.ARMED
    assert math.hypot(drive.telemetry().i_d_a, drive.telemetry().i_q_a) < 0.03
    for _ in range(2):
        drive.disarm()
        drive.ramp_down()
    reading = drive.telemetry()
    assert reading.state is DriveState.DISARMED
    assert math.hypot(reading.i_d_a, reading.i_q_a) < 1e-3


def test_gates_off_reads_no_current_and_no_voltage(bench: Bench) -> None:
    drive = bench()
    rows(drive, hold(3.0, 2.0))
    i, v = rows(drive, GatesOff(duration_s=0.1))
    assert np.abs(i).max() < 1e-6
    assert not v.any()
    assert np.abs(rows(drive, hold(1.0, 0.0))[0].mean(axis=0) - [1.0, 0.0]).max() < 1e-3


def test_the_same_seed_gives_the_same_samples_and_another_does_not(bench: Bench) -> None:
    a, b, c = (joined(list(bench(noise=True, seed=s).execute(INJECTION)))[0] for s in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)


def test_two_excitations_have_different_noise(bench: Bench) -> None:
    drive = bench(noise=True)
    first, second = (rows(drive, GatesOff(duration_s=0.1))[0] for _ in range(2))
    assert not np.array_equal(first, second)


def test_capabilities_say_nothing_of_the_plant(bench: Bench) -> None:
    def capabilities(**raw: Any) -> Capabilities:
        return bench(armed=False, **raw).connect()

    plain = capabilities()
    assert plain.motor_name is None
    assert plain == capabilities(
        effects={"dead_time": {"voltage_v": 8.0}, "hysteresis": {"half_width_a": 0.05}},
        plant={"resistance_ohm": 5.0, "magnetics": {"kind": "nameplate", "q_fall": 0.6}},
    )


def test_a_map_is_a_motor_with_a_name_and_limits_of_its_own(bench: Bench) -> None:
    motor = map_motor("ipm-femm-60c")
    drive = bench(motor, plant={"magnetics": {"kind": "map", "name": "ipm-femm-60c"}})
    own = drive.connect()
    assert own.motor_name == motor.name
    assert own.max_current_a < 200.0
    i, _ = rows(drive, hold(-100.0, 120.0, settle_s=0.5))
    assert i.mean(axis=0) == pytest.approx([-100.0, 120.0], abs=0.1)


def test_a_servo_mapped_for_negative_i_d_only_is_continued_to_the_other_side(bench: Bench) -> None:
    motor = map_motor("beckhoff-am8141-800rpm")
    drive = bench(motor, plant={"magnetics": {"kind": "map", "name": "beckhoff-am8141-800rpm"}})
    i, v = rows(drive, hold(4.0, 3.0))
    assert i.mean(axis=0) == pytest.approx([4.0, 3.0], abs=1e-3)
    assert v.mean(axis=0) == pytest.approx([4.0 * 0.51, 3.0 * 0.51], abs=1e-2)


def test_the_truth_goes_to_the_private_directory_and_nowhere_else(bench: Bench, tmp_path: Path) -> None:
    private = tmp_path / "x.sealed"
    bench(private=private, armed=False, effects={"bus_sag": {"per_watt": 1e-5}})
    assert [p.name for p in tmp_path.rglob("*") if p.is_file()] == ["truth.json"]
    truth = json.loads((private / "truth.json").read_text())
    assert truth["plant"]["effects"]["bus_sag"] == {"per_watt": 1e-5}
    assert truth["derived"]["parameters"]["resistance_ohm"] == 4.25
    assert len(truth["map"]["psi_dq_wb"]) == len(truth["map"]["i_dq_a"]) == 121
    assert SimulatedDrive.sealed_options == {"plant"} <= set(SimulatedOptions.model_fields)


def test_a_bus_that_cannot_be_derived_is_requested() -> None:
    motor = LARGE.model_copy(update={"rated_voltage_rms_v": None})
    drive = SimulatedDrive(DriveSetup(motor=motor, options=options_of(), seed=1))
    with pytest.raises(InputError, match="dc_bus_voltage_v"):
        drive.connect()
