from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.analysis import Inductances, Ripple, flux_steps, integrate, invert
from protocols import NotMeasuredError
from tests.orchestrator.analysis.plant import Array, flux_for, saturated_current, saturated_hessian
from tests.support.close import assert_close

SIDES = np.linspace(-3.0, 3.0, 5)
PLANE = np.stack(np.meshgrid(SIDES, SIDES, indexing="ij"), axis=-1).reshape(-1, 2)


def exact(current: Array, std: float = 0.0) -> Inductances:
    """What a perfect measurement of the saturated motor would give."""
    ripples = []
    for i in current:
        psi = flux_for(i, saturated_current)
        x, y = psi
        third = np.array([54 + 960 * x, 160 * y, 12 + 160 * x, 1200 * y])
        ripples.append(
            Ripple(
                current_dq=i,
                mean_current_dq=i,
                hessian=saturated_hessian(psi),
                third=third,
                covariance=std**2 * np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]),
                flux_rms_wb=0.01,
                frequency_hz=500.0,
                amplitude_v=40.0,
                decay_per_s=100.0,
                samples=1000,
            )
        )
    return invert(ripples)


def test_inverse_is_the_slope_of_the_flux() -> None:
    here = np.array([[1.0, 2.0]])
    points = exact(here)
    for axis, e in enumerate(1e-4 * np.eye(2)):
        ahead, behind = (flux_for(np.array([1.0, 2.0]) + side, saturated_current) for side in (e, -e))
        np.testing.assert_allclose(points.matrix[0][:, axis], (ahead - behind) / 2e-4, rtol=1e-5)
        slope = (exact(here + e[None]).matrix - exact(here - e[None]).matrix)[0] / 2e-4
        assert_close(points.slope[0][:, :, axis], slope, 1e-4)


def test_the_end_correction_makes_the_rule_fourth_order() -> None:
    errors = []
    for step in (1.0, 0.5):
        ends = exact(np.array([[0.0, 1.0], [0.0, 1.0 + step]]))
        rise = flux_steps(np.array([[0.0, step]]), (ends.matrix[:1], ends.slope[:1]), (ends.matrix[1:], ends.slope[1:]))
        truth = flux_for(ends.current[1], saturated_current) - flux_for(ends.current[0], saturated_current)
        errors.append(float(np.abs(rise[0] - truth).max()))
    assert errors[0] / errors[1] > 2**4


def test_flux_of_a_coarse_grid_is_right_to_a_thousandth() -> None:
    found = integrate(exact(PLANE), "test")
    truth = flux_for(PLANE, saturated_current)
    assert np.linalg.norm(found.psi - truth, axis=1).max() < 2e-3 * np.linalg.norm(truth, axis=1).max()
    assert found.anchored
    assert found.closure_rms_wb < 4.9e-4 * np.linalg.norm(truth, axis=1).max()


def test_repeated_points_do_no_harm() -> None:
    twice = np.concatenate([PLANE, PLANE[12:14] + 1e-7])
    assert_close(integrate(exact(twice), "test").psi[:25], integrate(exact(PLANE), "test").psi, 4e-4)


def test_zero_current_outside_the_points_is_stated() -> None:
    found = integrate(exact(PLANE + np.array([3.5, 0.0])), "test")
    assert not found.anchored
    truth = flux_for(PLANE + np.array([3.5, 0.0]), saturated_current)
    assert np.linalg.norm(found.psi - truth, axis=1).max() < 2.5e-3 * np.linalg.norm(truth, axis=1).max()


def test_standard_deviations_are_those_of_repetitions() -> None:
    std = 0.1
    clean = exact(PLANE, std)
    fluxes = []
    for seed in range(16):
        noise = np.random.default_rng(seed).normal(size=(len(PLANE), 3)) * std
        symmetric = noise[:, [[0, 1], [1, 2]]]
        noisy = np.linalg.inv(np.linalg.inv(clean.matrix) + symmetric).astype(np.float64)
        fluxes.append(integrate(Inductances(clean.current, noisy, clean.slope, clean.covariance), "test").psi)
    reported = integrate(clean, "test").std
    ratio = np.std(fluxes, axis=0)[reported > 1e-5] / reported[reported > 1e-5]
    assert 0.7 < np.median(ratio) < 1.3


def measured(variance: Array, samples: int) -> list[Ripple]:
    """Ripples whose residuals have these variances, relative to noise."""
    one = Ripple(
        current_dq=np.zeros(2),
        mean_current_dq=np.zeros(2),
        hessian=np.diag([20.0, 15.0]),
        third=np.zeros(4),
        covariance=1e-4 * np.eye(7),
        flux_rms_wb=0.01,
        frequency_hz=500.0,
        amplitude_v=40.0,
        decay_per_s=100.0,
        samples=samples,
    )
    return [replace(one, covariance=share * one.covariance) for share in variance]


def test_what_is_noise_everywhere_is_no_misfit() -> None:
    noisy = 1.0 + np.random.default_rng(3).normal(size=100) / np.sqrt(4000)
    misfit = invert(measured(noisy, 4000)).misfit
    assert misfit is not None
    assert (misfit[:, 0] == 0.0).mean() > 0.95


def test_a_misfit_does_not_average_out_over_the_samples() -> None:
    variance = np.ones(20)
    variance[7] = 2.0
    few, many = (invert(measured(variance / n, n)) for n in (4_000, 400_000))
    assert few.misfit is not None
    assert many.misfit is not None
    assert np.flatnonzero(few.misfit[:, 0]).tolist() == [7]
    assert many.misfit[7, 0] == pytest.approx(few.misfit[7, 0], rel=0.1)
    assert many.misfit[7, 0] > 50.0 * np.sqrt(many.covariance[7, 0, 0])


def test_misfits_of_neighbours_add_up_along_the_way() -> None:
    points = exact(PLANE, 1e-9)
    wrong = np.zeros((len(PLANE), 7))
    wrong[:, 0] = 1e-3  # all L_dd by 1 mH: psi_d by 1 mH times i_d
    std = integrate(replace(points, misfit=wrong), "test").std - integrate(points, "test").std
    np.testing.assert_allclose(std[:, 0], 1e-3 * np.abs(PLANE[:, 0]), atol=1.2e-4)
    assert_close(std[:, 1], np.zeros(len(PLANE)), 2e-4, of=std)


def test_points_in_line_are_refused() -> None:
    with pytest.raises(NotMeasuredError, match="span"):
        integrate(exact(np.stack([SIDES, np.zeros(5)], axis=1)), "test")


def test_a_point_measured_twice_at_the_very_same_current_counts_twice() -> None:
    twice = np.concatenate([PLANE, PLANE[7:8]])
    once, both = integrate(exact(PLANE), "grid"), integrate(exact(twice), "grid")
    assert_close(both.psi[:-1], once.psi, 1e-3)
    assert_close(both.psi[-1], both.psi[7], 1e-9)
