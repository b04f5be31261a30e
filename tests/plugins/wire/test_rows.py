"""Rows and ripple rows: numbers survive the wire to half a count, and a demodulated ripple is the ripple."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plugins.wire import (
    VECTORS,
    CaptureFormat,
    Channel,
    RippleGrid,
    RippleRows,
    RowFormat,
    Scales,
    demodulate,
    reconstruct,
)
from plugins.wire._ripple import Waveform, mean_square, unit_ripple, unit_wave
from protocols import DriveFault, InputError
from tests.support.close import assert_close

SCALES = Scales.spanning(12.0, 600.0, 800.0, 1.0)
EVERYTHING = Channel(sum(Channel))
FS = 10_000.0


@given(st.lists(st.sampled_from(list(Channel)), min_size=1, unique=True), st.integers(0, 50), st.integers(0, 99))
def test_rows_come_back_to_half_a_count(channels: list[Channel], rows: int, seed: int) -> None:
    row = RowFormat(Channel(sum(channels)), CaptureFormat.INT16, SCALES)
    rng = np.random.default_rng(seed)
    columns = {channel: 32000.0 * SCALES.of_channel(channel) * rng.uniform(-1.0, 1.0, rows) for channel in channels}
    data = row.pack(columns)
    assert len(data) == rows * row.row_bytes
    back = row.unpack(data)
    assert list(back) == sorted(channels)
    for channel, values in columns.items():
        np.testing.assert_allclose(back[channel], values, rtol=0.0, atol=0.5001 * SCALES.of_channel(channel))


def test_singles_come_back_exactly() -> None:
    row = RowFormat(EVERYTHING, CaptureFormat.F32, SCALES)
    values = (np.arange(5) * math.pi).astype(np.float32).astype(np.float64)
    columns = dict.fromkeys(Channel, values)
    back = row.unpack(row.pack(columns))
    assert all((back[channel] == columns[channel]).all() for channel in Channel)


def test_what_is_past_the_range_is_saturated_and_nonsense_is_refused() -> None:
    row = RowFormat(Channel.I_ALPHA, CaptureFormat.INT16, SCALES)
    back = row.unpack(row.pack({Channel.I_ALPHA: np.array([1e6, -1e6])}))[Channel.I_ALPHA]
    np.testing.assert_allclose(back, [12.0, -12.0], rtol=1e-4)
    with pytest.raises(InputError, match="not finite"):
        row.pack({Channel.I_ALPHA: np.array([math.nan])})
    with pytest.raises(InputError, match="I_ALPHA"):
        row.pack({})
    with pytest.raises(DriveFault, match="no whole number"):
        RowFormat(VECTORS, CaptureFormat.INT16, SCALES).unpack(bytes(9))
    with pytest.raises(DriveFault, match="not finite"):
        RowFormat(Channel.I_A, CaptureFormat.F32, SCALES).unpack(np.array([math.inf], dtype="<f4").tobytes())


@pytest.mark.parametrize("waveform", ["square", "sine"])
def test_the_unit_ripple_is_the_integral_of_the_unit_wave(waveform: Waveform) -> None:
    phase = (np.arange(4000) + 0.5) / 4000
    f, g = unit_wave(phase, waveform), unit_ripple(phase, waveform)
    slope = np.gradient(g, phase)[5:-5]
    inner = np.abs(np.abs(phase - 0.5) - 0.0)[5:-5] > 0.01
    ratio = 4.0 if waveform == "square" else 2.0 * math.pi
    assert_close(slope[inner], ratio * f[5:-5][inner], 1.5e-4)
    assert abs(g.mean()) < 1e-9
    assert g.max() == pytest.approx(1.0, abs=1e-3)
    assert g.min() == pytest.approx(-1.0, abs=1e-3)


@given(
    st.sampled_from(["square", "sine"]),
    st.sampled_from([500.0, 333.0, 250.0, 1000.0]),
    st.integers(1, 3),
    st.integers(0, 37),
    st.sampled_from([0.0, 0.5, 1.5]),
)
def test_what_was_put_in_is_demodulated_and_reconstructed(
    waveform: Waveform, frequency_hz: float, periods: int, discarded: int, delay: float
) -> None:
    grid = RippleGrid(FS, frequency_hz, waveform, periods, discarded, delay)
    k = np.arange(3000.0)
    f, g = unit_wave(grid.phase(k), waveform), unit_ripple(grid.phase(k, delay), waveform)
    mean, ripple, v, base = np.array([1.5, -0.7]), np.array([0.2, 0.05]), np.array([20.0, -6.0]), (3.0, -2.0)
    i_dq = mean + g[:, None] * ripple
    v_dq = np.asarray(base) + f[:, None] * v
    rows = demodulate(i_dq, v_dq, base, grid)
    assert len(rows) == int(3000 * frequency_hz / FS / periods + 1e-9)
    assert_close(rows.mean, np.tile(mean, (len(rows), 1)), 1e-9)
    assert_close(rows.ripple, np.tile(ripple, (len(rows), 1)), 1e-9)
    assert_close(rows.v, np.tile(v, (len(rows), 1)), 1e-9)
    i_again, v_again = reconstruct(rows, base, grid)
    assert_close(i_again, i_dq[: len(i_again)], 1e-9)
    assert_close(v_again, v_dq[: len(v_again)], 1e-9)


def test_a_rotating_injection_is_followed() -> None:
    grid = RippleGrid(FS, 500.0, "square", 1)
    k = np.arange(50_000.0)
    turn = np.stack([np.cos(2 * math.pi * k / FS), 0.4 * np.sin(2 * math.pi * k / FS)], axis=1)
    i_dq = 1.0 + 0.2 * turn * unit_ripple(grid.phase(k), "square")[:, None]
    v_dq = 20.0 * turn * unit_wave(grid.phase(k), "square")[:, None]
    i_again, v_again = reconstruct(demodulate(i_dq, v_dq, (0.0, 0.0), grid), (0.0, 0.0), grid)
    assert np.abs(i_again - i_dq)[20:-20].max() < 2e-4 * 0.2 * 5
    assert np.abs(v_again - v_dq)[20:-20].max() < 5e-3 * 20.0


@given(
    st.sampled_from(["square", "sine"]),
    st.sampled_from([500.0, 333.0, 250.0, 1000.0]),
    st.integers(1, 3),
    st.integers(0, 37),
    st.sampled_from([0.0, 0.5, 1.5]),
)
def test_a_ripple_that_is_bent_is_demodulated_and_reconstructed(
    waveform: Waveform, frequency_hz: float, periods: int, discarded: int, delay: float
) -> None:
    grid = RippleGrid(FS, frequency_hz, waveform, periods, discarded, delay, is_curved=True)
    k = np.arange(3000.0)
    g = unit_ripple(grid.phase(k, delay), waveform)[:, None]
    mean, ripple, curvature = np.array([1.5, -0.7]), np.array([0.2, 0.05]), np.array([-0.02, 0.01])
    i_dq = mean + ripple * g + curvature * (g * g - mean_square(waveform))
    rows = demodulate(i_dq, np.zeros_like(i_dq), (0.0, 0.0), grid)
    assert rows.curvature is not None
    for found, put_in in ((rows.mean, mean), (rows.ripple, ripple), (rows.curvature, curvature)):
        assert_close(found, np.tile(put_in, (len(rows), 1)), 1e-9)
    again, _ = reconstruct(rows, (0.0, 0.0), grid)
    assert_close(again, i_dq[: len(again)], 1e-9)


@pytest.mark.parametrize(("waveform", "found"), [("square", 1.0 / 3.0), ("sine", 0.5)])
def test_the_square_of_the_unit_ripple_has_this_mean(waveform: Waveform, found: float) -> None:
    g = unit_ripple((np.arange(100_000) + 0.5) / 100_000, waveform)
    assert mean_square(waveform) == found == pytest.approx(float((g * g).mean()), abs=1e-9)


@pytest.mark.parametrize("samples", [2, 3])
def test_a_period_of_two_or_three_samples_has_no_curvature(samples: int) -> None:
    grid = RippleGrid(FS, FS / samples, "square", 3, is_curved=True)
    i_dq = 1.0 + 0.2 * unit_ripple(grid.phase(np.arange(600.0)), "square")[:, None] * np.array([1.0, -0.5])
    rows = demodulate(i_dq, np.zeros_like(i_dq), (0.0, 0.0), grid)
    assert rows.curvature is not None
    assert not rows.curvature.any()
    assert_close(rows.ripple, np.tile([0.2, -0.1], (len(rows), 1)), 1e-9)


@pytest.mark.parametrize(("is_curved", "size"), [(False, 12), (True, 16)])
def test_ripple_rows_come_back_to_half_a_count(is_curved: bool, size: int) -> None:
    rng = np.random.default_rng(3)
    mean, ripple, v = rng.normal(size=(9, 2)), 0.1 * rng.normal(size=(9, 2)), 20.0 * rng.normal(size=(9, 2))
    rows = RippleRows(mean, ripple, v, 0.1 * ripple if is_curved else None)
    counts = rows.counts(SCALES)
    assert counts.nbytes == 9 * size == 9 * RippleGrid(FS, 500.0, "square", 1, is_curved=is_curved).row_bytes
    back = RippleRows.of_counts(counts, SCALES)
    if is_curved:
        assert back.curvature is not None
        np.testing.assert_allclose(back.curvature, 0.1 * ripple, atol=0.501 * SCALES.ripple_a)
    else:
        assert back.curvature is None
    np.testing.assert_allclose(back.mean, rows.mean, atol=0.501 * SCALES.current_a)
    np.testing.assert_allclose(back.ripple, rows.ripple, atol=0.501 * SCALES.ripple_a)
    np.testing.assert_allclose(back.v, rows.v, atol=0.501 * SCALES.voltage_v)


def test_too_short_for_a_row_is_no_row() -> None:
    grid = RippleGrid(FS, 10.0, "sine", 1)
    assert len(demodulate(np.zeros((100, 2)), np.zeros((100, 2)), (0.0, 0.0), grid)) == 0
