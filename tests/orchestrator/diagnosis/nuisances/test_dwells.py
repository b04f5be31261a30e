"""Where currents rest: a hold all through, a trapezoid's ends and not its ramps, whatever the noise."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis.nuisances.dwells import QuantiserScatter, dwells, leg_step_v
from orchestrator.diagnosis.weak_form.segments import SegmentData
from protocols import SegmentStage
from tests.orchestrator.diagnosis.pieces import NOISE_A, R_S, Array, Plan, hold, piece, ripple, sweep


def _made(stage: SegmentStage, v_dq: Array, noise_a: float = NOISE_A) -> SegmentData:
    noise = np.random.default_rng(1).normal(0.0, noise_a, v_dq.shape)
    return piece(Plan(stage, v_dq, settings={"frequency_hz": 500.0, "rotation_hz": 4.0}), noise=noise)


def _trapezoid(up: int, dwell: int) -> Array:
    """Voltage of a current that ramps to 2.5 A, rests, ramps down, rests."""
    ramp = np.linspace(-2.5, 2.5, up)
    i_q = np.concatenate([ramp, np.full(dwell, 2.5), ramp[::-1], np.full(dwell, -2.5)])
    return np.stack([np.zeros(len(i_q)), R_S * i_q], axis=1)


def test_a_hold_rests_all_through() -> None:
    assert dwells(_made(SegmentStage.RESISTANCE, hold(2.0, 0.0))) == (slice(0, 600),)


@pytest.mark.parametrize("noise_a", [0.1 * NOISE_A, NOISE_A])
def test_a_trapezoid_rests_at_its_ends(noise_a: float) -> None:
    up, dwell = 4000, 3000
    made = _made(SegmentStage.CLASSICAL, _trapezoid(up, dwell), noise_a)
    found, window = dwells(made), made.windows.step
    assert len(found) == 2
    for stretch, start in zip(found, (up, 2 * up + dwell), strict=True):
        # The current follows the voltage some time constants later: within a rest all of it has settled.
        assert start - window <= stretch.start <= start + 800
        assert abs(stretch.stop - (start + dwell)) <= 2 * window


def test_what_moves_all_the_time_does_not_rest() -> None:
    assert dwells(_made(SegmentStage.CLASSICAL, sweep(1, 2.5, 0.0))) == ()
    assert dwells(_made(SegmentStage.INJECTION, ripple(1.0, 0.0, 40.0))) == ()
    assert dwells(_made(SegmentStage.GATES_OFF, np.zeros((600, 2)))) == ()


@pytest.mark.parametrize("trembling", [0.0, 0.15, 0.3])
def test_a_timers_scatter_is_what_a_quantiser_leaves_of_a_trembling_voltage(trembling: float) -> None:
    step_v, rng = 0.2, np.random.default_rng(2)
    means = rng.uniform(0.0, step_v, 400)
    legs = means[:, None] + rng.normal(0.0, trembling * step_v, (400, 4000))
    off = (step_v * np.round(legs / step_v) - legs).mean(axis=1)
    undithered = step_v / leg_step_v(1.0)
    (size,) = QuantiserScatter(np.ones(1), np.array([trembling * step_v])).sizes(undithered, dithered=True)
    # An axis has sqrt(2 / 3) of a leg; what chance leaves of so many samples is far below.
    assert size == pytest.approx(np.sqrt(2.0 / 3.0) * off.std(), rel=0.05)


def test_a_held_voltage_trembles_as_it_was_commanded_and_errs_with_the_pwm_frequency() -> None:
    v_dq = hold(1.0, 0.0) + np.random.default_rng(3).normal(0.0, 0.05, (600, 2))
    timer = QuantiserScatter.of(_made(SegmentStage.RESISTANCE, v_dq))
    assert timer.trembling_v == pytest.approx([0.05], rel=0.1)
    assert timer.sizes(0.02, dithered=False) == pytest.approx([0.02])
    twice = QuantiserScatter(2.0 * timer.steps, timer.trembling_v)
    assert twice.sizes(0.02, dithered=False) == pytest.approx([0.04])
    assert twice.sizes(0.02, dithered=True)[0] > 2.0 * timer.sizes(0.02, dithered=True)[0]
