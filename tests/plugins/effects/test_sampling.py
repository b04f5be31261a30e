"""Readings beside the turning point, against a motor of constant inductances behind three legs that really switch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.numerics.frames import from_phases, inductance_to_ab, to_ab, to_dq, to_phases
from orchestrator.numerics.types import Array
from plugins.effects.sampling import SamplingOffset
from protocols import Signals

FS, BUS, R_S = 10_000.0, 48.0, 0.5
INDUCTANCE = np.array([3.0e-4, 3.6e-4])
THETA = 0.4


def _signals(i_dq: Array, v_dq: Array) -> Signals:
    n = len(i_dq)
    i_ab = to_ab(i_dq, THETA)
    return Signals(
        start_s=0.0,
        sampling_frequency_hz=FS,
        pwm_frequency_hz=FS,
        i_ab=i_ab,
        v_ab=to_ab(v_dq, THETA),
        v_dc=np.full(n, BUS),
        theta_rad=np.full(n, THETA),
        resistance_ohm=np.full(n, R_S),
        i_m_ab=i_ab,
        heat_j=np.zeros(n),
        psi_ab=to_ab(INDUCTANCE * i_dq + [0.0118, 0.0], THETA),
        inductance_ab=inductance_to_ab(np.tile([INDUCTANCE[0], 0.0, INDUCTANCE[1]], (n, 1)), THETA),
    )


def _read(v_dq: Array, offset_s: float) -> Array:
    """Currents (n - 2, 2) in the rotor's frame, read so long after each row's turning point; exact between edges."""
    legs = to_phases(to_ab(v_dq, THETA))
    duty = 0.5 + (legs - 0.5 * (legs.max(axis=1) + legs.min(axis=1))[:, None]) / BUS
    start = np.arange(len(legs))[:, None] / FS
    rise, fall = start + 0.5 * (1.0 - duty) / FS, start + 0.5 * (1.0 + duty) / FS
    wanted = start[1:-1, 0] + offset_s
    times = np.unique(np.concatenate([[0.0], rise.ravel(), fall.ravel(), wanted]))
    middle = 0.5 * (times[1:] + times[:-1])
    row = (middle * FS).astype(int)
    high = (middle[:, None] > rise[row]) & (middle[:, None] < fall[row])
    u = to_dq(from_phases(BUS * high), THETA) / R_S
    fade = np.exp(-R_S / INDUCTANCE * np.diff(times)[:, None])
    i = np.empty((len(times), 2))
    i[0] = v_dq[0] / R_S
    for k in range(len(middle)):
        i[k + 1] = u[k] + (i[k] - u[k]) * fade[k]
    return np.asarray(i[np.searchsorted(times, wanted)], dtype=np.float64)


def _left(i_dq: Array, v_dq: Array, offset_s: float) -> Array:
    """Volts that each row misses, the readings corrected for this offset."""
    signals = _signals(i_dq, v_dq)
    v_ab = SamplingOffset().correct(signals, SamplingOffset.Parameters(offset_s=offset_s)).v_ab
    assert v_ab is not None
    mean = 0.5 * R_S * (signals.i_ab[1:] + signals.i_ab[:-1])
    assert signals.psi_ab is not None
    return np.asarray(v_ab[:-1] - mean - FS * np.diff(signals.psi_ab, axis=0), dtype=np.float64)


@pytest.fixture(scope="module")
def wave() -> Array:
    """Voltages (n, 2) about an operating point: squares on both axes, of two frequencies."""
    k = np.arange(160)
    squares = np.stack([np.where(k % 20 < 10, 1.0, -1.0), np.where(k % 32 < 16, 1.0, -1.0)], axis=1)
    return np.asarray([3.0, 4.0] + squares * [1.5, 2.0], dtype=np.float64)


# The last two are read between the edges of the legs.
@pytest.mark.parametrize("offset_s", [2e-6, -5e-6, 1.5e-5, 2.0e-5, -2.0e-5])
def test_what_a_switching_motor_shows_is_taken_out(wave: Array, offset_s: float) -> None:
    i_dq, v_dq = _read(wave, offset_s)[40:], wave[1:-1][40:]
    turning_point = _left(_read(wave, 0.0)[40:], v_dq, 0.0)
    floor = np.sqrt(np.mean(turning_point[1:-1] ** 2))
    before = np.sqrt(np.mean(_left(i_dq, v_dq, 0.0)[1:-1] ** 2))
    after = np.sqrt(np.mean(_left(i_dq, v_dq, offset_s)[1:-1] ** 2))
    assert after < 0.1 * before + 1.1 * floor


def test_in_a_hold_the_resistance_grows_as_the_inverse_inductance_of_each_axis() -> None:
    rng = np.random.default_rng(1)
    i_dq = np.array([6.0, 8.0]) + rng.normal(0.0, 5e-3, (6400, 2))
    v_dq = np.tile(R_S * np.array([6.0, 8.0]), (len(i_dq), 1))
    tau = 2e-6
    signals = _signals(i_dq, v_dq)
    v_ab = SamplingOffset().correct(signals, SamplingOffset.Parameters(offset_s=tau)).v_ab
    assert v_ab is not None
    cos, sin = np.cos(THETA), np.sin(THETA)
    lost = (signals.v_ab - v_ab).mean(axis=0) @ np.array([[cos, -sin], [sin, cos]])
    np.testing.assert_allclose(lost, tau * R_S**2 / INDUCTANCE * [6.0, 8.0], rtol=2e-3)


def _fitted(i_dq: Array, v_dq: Array) -> Array:
    """Resistance and inductance of each axis (2, 2) as plain readings tell them."""
    mean, slope = 0.5 * (i_dq[1:] + i_dq[:-1]), FS * np.diff(i_dq, axis=0)
    axes = [np.linalg.lstsq(np.column_stack([mean[:, x], slope[:, x]]), v_dq[:-1, x], rcond=None)[0] for x in (0, 1)]
    return np.array(axes)


def test_within_the_zero_vector_readings_show_a_larger_inductance_and_a_resistance_for_each_axis(wave: Array) -> None:
    """What the effect says of its gauge, and of its signature."""
    tau, v_dq = 2e-6, wave[1:-1][40:]
    more = _fitted(_read(wave, tau)[40:], v_dq) - _fitted(_read(wave, 0.0)[40:], v_dq)
    np.testing.assert_allclose(more[:, 0], tau * R_S**2 / INDUCTANCE, rtol=0.05)
    np.testing.assert_allclose(more[:, 1], tau * R_S, rtol=0.05)


def test_without_a_model_of_the_flux_what_the_edges_gave_is_still_moved(wave: Array) -> None:
    v_dq = wave[1:-1]
    signals = replace(_signals(_read(wave, 2e-5), v_dq), inductance_ab=None)
    v_ab = SamplingOffset().correct(signals, SamplingOffset.Parameters(offset_s=2e-5)).v_ab
    assert v_ab is not None
    assert np.abs(v_ab - signals.v_ab).max() > 0.1
