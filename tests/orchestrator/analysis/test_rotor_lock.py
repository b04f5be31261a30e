"""The lock check against rotors that hold, slip, follow, and hide."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from orchestrator.analysis import judge_lock
from protocols import Capture, NotMeasuredError, Segment, SegmentStage
from tests.orchestrator.analysis.plant import (
    R_S,
    Array,
    CurrentOf,
    capture_of,
    flux_for,
    injection_voltage,
    integrate_motor,
    linear_current,
    saturated_current,
)
from tests.support.cases import few

TOLERANCE = 0.02
QUARTER = np.pi / 2
HELD = np.array([[0.0, 0.0], [0.0, 3.0], [0.0, 0.0], [0.0, -3.0], [0.0, 0.0]])
# A free rotor turns until the current lies on its own d axis.
FOLLOWED = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 0.0], [3.0, 0.0], [0.0, 0.0]])


def captures(
    angles: list[float], currents: Array = HELD, current_of: CurrentOf = saturated_current, noise_a: float = 4e-3
) -> list[tuple[Segment, Capture]]:
    """Five captures; the rotor's true angle in each, the believed one being zero, and the current in its true frame."""
    voltage = injection_voltage(R_S * currents, 40.0, 500.0, 4.0)
    run = integrate_motor(voltage, flux_for(currents, current_of), 3000, current_of, substeps=1)
    segments = [
        Segment(id=f"lock-{k}", stage=SegmentStage.LOCK_CHECK, start_s=float(k), samples=3000) for k in range(5)
    ]
    return [(s, capture_of(run, k, angle=angles[k], noise_a=noise_a)) for k, s in enumerate(segments)]


def test_a_held_rotor_is_locked_for_sure() -> None:
    verdict = judge_lock(captures([0.0] * 5), TOLERANCE)
    assert verdict.locked
    assert verdict.confidence > 0.999
    assert abs(verdict.moved_rad) < 4 * verdict.moved_std_rad
    assert "locked" in verdict.summary


def test_a_belief_that_is_off_does_not_matter() -> None:
    assert judge_lock(captures([0.08] * 5), TOLERANCE).confidence > 0.999


@few(
    "angles",
    [
        [0.0, QUARTER, QUARTER, -QUARTER, -QUARTER],
        [0.0, QUARTER, 0.0, -QUARTER, 0.0],
        [0.0, QUARTER, QUARTER, QUARTER + np.pi, QUARTER],
    ],
    ids=["stays where the torque left it", "springs back", "stays a quarter turn away"],
)
@pytest.mark.parametrize(
    "current_of",
    [saturated_current, lambda psi: linear_current(psi, 0.07, 0.04)],
    ids=["saturated", "d axis the softer one"],
)
def test_a_rotor_that_follows_the_current_is_caught(angles: list[float], current_of: Callable[[Array], Array]) -> None:
    verdict = judge_lock(captures(angles, FOLLOWED, current_of), TOLERANCE)
    assert not verdict.locked
    assert verdict.confidence < 1e-3


@few("slip", [-0.05, 0.03, 0.4])
def test_a_slip_is_measured(slip: float) -> None:
    verdict = judge_lock(captures([0.0, slip, slip, slip, slip]), TOLERANCE)
    assert not verdict.locked
    assert verdict.moved_rad == pytest.approx(slip, abs=4 * verdict.moved_std_rad)


def test_a_slip_within_the_tolerance_is_accepted() -> None:
    verdict = judge_lock(captures([0.0, 0.01, 0.01, 0.01, 0.01]), TOLERANCE)
    assert verdict.locked
    assert verdict.confidence > 0.99


def test_twist_is_what_the_coupling_says() -> None:
    salient = captures([0.0, 0.03, 0.0, -0.03, 0.0], current_of=linear_current)
    verdict = judge_lock(salient, TOLERANCE)
    assert verdict.locked
    assert verdict.twist_rad == pytest.approx(0.03, abs=0.003)


def test_a_round_motor_is_answered_in_words() -> None:
    verdict = judge_lock(captures([0.0] * 5, current_of=lambda psi: linear_current(psi, 0.05, 0.05)), TOLERANCE)
    assert verdict.confidence < 0.05
    assert "cannot tell" in verdict.summary


