"""What every excitation says of itself: durations, rows, currents."""

from __future__ import annotations

import math

import pytest

from protocols import Excitation, GatesOff, Hold, Injection, Trapezoid

INJECTION = Injection(
    target_d_a=3.0,
    target_q_a=-4.0,
    settle_s=0.5,
    discard_s=0.25,
    duration_s=1.0,
    amplitude_v=40.0,
    frequency_hz=500.0,
    rotation_hz=2.0,
)
HOLD = Hold(current_d_a=-1.0, current_q_a=0.0, settle_s=0.3, duration_s=0.2)


def trapezoid(axis: str) -> Trapezoid:
    fields = {"swept_axis": axis, "held_a": -3.0, "amplitude_a": 4.0, "period_s": 2.0, "periods": 3, "settle_s": 0.25}
    return Trapezoid.model_validate(fields)


@pytest.mark.parametrize(
    ("excitation", "settling_s", "captured_s"),
    [(GatesOff(duration_s=1.5), 0.0, 1.5), (HOLD, 0.3, 0.2), (trapezoid("q"), 0.25, 6.0), (INJECTION, 0.75, 1.0)],
)
def test_what_settles_is_not_captured(excitation: Excitation, settling_s: float, captured_s: float) -> None:
    assert (excitation.settling_s, excitation.captured_s) == (settling_s, captured_s)
    assert excitation.rows(10e3) == round(captured_s * 10e3)


@pytest.mark.parametrize(
    ("excitation", "start_dq_a", "longest_a"),
    [
        (GatesOff(duration_s=1.0), (0.0, 0.0), 0.0),
        (HOLD, (-1.0, 0.0), 1.0),
        (INJECTION, (3.0, -4.0), 5.0),
        (trapezoid("d"), (0.0, -3.0), 5.0),
        (trapezoid("q"), (-3.0, 0.0), 5.0),
        (trapezoid("dq"), (0.0, 0.0), 4.0),
    ],
)
def test_a_current_counts_by_its_length(
    excitation: Excitation, start_dq_a: tuple[float, float], longest_a: float
) -> None:
    assert excitation.start_dq_a == start_dq_a
    assert math.isclose(excitation.longest_current_a, longest_a)
