"""The provisional fit finds the inductances of a linear machine, and its flux is the integral of them."""

from __future__ import annotations

import numpy as np
import pytest

from plugins.streams._ripple import FluxTree, fit_ripple
from protocols import Capture
from tests.support.close import assert_close

L = np.array([[0.043, 0.004], [0.004, 0.069]])
RATE = 10000.0


def an_injection(delay: int = 0, angle: float = 0.0, rows: int = 5000, amplitude_v: float = 40.0) -> Capture:
    """A rotating 500 Hz square wave on a machine without resistance, sampled, `delay` samples late."""
    t = np.arange(rows) / RATE
    wave = amplitude_v * np.where((500.0 * t) % 1.0 < 0.5, 1.0, -1.0)
    turn = 2 * np.pi * 2.0 * t
    v_dq = wave[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    acting = np.vstack([np.zeros((delay, 2)), v_dq[: rows - delay]])
    psi = np.vstack([np.zeros(2), np.cumsum(acting, axis=0)[:-1] / RATE])
    i_dq = psi @ np.linalg.inv(L) + np.array([1.0, -0.5])
    c, s = np.cos(angle), np.sin(angle)
    to_ab = np.array([[c, s], [-s, c]])
    return Capture(
        start_s=0.0, sampling_frequency_hz=RATE, i_ab=i_dq @ to_ab, v_ab=v_dq @ to_ab, v_dc=np.full(rows, 540.0)
    )


@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("angle", [0.0, 1.1])
def test_inductances_of_a_linear_machine_are_found(delay: int, angle: float) -> None:
    fit = fit_ripple(an_injection(delay, angle), angle, 0.0)
    assert fit is not None
    assert_close(fit.inductance_h, L, 2e-3)
    assert_close(fit.fitted_a, fit.measured_a, 4e-3)


@pytest.mark.parametrize("capture", [an_injection(rows=10), an_injection(amplitude_v=0.0)])
def test_where_there_is_no_ripple_nothing_is_fitted(capture: Capture) -> None:
    assert fit_ripple(capture, 0.0, 4.25) is None


def test_flux_of_a_quadratic_energy_is_exact_whatever_the_order_of_points() -> None:
    tree = FluxTree()
    for point in np.random.default_rng(3).uniform(-3.0, 3.0, (40, 2)):
        tree.add(point, L)
    i, psi = tree.points()
    assert_close(psi, i @ L, 1e-12)


def test_flux_of_a_saturating_axis_converges_with_the_grid() -> None:
    def worst(points: int) -> float:
        tree = FluxTree()
        for i_q in np.linspace(-3.0, 3.0, points):
            tree.add(np.array([0.0, i_q]), np.diag([0.04, 0.07 / np.cosh(i_q / 2.0) ** 2]))
        i, psi = tree.points()
        return float(np.abs(psi[:, 1] - 0.14 * np.tanh(i[:, 1] / 2.0)).max())

    assert worst(31) < 0.3 * worst(15)
    assert worst(61) < 2e-4
