"""Steps and lines of a leftover that its gradient proposes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orchestrator.diagnosis.weak_form.windows import Windows, periodic_windows, plain_windows, sum_intervals
from orchestrator.discovery.proposals import _of_intervals, line_frequencies, step_places
from orchestrator.numerics.types import Array

INTERVAL_S = 2e-3


def times() -> Array:
    """Of forty segments of half a second, with gaps between them."""
    start = np.cumsum(np.random.default_rng(3).integers(400, 600, 40)) * INTERVAL_S
    return np.concatenate([begin + INTERVAL_S * np.arange(250) for begin in start])


def noise(count: int) -> Array:
    return np.asarray(np.random.default_rng(4).standard_normal(count))


@pytest.mark.parametrize("windows", [plain_windows(250, 13.3), periodic_windows(250, 62.0, 20.0, 20)])
def test_the_gradient_by_an_interval_is_the_transpose_of_the_sum_over_windows(windows: Windows) -> None:
    rng = np.random.default_rng(5)
    x, of_rows = rng.standard_normal((250, 2)), rng.standard_normal(windows.rows)
    sums = sum_intervals(x, windows.step, windows.test_functions, windows.bins, windows.n_bins)
    piece: Any = SimpleNamespace(windows=windows)
    assert of_rows @ windows.combine(sums) == pytest.approx(float(np.sum(_of_intervals(piece, of_rows) * x)))


def test_a_line_beside_noise_is_proposed_with_its_frequency() -> None:
    t = times()
    gradient = 0.6 * np.sin(2.0 * np.pi * 49.97 * t + 0.4) + noise(len(t))
    resolved_hz = 1.0 / float(np.ptp(t))
    assert line_frequencies(t, gradient, INTERVAL_S, 3)[0] == pytest.approx(49.97, abs=0.1 * resolved_hz)


def test_two_phases_show_a_line_that_turns_either_way() -> None:
    t = times()
    for sign in (1.0, -1.0):
        gradient = 0.6 * np.exp(sign * 2j * np.pi * 49.97 * t) + noise(len(t))
        assert line_frequencies(t, gradient, INTERVAL_S, 1) == pytest.approx([49.97], abs=0.002)


def test_noise_and_what_drifts_over_the_experiment_propose_no_line() -> None:
    t = times()
    assert line_frequencies(t, noise(len(t)), INTERVAL_S, 3) == []
    assert line_frequencies(t, 0.01 * t + noise(len(t)), INTERVAL_S, 3) == []


def test_a_step_is_proposed_at_its_sample() -> None:
    t = times()
    after = t > 23.4567
    gradient = after - after.mean() + 0.3 * noise(len(t))
    first = step_places(t, gradient, 4)[0]
    assert abs(first - t[after][0]) < 20 * INTERVAL_S
    exact = step_places(t, after - after.mean(), 1)
    assert exact == [t[after][0]]


def test_a_line_at_half_the_sampling_frequency_is_found_there() -> None:
    """Its power climbs to the end of the spectrum, without a maximum before."""
    nyquist_hz = 0.5 / INTERVAL_S
    found = line_frequencies(times(), (-1.0) ** np.round(times() / INTERVAL_S), INTERVAL_S, 2)
    assert found[0] == pytest.approx(nyquist_hz, rel=1e-3)
    assert all(0.0 < hz < nyquist_hz for hz in found)
