"""The multi-step prediction keeps to physics where the model knows nothing."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.diagnosis import linear_magnetics
from orchestrator.diagnosis.fitting.simulation import _simulate, parts_of
from orchestrator.numerics.tensor_spline import EvenSpline

L_D, L_Q, R_S, FS = 0.043, 0.069, 4.25, 10e3
GRID = EvenSpline(low=-3.0, high=3.0, reach=3.0, cells=(4, 4))


def predicted(v_d: float, v_q: float, samples: int, ts: float = 1.0 / FS) -> np.ndarray:
    magnetics = linear_magnetics(GRID, L_D, L_Q)
    numbers, _ = GRID.layout
    return _simulate(
        np.tile([v_d, v_q], (samples, 1)),
        np.zeros((samples, 2)),
        np.full(samples, R_S),
        np.zeros(samples),
        np.zeros((samples, 2)),
        magnetics.patches,
        numbers,
        ts,
        parts_of(ts * R_S / L_D),
        0.2 * L_D,
        np.array([GRID.low, GRID.high, GRID.reach]),
    )


@pytest.mark.parametrize("final_a", [2.0, 9.0])
def test_a_step_follows_r_and_l_within_the_map_and_beyond_it(final_a: float) -> None:
    time = np.arange(2000) / FS
    found = predicted(R_S * final_a, -R_S * final_a, len(time))
    np.testing.assert_allclose(found[:, 0], final_a * (1.0 - np.exp(-time * R_S / L_D)), atol=2e-3 * final_a)
    np.testing.assert_allclose(found[:, 1], -final_a * (1.0 - np.exp(-time * R_S / L_Q)), atol=2e-3 * final_a)


def test_a_mean_that_spans_time_constants_is_stepped_in_parts() -> None:
    # Of a small servo's hold, ten readings at 10 kHz in one: one step of three time constants would not even be stable.
    ts, final_a = 3.0 * L_D / R_S, 2.0
    time = ts * np.arange(40)
    found = predicted(R_S * final_a, -R_S * final_a, len(time), ts)
    np.testing.assert_allclose(found[:, 0], final_a * (1.0 - np.exp(-time * R_S / L_D)), atol=5e-3 * final_a)
    np.testing.assert_allclose(found[:, 1], -final_a * (1.0 - np.exp(-time * R_S / L_Q)), atol=5e-3 * final_a)
    assert parts_of(R_S / (FS * L_D)) == 1


def test_a_model_far_off_is_held_well_outside_of_what_was_measured() -> None:
    assert np.abs(predicted(1e4, -1e4, 2000)).max() <= 15.0
