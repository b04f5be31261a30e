"""Thinning keeps peaks, colours differ, axes carry round numbers, the clock follows the drive's."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.formatting import colours
from plugins.streams.rerun._axes import Chart, reach, ticks
from plugins.streams.rerun._clock import Clock
from plugins.streams.rerun._waveforms import Thinner, envelope
from protocols import Capture


def a_capture(rows: int = 5000, start_s: float = 0.0, rate: float = 10000.0) -> Capture:
    turn = np.arange(rows) / rate * 2 * np.pi * 500.0
    vectors = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Capture(
        start_s=start_s, sampling_frequency_hz=rate, i_ab=vectors, v_ab=10 * vectors, v_dc=np.full(rows, 540.0)
    )


@given(st.integers(1, 400), st.integers(1, 50), st.integers(0, 2**32 - 1))
def test_no_peak_is_lost_by_thinning(rows: int, width: int, seed: int) -> None:
    values = np.random.default_rng(seed).normal(size=(2, rows))
    thin = envelope(values, width)
    assert thin.shape == (2, 2 * -(-rows // width))
    np.testing.assert_array_equal(thin.max(axis=1), values.max(axis=1))
    np.testing.assert_array_equal(thin.min(axis=1), values.min(axis=1))


def test_a_second_of_waveforms_becomes_a_hundred_rows() -> None:
    thinner = Thinner()
    for block in range(2):
        thinner.take(a_capture(start_s=0.5 * block), 0.0)
    assert thinner.rows == 100
    thinner.take(a_capture(rows=0), 0.0)
    assert thinner.rows == 100
    assert [e.path for e in thinner.give((5.0, 150.0))] == [
        *("drive/current", "drive/voltage"),
        *("drive/limit/current", "drive/limit/voltage"),
    ]
    assert thinner.give(None) == []


def test_currents_of_a_rotor_that_turns_are_drawn_in_its_own_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    theta = 0.05 * np.arange(2000)
    held = 2.0 * np.stack([-np.sin(theta), np.cos(theta)], axis=1)
    drawn: list[np.ndarray] = []
    monkeypatch.setattr("plugins.streams.rerun._waveforms.scalars", lambda path, times, rows: drawn.append(rows))
    thinner = Thinner()
    thinner.take(a_capture(rows=2000).model_copy(update={"i_ab": held, "theta_rad": theta}), 0.3)
    thinner.give(None)
    np.testing.assert_allclose(drawn[0], np.tile([0.0, 2.0], (len(drawn[0]), 1)), atol=1e-12)


@given(st.floats(-1e3, 1e3), st.floats(1e-6, 1e6))
def test_ticks_are_few_lie_within_and_are_evenly_spaced(place: float, span: float) -> None:
    low = place * span
    found = ticks(low, low + span)
    assert len(found) <= 12
    assert all(low - 1e-6 * span <= v <= low + span * (1 + 1e-6) for v in found)
    if len(found) > 2:
        np.testing.assert_allclose(np.diff(found), found[1] - found[0], rtol=1e-6)


def test_a_chart_puts_its_corners_on_the_corners_of_the_sheet() -> None:
    chart = Chart("c", (1.0, 100.0), (-2.0, 2.0), "x", "y", log_x=True)
    np.testing.assert_allclose(chart.place([1.0, 10.0, 100.0], [2.0, 0.0, -2.0]), [[0, 0], [80, 45], [160, 90]])


@pytest.mark.parametrize("values", [np.zeros(3), np.array([np.nan]), np.empty(0)])
def test_a_range_is_never_empty(values: np.ndarray) -> None:
    low, high = reach(values)
    assert low < high


def test_phases_and_methods_are_separated_by_the_colour_blind() -> None:
    """Distances of lightness and of the blue-yellow axis, which all common kinds of colour blindness keep."""
    for group in (colours.PHASES, (colours.D_AXIS, colours.Q_AXIS), tuple(colours.METHODS.values())):
        for one, other in itertools.combinations(group, 2):
            (r1, g1, b1), (r2, g2, b2) = colours.rgb(one), colours.rgb(other)
            lightness = abs(0.3 * (r1 - r2) + 0.6 * (g1 - g2) + 0.1 * (b1 - b2))
            blue_yellow = abs((b1 - (r1 + g1) / 2) - (b2 - (r2 + g2) / 2))
            assert lightness + blue_yellow > 40, (one, other)


def test_what_is_not_known_is_transparent_and_values_keep_their_order() -> None:
    found = colours.sequential(np.array([np.nan, 0.0, 0.5, 1.0]))
    assert found[:, 3].tolist() == [0, 255, 255, 255]
    assert np.all(np.diff(found[1:, 1].astype(int)) > 0)
    assert colours.opaque(found, colours.SCREEN)[0].tolist() == [*colours.rgb(colours.SCREEN), 255]


def test_a_simulated_clock_stands_still_between_samples_and_a_real_one_goes_on() -> None:
    wall = [0.0]
    clock = Clock(lambda: wall[0])
    clock.seen(0.0)
    wall[0] = 2.0
    clock.seen(2.0)
    wall[0] = 12.0
    assert clock.now() == pytest.approx(12.0)
    clock.seen(500.0)
    wall[0] = 22.0
    assert clock.now() == pytest.approx(500.0)
