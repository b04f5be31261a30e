"""The lock check behind switched inverters: dead time, device drop and a sampling offset are no rotation."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import pytest

from orchestrator.analysis import judge_lock
from orchestrator.config import PlannedPoint, make_plan
from orchestrator.stages import stiffest_hold_a
from plugins.drives.simulated import SimulatedDrive, SimulatedOptions
from protocols import Capture, DriveSetup, LockChecked, Procedure, Segment, SegmentStage
from tests.support.simulated import joined

TOLERANCE_RAD = 0.02
MOVED_DEG = 2.0

# L_d [H], L_q / L_d, R_s [ohm], rated current [A rms], magnet's flux [Wb], pole pairs, bus [V], sampling [Hz]
MOTORS = [
    (1e-6, 1.2, 2e-3, 200, 1.5e-3, 7, 24, 40e3),
    (2e-6, 1.0, 4e-3, 120, 1.5e-3, 7, 24, 40e3),
    (4e-6, 1.3, 8e-3, 80, 2e-3, 7, 36, 40e3),
    (8e-6, 1.1, 12e-3, 60, 3e-3, 7, 36, 20e3),
    (20e-6, 1.3, 25e-3, 35, 5e-3, 7, 40, 20e3),
    (20e-6, 1.0, 40e-3, 25, 4e-3, 7, 24, 20e3),
    (40e-6, 1.2, 50e-3, 20, 5e-3, 7, 48, 20e3),
    (70e-6, 1.0, 90e-3, 20, 6e-3, 10, 48, 20e3),
    (100e-6, 1.5, 20e-3, 100, 0.02, 4, 96, 16e3),
    (200e-6, 1.1, 0.3, 8, 8e-3, 4, 48, 20e3),
    (360e-6, 1.0, 5.85, 0.68, 0.0211, 2, 42, 20e3),
    (0.4e-3, 2.75, 0.03, 145, 0.1, 4, 400, 10e3),
    (1e-3, 1.3, 0.6, 6, 0.02, 4, 48, 16e3),
    (2.1e-3, 1.0, 1.5, 1.9, 0.012, 4, 24, 16e3),
    (4e-3, 1.2, 1.0, 8, 0.1, 4, 320, 10e3),
    (8e-3, 1.5, 2.0, 5, 0.15, 4, 320, 8e3),
    (15e-3, 1.0, 6.0, 2, 0.1, 3, 320, 8e3),
    (43.25e-3, 1.6, 4.25, 1.66, 0.3, 2, 540, 10e3),
    (60e-3, 2.5, 12.0, 1.2, 0.4, 2, 540, 10e3),
    (100e-3, 1.2, 20.0, 0.8, 0.5, 2, 540, 8e3),
]

OUTRUNNER = {
    "name": "6374 outrunner",
    "pole_pairs": 7,
    "rated_current_rms_a": 35,
    "rated_voltage_rms_v": 25,
    "stator_resistance_ohm": 0.025,
    "d_inductance_h": 20e-6,
    "q_inductance_h": 26e-6,
    "pm_flux_wb": 5e-3,
}
OUTRUNNER_LIMITS = {"current_a": 60.0, "voltage_v": 16.0}
OUTRUNNER_DRIVE = {
    "dc_bus_voltage_v": 40.0,
    "sampling_frequency_hz": 20e3,
    "current_sensors": 3,
    "plant": {
        "inverter": "switched",
        "switching": {"dead_time_s": 0.36e-6, "sampling_offset_s": 1e-6},
        "effects": {
            "current_gain_mismatch": {"gain_a_minus_b": 0.04},
            "current_offset": {"offset_a_a": 0.3, "offset_b_a": -0.2},
        },
        "sensors": {"gain_c_minus_1": 0.03, "even_per_a": 2e-4, "noise_a": 0.2, "bits": 12, "full_scale_a": 165},
    },
}


def check_lock(
    motor: dict[str, Any],
    limits: dict[str, float],
    drive: dict[str, Any],
    moved_deg: float | None = 0.0,
    *,
    duration_s: float = 0.5,
    seed: int = 1,
) -> LockChecked:
    """The verdict; as the torque comes the rotor is turned by so much (electrically). None: it is free."""
    procedure = Procedure.model_validate(
        {
            "format": "fluxbench-procedure",
            "version": 1,
            "name": "lock",
            "motor": motor,
            "limits": limits,
            "drive": {"name": "simulated", "watchdog_s": None, **drive},
            "seed": seed,
            "stages": [{"kind": "alignment"}, {"kind": "lock_check", "duration_s": duration_s}, {"kind": "resistance"}],
        }
    )
    options = SimulatedOptions.model_validate(procedure.drive.options)
    device = SimulatedDrive(DriveSetup(motor=procedure.motor, options=options, seed=seed))
    capabilities = device.connect()
    device.arm(procedure.limits)
    measured = []
    for point in make_plan(procedure, capabilities).points:
        if point.stage == SegmentStage.RESISTANCE:
            break
        if moved_deg is not None and point.settings.get("torque"):
            device._plant.turn_to(math.radians(moved_deg))
        capture = execute(device, point)
        if point.stage == SegmentStage.LOCK_CHECK:
            measured.append((segment_of(point, capture), capture))
    device.close()
    return judge_lock(
        measured,
        TOLERANCE_RAD,
        voltage_delay_samples=capabilities.voltage_delay_samples or 0.0,
        aligning_current_a=2.0 * stiffest_hold_a(procedure.motor),
    )


def execute(device: SimulatedDrive, point: PlannedPoint) -> Capture:
    return joined([block for block in device.execute(point.excitation) if len(block)])


def segment_of(point: PlannedPoint, capture: Capture) -> Segment:
    return Segment(
        id=point.id,
        stage=point.stage,
        start_s=capture.start_s,
        samples=len(capture),
        rotor_angle_rad=0.0,
        settings=point.settings,
    )


def test_dead_time_of_a_held_outrunner_is_no_movement() -> None:
    verdict = check_lock(OUTRUNNER, OUTRUNNER_LIMITS, OUTRUNNER_DRIVE)
    assert verdict.locked, verdict.summary
    assert abs(verdict.moved_rad) < 3.0 * verdict.moved_std_rad


def test_a_rotation_behind_dead_time_is_measured() -> None:
    verdict = check_lock(OUTRUNNER, OUTRUNNER_LIMITS, OUTRUNNER_DRIVE, MOVED_DEG)
    assert verdict.locked is False, verdict.summary
    assert verdict.moved_rad == pytest.approx(math.radians(MOVED_DEG), abs=3.0 * verdict.moved_std_rad)


def test_a_current_that_the_control_does_not_reach_is_named() -> None:
    motor, limits, drive = bench(MOTORS[0], 2e-6)
    verdict = check_lock(motor, limits, drive)
    assert verdict.locked is None
    assert "longer settle_s" in verdict.summary


@pytest.mark.parametrize("friction", [0.0, 0.02, 0.3])
@pytest.mark.parametrize(
    "row", [MOTORS[4], MOTORS[8], MOTORS[11]], ids=["outrunner", "salient", "reluctance outweighs"]
)
def test_a_free_rotor_that_the_current_at_rest_brings_back_is_not_locked(
    row: tuple[float, ...], friction: float
) -> None:
    motor, limits, drive = bench(row, 0.5e-6)
    motor["rated_torque_nm"] = 1.5 * row[5] * row[4] * math.sqrt(2.0) * row[3]
    drive["plant"]["brake"] = {"works": False, "start": "released"}
    drive["plant"]["rotor"] = {"coulomb_nm": friction * motor["rated_torque_nm"]}
    verdict = check_lock(motor, limits, drive, None)
    assert not verdict.locked, verdict.summary


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_twenty_motors_behind_dead_time_are_judged_without_an_error() -> None:
    """Of 60 held rotors 12 and of 120 that moved 12 are not known; the rest is right."""
    counts: Counter[tuple[bool, bool | None]] = Counter()
    for number, row in enumerate(MOTORS):
        for dead_time_s in (0.2e-6, 0.7e-6, 2e-6):
            motor, limits, drive = bench(row, dead_time_s)
            for moved_deg in (0.0, MOVED_DEG, -MOVED_DEG):
                verdict = check_lock(motor, limits, drive, moved_deg, duration_s=2.0, seed=number + 1)
                counts[moved_deg == 0.0, verdict.locked] += 1
    assert counts[True, False] == 0, counts
    assert counts[False, True] == 0, counts
    assert counts[True, True] >= 45, counts
    assert counts[False, False] >= 105, counts


def bench(row: tuple[float, ...], dead_time_s: float) -> tuple[dict[str, Any], dict[str, float], dict[str, Any]]:
    l_d, ratio, ohm, rated_a, flux, pole_pairs, bus_v, sampling_hz = row
    motor = {
        "name": "motor",
        "pole_pairs": int(pole_pairs),
        "rated_current_rms_a": rated_a,
        "stator_resistance_ohm": ohm,
        "d_inductance_h": l_d,
        "q_inductance_h": ratio * l_d,
        "pm_flux_wb": flux,
    }
    plant = {
        "inverter": "switched",
        "switching": {"dead_time_s": dead_time_s, "sampling_offset_s": 1e-6},
        "effects": {"device_drop": {"voltage_v": min(1.0, 0.01 * bus_v)}},
    }
    limits = {"current_a": 1.8 * math.sqrt(2.0) * rated_a, "voltage_v": 0.45 * bus_v, "energy_j": 1e9}
    return motor, limits, {"dc_bus_voltage_v": bus_v, "sampling_frequency_hz": sampling_hz, "plant": plant}
