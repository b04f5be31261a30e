"""The paper's integration on sweeps that are known."""

from __future__ import annotations

import numpy as np
import pytest

from plugins.commands.reproduction.literal._integration import SweptPath, swept_path, tied
from protocols import Capture, NotMeasuredError, Segment, SegmentStage

RATE_HZ, OHM, L_D, L_Q, PERIODS = 10_000.0, 4.5, 0.04, 0.07, 3
CORNERS_S, LEVELS = (0.0, 0.25, 0.75, 1.25, 1.75, 2.0), (0.0, 3.0, 3.0, -3.0, -3.0, 0.0)


def swept(axis: str = "d", held_a: float = 0.0, lost_v: float = 0.0) -> SweptPath:
    """A linear motor's sweep; `lost_v` of a constant voltage on d does not reach it."""
    return swept_path(*captured(axis, held_a, lost_v))


def captured(axis: str, held_a: float, lost_v: float = 0.0) -> tuple[Segment, Capture]:
    t = np.arange(round(2.0 * PERIODS * RATE_HZ)) / RATE_HZ
    along = np.interp(t % 2.0, CORNERS_S, LEVELS)
    column = "dq".index(axis)
    i = np.full((len(t), 2), held_a)
    i[:, column] = along
    ahead = np.roll(i, -1, axis=0)  # the voltage of a row is held until the next
    v = 0.5 * OHM * (i + ahead) + np.array([L_D, L_Q]) * (ahead - i) * RATE_HZ
    v[:, 0] += lost_v
    settings = {"swept_axis": axis, "held_a": held_a}
    segment = Segment(id="classical-000", stage=SegmentStage.CLASSICAL, start_s=0.0, samples=len(t), settings=settings)
    return segment, Capture(start_s=0.0, sampling_frequency_hz=RATE_HZ, i_ab=i, v_ab=v, v_dc=np.full(len(t), 540.0))


def test_a_linear_motor_comes_out_with_its_resistance_and_inductance() -> None:
    found = swept()
    assert found.resistance_ohm == pytest.approx(OHM, rel=1e-6)
    assert np.abs(found.path.psi[:, 0] - L_D * found.path.current[:, 0]).max() < 2e-3 * L_D * 3.0


def test_a_voltage_that_is_lost_runs_away_unless_the_drift_is_taken_out() -> None:
    part = captured("d", 0.0, lost_v=0.5)
    away, closed = (
        np.ptp(one.path.psi[:, 0] - L_D * one.path.current[:, 0])
        for one in (swept_path(*part), swept_path(*part, closed=True))
    )
    assert away > 0.3
    assert closed < 0.1 * away


def test_a_path_beside_zero_begins_where_it_crosses_the_axis() -> None:
    paths = tied([swept("d"), swept("q"), swept("q", held_a=2.0)])
    beside = paths[2]
    middle = np.argmin(np.abs(beside.current[:, 1]))
    assert beside.psi[middle, 0] == pytest.approx(2.0 * L_D, rel=5e-3)
    assert len(tied([swept("q", held_a=2.0)])) == 0


def test_a_current_that_never_rests_has_no_resistance() -> None:
    t = np.arange(20_000) / RATE_HZ
    i = np.stack([3.0 * np.sin(2.0 * np.pi * t), np.zeros_like(t)], axis=1)
    segment = Segment(
        id="classical-000",
        stage=SegmentStage.CLASSICAL,
        start_s=0.0,
        samples=len(t),
        settings={"swept_axis": "d", "held_a": 0.0},
    )
    capture = Capture(start_s=0.0, sampling_frequency_hz=RATE_HZ, i_ab=i, v_ab=i, v_dc=np.full(len(t), 540.0))
    with pytest.raises(NotMeasuredError, match="never rests"):
        swept_path(segment, capture)
