"""A run that is taken up again goes on bit for bit as if it had never stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plugins.drives.simulated import SimulatedDrive, misalignment
from protocols import DriveRefused, Excitation, GatesOff, Hold, Injection, Limits, Trapezoid
from tests.plugins.drives.simulated.conftest import Bench, rows

EVERYTHING: dict[str, Any] = {
    "dead_time": {"voltage_v": 3.0},
    "hysteresis": {"half_width_a": 0.04},
    "winding_heating": {"rise_per_watt": 1e-3, "time_constant_s": 5.0},
    "magnet_heating": {"flux_change_wb": -0.01, "time_constant_s": 5.0},
    "skin_effect": {"extra_ohm": 1.0},
    "current_filter": {"time_constant_s": 5e-6},
    "voltage_delay": {"delay_s": 1e-5},
    "brake_compliance": {"rad_per_nm": 0.005},
}
CAMPAIGN: tuple[Excitation, ...] = (
    Hold(current_d_a=2.0, current_q_a=0.0, settle_s=1.0, duration_s=0.1),
    Injection(
        target_d_a=1.0,
        target_q_a=1.0,
        settle_s=0.3,
        duration_s=0.7,
        amplitude_v=40.0,
        frequency_hz=500.0,
        rotation_hz=1.0,
    ),
    GatesOff(duration_s=0.1),
    Trapezoid(swept_axis="d", held_a=1.0, amplitude_a=2.0, period_s=0.5, periods=1, settle_s=0.2),
)


def drive_of(bench: Bench, private: Path) -> SimulatedDrive:
    return bench(private=private, effects=EVERYTHING, noise=True, armed=False, plant={"brake": {"start": "released"}})


def arm(drive: SimulatedDrive) -> None:
    drive.arm(Limits(current_a=4.0, voltage_v=150.0))


@pytest.mark.parametrize("stop", [0, 1, 2])
def test_a_restored_run_is_the_same_bit_for_bit(bench: Bench, tmp_path: Path, stop: int) -> None:
    whole = drive_of(bench, tmp_path)
    arm(whole)
    samples = []
    for number, excitation in enumerate(CAMPAIGN):
        samples.append(rows(whole, excitation))
        if number == 0:
            whole.set_brake(True)
        if number == stop:
            whole.checkpoint(f"point-{number}")
            clock = whole.telemetry().time_s
    again = drive_of(bench, tmp_path)
    again.restore(f"point-{stop}", clock)
    arm(again)
    for excitation, (i, v) in zip(CAMPAIGN[stop + 1 :], samples[stop + 1 :], strict=True):
        other_i, other_v = rows(again, excitation)
        assert np.array_equal(i, other_i)
        assert np.array_equal(v, other_v)
    assert again.telemetry() == whole.telemetry()


def test_the_last_two_checkpoints_are_kept_whole(bench: Bench, tmp_path: Path) -> None:
    drive = drive_of(bench, tmp_path)
    arm(drive)
    for number in range(4):
        rows(drive, GatesOff(duration_s=0.01))
        drive.checkpoint(f"point-{number}")
    assert len(list(tmp_path.glob("plant-*.json"))) == 2
    assert not list(tmp_path.glob("*.tmp"))
    again = drive_of(bench, tmp_path)
    again.restore("point-2", 1.0)
    assert again.telemetry().time_s == pytest.approx(1.0)
    with pytest.raises(DriveRefused, match="point-1"):
        again.restore("point-1", 1.0)


def test_a_torn_checkpoint_is_passed_over(bench: Bench, tmp_path: Path) -> None:
    drive = drive_of(bench, tmp_path)
    arm(drive)
    rows(drive, GatesOff(duration_s=0.01))
    drive.checkpoint("point-0")
    (tmp_path / "plant-999999999999999-000009.json").write_text('{"point_id": "point-0", "sta')
    drive_of(bench, tmp_path).restore("point-0", 0.0)


def test_an_armed_drive_takes_no_other_state(bench: Bench, tmp_path: Path) -> None:
    drive = drive_of(bench, tmp_path)
    arm(drive)
    drive.checkpoint("point-0")
    with pytest.raises(DriveRefused, match="disarmed"):
        drive.restore("point-0", 0.0)


def test_a_sealed_state_tells_at_which_angle_the_rotor_rests(bench: Bench, tmp_path: Path) -> None:
    effects = {"rotor_misalignment": {"angle_rad": 0.05}, "brake_compliance": {"rad_per_nm": 0.02}}
    drive = bench(private=tmp_path, effects=effects, plant={"rotor": {"rest_angle_rad": 0.4}})
    assert misalignment(tmp_path) is None
    rows(drive, Hold(current_d_a=0.0, current_q_a=1.0, settle_s=0.2, duration_s=0.1, rotor_angle_rad=0.4))
    drive.checkpoint("point-0")
    assert misalignment(tmp_path) == pytest.approx(0.05)  # the brake's twist under torque aside