def test_saturation_shows_the_rotor_of_a_round_motor() -> None:
    def round_but_saturating(psi: Array) -> Array:
        # H = (x^2 + y^2) / 2L + 15 x (x^2 + y^2): no saliency at rest, inductances that fall along +d
        x, y = psi[..., 0], psi[..., 1]
        return psi / 0.05 + 15.0 * np.stack([3 * x**2 + y**2, 2 * x * y], axis=-1)

    held = judge_lock(captures([0.0] * 5, current_of=round_but_saturating), 0.2)
    slipped = judge_lock(captures([0.0, 0.5, 0.5, 0.5, 0.5], current_of=round_but_saturating), 0.2)
    assert held.locked
    assert not slipped.locked
    assert slipped.moved_rad == pytest.approx(0.5, abs=4 * slipped.moved_std_rad)
    assert "saturation" in held.summary


def test_rests_and_torque_are_both_needed() -> None:
    everything = captures([0.0] * 5)
    with pytest.raises(NotMeasuredError):
        judge_lock(everything[:2], TOLERANCE)
    with pytest.raises(NotMeasuredError):
        judge_lock([], TOLERANCE)


def soft_d(psi: Array) -> Array:
    """grad H of H = x^2/2L_d + y^2/2L_q + 9 x^3 + 6 x y^2 + 40 x^4 + 60 x^2 y^2 + 50 y^4, L_d a tenth above L_q.

    3 A on q lower L_dd by nine tenths of the saliency.
    """
    x, y = psi[..., 0], psi[..., 1]
    return np.stack(
        [
            x / 0.055 + 27 * x**2 + 6 * y**2 + 160 * x**3 + 120 * x * y**2,
            y / 0.050 + 12 * x * y + 120 * x**2 * y + 200 * y**3,
        ],
        axis=-1,
    )


def soft_d_without_a_magnets_saturation(psi: Array) -> Array:
    """The same without its odd terms: nothing but the saliency tells where its d axis is."""
    x, y = psi[..., 0], psi[..., 1]
    return np.stack(
        [x / 0.055 + 160 * x**3 + 120 * x * y**2, y / 0.050 + 120 * x**2 * y + 200 * y**3],
        axis=-1,
    )


def test_saturation_that_undoes_the_saliency_does_not_make_a_held_rotor_free() -> None:
    verdict = judge_lock(captures([0.0] * 5, current_of=soft_d, noise_a=2e-3), TOLERANCE)
    assert verdict.locked
    assert verdict.confidence > 0.5
    assert "locked" in verdict.summary


@few("back", [0.0, QUARTER], ids=["springs back", "stays"])
def test_such_a_rotor_is_caught_when_it_follows(back: float) -> None:
    angles = [0.0, QUARTER, back, -QUARTER, -back]
    verdict = judge_lock(captures(angles, FOLLOWED, soft_d), TOLERANCE)
    assert verdict.locked is False
    assert "free" in verdict.summary


def test_what_saturation_and_a_free_rotor_would_both_show_is_not_known() -> None:
    held = judge_lock(captures([0.0] * 5, current_of=soft_d_without_a_magnets_saturation), TOLERANCE)
    assert held.locked is None
    assert "cannot tell" in held.summary
    moved = [0.0, QUARTER, QUARTER, QUARTER, QUARTER]
    assert judge_lock(captures(moved, FOLLOWED, soft_d_without_a_magnets_saturation), TOLERANCE).locked is False


def test_cross_saturation_is_not_called_a_twist() -> None:
    def crossing(psi: Array) -> Array:
        # H = x^2/2L_d + y^2/2L_q + 8 x y^2: the coupling under torque is that of a rotor turned by some degrees
        x, y = psi[..., 0], psi[..., 1]
        return np.stack([x / 0.043 + 8 * y**2, y / 0.069 + 16 * x * y], axis=-1)

    def much(psi: Array) -> Array:
        x, y = psi[..., 0], psi[..., 1]
        return np.stack([x / 0.043 + 14 * y**2, y / 0.069 + 28 * x * y], axis=-1)

    some = judge_lock(captures([0.0] * 5, current_of=crossing), TOLERANCE)
    assert some.locked
    assert 0.1 < some.twist_rad < 0.5
    assert "turns the saliency by +" in some.summary
    more = judge_lock(captures([0.0] * 5, current_of=much), TOLERANCE)
    assert more.twist_rad > 0.5
    assert "deg el." not in more.summary.split("tolerance")[1].split(";")[1]
    assert "saliency" not in judge_lock(captures([0.0] * 5, current_of=linear_current), TOLERANCE).summary
