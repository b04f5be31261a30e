"""The flux without noise: exact on an exact signal, quieter than the map's, and held against drift."""

from __future__ import annotations

import math

import numpy as np

from orchestrator.diagnosis.weak_form.observer import smooth_flux
from orchestrator.numerics.frames import to_ab, to_dq
from tests.orchestrator.diagnosis.pieces import FS, L_D, L_Q, NOISE_A, PM_WB, R_S, TRUE_MAP, Array, response, ripple

ANGLE = 0.7
V_DQ = ripple(1.0, -0.5, 40.0, 5000)
TAU_S = 0.005


def _observed(noise: Array | float = 0.0, bias_v: float = 0.0) -> tuple[Array, Array, Array]:
    i_dq = response(V_DQ, V_DQ.mean(axis=0) / R_S) + noise
    psi, inductance = TRUE_MAP.flux_and_inductance(i_dq)
    i_ab, v_ab = to_ab(i_dq, ANGLE), to_ab(V_DQ, ANGLE) + bias_v
    ohm = np.full(len(i_ab), R_S)
    turn, starts = np.array([[math.cos(ANGLE), math.sin(ANGLE)]]), np.array([0, len(i_ab)])
    return smooth_flux(psi, inductance, v_ab, i_ab, ohm, turn, PM_WB, starts, np.array([1.0 / FS]), TAU_S)


def test_exact_signals_come_back_as_they_are() -> None:
    psi, smooth, current = _observed()
    i_dq = response(V_DQ, V_DQ.mean(axis=0) / R_S)
    magnet = np.array([PM_WB, 0.0])
    np.testing.assert_allclose(to_dq(psi, ANGLE), TRUE_MAP.flux_and_inductance(i_dq)[0] + magnet, atol=1e-12)
    # The trapezoidal rule is not exact on an exponential; the difference is far below the ripple's flux.
    np.testing.assert_allclose(smooth, psi, atol=1e-4 * np.ptp(psi))
    np.testing.assert_allclose(to_dq(current, ANGLE), i_dq, atol=1e-4 * np.ptp(i_dq))


def test_noise_is_less_by_the_readings_in_a_time_constant() -> None:
    noise = np.random.default_rng(1).normal(0.0, NOISE_A, V_DQ.shape)
    true = _observed()[0]
    psi, smooth, _ = _observed(noise)
    left, was = (np.std(to_dq(x - true, ANGLE)[500:], axis=0) for x in (smooth, psi))
    # The map's noise L n / tau and the drop's -R n pass the same lag.
    passed = np.abs(1.0 - R_S * TAU_S / np.array([L_D, L_Q]))
    np.testing.assert_allclose(left / was, passed * math.sqrt(0.5 / (TAU_S * FS)), rtol=0.3)


def test_a_wrong_voltage_does_not_run_away() -> None:
    true, drawn = _observed()[0], _observed(bias_v=2.0)[1]
    np.testing.assert_allclose((drawn - true)[500:].mean(axis=0), 2.0 * TAU_S, rtol=0.02)


def test_a_map_that_is_nearly_flat_leads_the_current_no_further_than_the_largest_reading() -> None:
    i_dq = response(V_DQ, V_DQ.mean(axis=0) / R_S)
    psi, inductance = TRUE_MAP.flux_and_inductance(i_dq)
    i_ab, v_ab = to_ab(i_dq, ANGLE), to_ab(V_DQ, ANGLE)
    turn, starts = np.array([[math.cos(ANGLE), math.sin(ANGLE)]]), np.array([0, len(i_ab)])
    psi[500:600] += 0.1
    inductance[500:600, 2] *= 1e-6
    current = smooth_flux(
        psi, inductance, v_ab, i_ab, np.full(len(i_ab), R_S), turn, PM_WB, starts, np.array([1.0 / FS]), TAU_S
    )[2]
    off, largest = np.linalg.norm(current - i_ab, axis=1), float(np.linalg.norm(i_ab, axis=1).max())
    assert off.max() <= largest * (1.0 + 1e-9)
    np.testing.assert_allclose(off[500:600], largest, rtol=1e-9)


def test_the_current_holds_hardly_any_of_the_readings_noise_at_the_ripples_frequency() -> None:
    """A lag tau of the sensors is undone by tau di/dt, whose noise the readings' noise model does not have."""
    noise = np.random.default_rng(1).normal(0.0, NOISE_A, V_DQ.shape)
    left = (_observed(noise)[2] - _observed()[2])[500:]
    # In phase with the readings' own: what tau times its slope would add to them, over tau.
    added = (np.diff(to_dq(left, ANGLE), axis=0) * FS * noise[501:]).mean(axis=0) / NOISE_A**2
    assert np.abs(added).max() < 0.3 / TAU_S
