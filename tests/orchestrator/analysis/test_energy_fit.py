"""The energy fit on exact and on noisy inductances and paths of a motor whose flux is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orchestrator.analysis import EnergyFit, FluxPath, Inductances, fit_energy
from orchestrator.analysis._inductance_errors import GAIN_STD, error_modes
from tests.orchestrator.analysis.plant import Array, flux_for, rotated, saturated_current, saturated_hessian
from tests.orchestrator.analysis.test_integration import PLANE, exact
from tests.orchestrator.analysis.test_sweep import RATED_WB
from tests.support.cases import few
from tests.support.close import assert_close

RANDOM = np.random.default_rng(8)
PLACES = RANDOM.uniform(-2.9, 2.9, (80, 2))
STD = 0.02
"""Of the Hessian's entries [1/H], a thousandth of them."""


@cache
def measured(std: float = STD, seed: int = 1, angle: float = 0.0, stiffening: float = 0.0) -> Inductances:
    """Inductances at a 5 x 5 grid in a frame that is believed to be at `angle` less than it is."""
    clean = exact(rotated(PLANE, -angle), std)
    symmetric = np.random.default_rng(seed).normal(size=(len(PLANE), 3))[:, [[0, 1], [1, 2]]] * std
    matrix = np.linalg.inv(np.linalg.inv(clean.matrix) + symmetric + stiffening * np.eye(2))
    kept = matrix @ np.linalg.inv(clean.matrix)
    slope = np.einsum("nai,nbj,nck,nijk->nabc", kept, kept, kept, clean.slope)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    covariance = clean.covariance + 1e-9 * np.diag([0, 0, 0, 1, 1, 1, 1])
    return Inductances(
        PLANE, turn @ matrix @ turn.T, np.einsum("ai,bj,ck,nijk->nabc", turn, turn, turn, slope), covariance
    )


@cache
def paths(std: float = 3e-5, seed: int = 1) -> tuple[FluxPath, ...]:
    """Five paths along each axis, each with a constant of its own."""
    random = np.random.default_rng(seed)
    out = []
    for held in np.linspace(-3.0, 3.0, 5):
        for axis in range(2):
            current = np.full((61, 2), held)
            current[:, axis] = np.linspace(-3.0, 3.0, 61)
            off = std * np.outer(np.sin(np.linspace(0.0, np.pi, 61)), random.normal(size=2)) + random.normal(size=2)
            out.append(FluxPath(current, flux_for(current, saturated_current) + off, np.full(2, std)))
    return tuple(out)


def flux_off(fit: EnergyFit, angle: float = 0.0) -> Array:
    truth = rotated(flux_for(rotated(PLACES, -angle), saturated_current), angle)
    return fit.flux(PLACES)[0] - truth


@cache
def both() -> EnergyFit:
    return fit_energy(measured(), paths())


def test_exact_inductances_give_the_exact_flux() -> None:
    assert np.abs(flux_off(fit_energy(measured(1e-5), ()))).max() < 1e-3 * RATED_WB


@pytest.mark.slow
def test_paths_alone_give_flux_and_inductance() -> None:
    fit = fit_energy(None, paths())
    assert np.abs(flux_off(fit)).max() < 3e-3 * RATED_WB
    inductance = np.linalg.inv(saturated_hessian(flux_for(PLACES, saturated_current)))[:, [0, 0, 1], [0, 1, 1]]
    assert np.abs(fit.inductance(PLACES)[0] - inductance).max() < 0.03 * inductance.max()


@pytest.mark.slow
def test_both_together_are_no_worse_than_the_better() -> None:
    alone = [np.abs(flux_off(fit_energy(*kinds))).max() for kinds in ((measured(), ()), (None, paths()))]
    assert np.abs(flux_off(both())).max() < 1.3 * min(alone)


def test_flux_and_inductance_are_of_one_even_energy() -> None:
    fit = both()
    for axis, e in enumerate(1e-4 * np.eye(2)):
        slope = (fit.flux(PLACES + e)[0] - fit.flux(PLACES - e)[0]) / 2e-4
        assert_close(slope, fit.inductance(PLACES)[0][:, axis : axis + 2], 2e-6)
    mirrored = fit.flux(PLACES * np.array([1.0, -1.0]))[0]
    assert_close(mirrored, fit.flux(PLACES)[0] * np.array([1.0, -1.0]), 1e-11)
    assert_close(fit.flux(np.zeros((1, 2)))[0], np.zeros((1, 2)), 1e-11, of=mirrored)


@pytest.mark.slow
def test_intervals_hold_what_they_say() -> None:
    inside = []
    gains = 1.0 + GAIN_STD * np.random.default_rng(2).normal(size=5)
    for seed, gain in enumerate(gains):
        points = measured(seed=seed)
        fit = fit_energy(replace(points, matrix=gain * points.matrix, slope=gain * points.slope), ())
        inside.append(np.abs(flux_off(fit)) < 1.96 * fit.flux(PLACES)[1])
    assert 0.88 < np.mean(inside) < 0.995


@pytest.mark.slow
def test_errors_larger_than_stated_are_noticed() -> None:
    points = measured()
    modest = replace(points, covariance=points.covariance / 100.0)
    fit = fit_energy(modest, ())
    assert fit.scales[0] == pytest.approx(10.0, rel=0.3)
    assert np.mean(np.abs(flux_off(fit)) < 1.96 * fit.flux(PLACES)[1]) > 0.7


@few("degrees", [-1.7, 3.0])
def test_a_turned_axis_of_symmetry_is_found(degrees: float) -> None:
    angle = np.radians(degrees)
    fit = fit_energy(measured(angle=angle), ())
    assert np.degrees(fit.angle_rad) == pytest.approx(degrees, abs=0.15)
    assert np.abs(flux_off(fit, angle)).max() < 2e-3 * RATED_WB


def test_a_straight_one_is_left_alone() -> None:
    assert fit_energy(measured(), ()).angle_rad == 0.0


@pytest.mark.slow
def test_what_hysteresis_adds_to_the_ripples_hessian_is_taken_out() -> None:
    fit = fit_energy(measured(stiffening=1.0), paths())
    assert fit.stiffening_per_h == pytest.approx(1.0, rel=0.15)
    assert np.abs(flux_off(fit)).max() < 5e-3 * RATED_WB
    assert both().stiffening_per_h == 0.0
    # A ripple that is softer than the sweeps is something else.
    assert fit_energy(measured(stiffening=-1.0), paths()).stiffening_per_h == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("std", "reported"), [(1e-3, 3.0), (1e-1, 0.0)])
def test_sweeps_tell_of_hysteresis_and_a_ripple_alone_does_not(std: float, reported: float) -> None:
    """What bends a ripple until it is no Hessian may look like it; of what uncertain sweeps say nothing, nothing is."""
    assert fit_energy(measured(stiffening=3.0), paths(std)).stiffening_per_h == pytest.approx(reported, rel=0.05)


def test_dead_time_where_a_phase_current_passes_zero_is_taken_out() -> None:
    points = measured()
    shape = np.array([0.0, 0.03, 0.03, 0.02, 0.01, 0.005, 0.0, 0.0, 0.0])
    effect = (error_modes(points, np.zeros(len(PLANE))) @ shape)[:, [[0, 1], [1, 2]]]
    fit = fit_energy(replace(points, matrix=points.matrix + effect), paths())
    assert fit.inverter_step > 0.0
    assert np.abs(flux_off(fit)).max() < 3e-3 * RATED_WB
    found = fit.correction[:, :3][np.abs(effect[:, 0, 0]) > 0.02 * points.matrix[:, 0, 0]]
    assert len(found) == 5
    assert np.abs(found[:, 0] / effect[np.abs(effect[:, 0, 0]) > 0.02 * points.matrix[:, 0, 0], 0, 0] - 1.0).max() < 0.2
    clear = np.abs(fit.correction[:, 0]) > 4.0 * fit.correction_std[:, 0]
    assert clear[np.abs(effect[:, 0, 0]) > 0.02 * points.matrix[:, 0, 0]].all()
    assert both().inverter_step == 0.0


@pytest.mark.slow
def test_noise_is_not_taken_for_a_gain() -> None:
    """A gain that all points have in common cannot be reported from the points themselves, however many there are."""
    random = np.random.default_rng(3)
    places = random.uniform(-3.0, 3.0, (300, 2))
    clean = exact(places, 0.05)
    noise = random.normal(size=(300, 3))[:, [[0, 1], [1, 2]]] * 0.05
    points = replace(clean, matrix=np.asarray(np.linalg.inv(np.linalg.inv(clean.matrix) + noise), dtype=np.float64))
    gain = fit_energy(points, ()).correction[:, 0] / clean.matrix[:, 0, 0]
    assert abs(gain.mean()) < 0.2 * GAIN_STD


@pytest.mark.slow
def test_points_that_nothing_confirms_count_for_less() -> None:
    points = measured()
    matrix = points.matrix.copy()
    matrix[[3, 17]] *= 1.1
    fit = fit_energy(replace(points, matrix=matrix), paths())
    assert (fit.trust[[3, 17]] < 0.5).all()
    assert (np.delete(fit.trust, [3, 17]) > 0.5).mean() > 0.9
    assert np.abs(flux_off(fit)).max() < 5e-3 * RATED_WB


@pytest.mark.slow
def test_a_paths_common_error_is_not_averaged_away() -> None:
    few, many = (fit_energy(None, paths()[:n]) for n in (6, 10))
    # Ten paths are hardly better than six where all of them may err alike.
    here = np.array([[1.0, 1.0]])
    assert many.flux(here)[1].max() > 0.6 * few.flux(here)[1].max()


@pytest.mark.slow
def test_the_spline_becomes_finer_where_the_iron_asks_for_it() -> None:
    coarse = fit_energy(measured(1e-3), ())
    along_q = np.linspace(-3.0, 3.0, 31)
    grid = np.stack(np.meshgrid(np.linspace(-3.0, 3.0, 7), along_q, indexing="ij"), axis=-1).reshape(-1, 2)
    knee = 1.0 + 4.0 / (1.0 + (grid[:, 1] / 0.6) ** 2)
    matrix = 0.04 * np.stack([np.stack([np.ones_like(knee), 0 * knee], -1), np.stack([0 * knee, knee], -1)], -2)
    points = Inductances(
        grid, matrix, np.zeros((len(grid), 2, 2, 2)), np.tile(1e-9 * np.diag([1, 1, 1, 0, 0, 0, 0]), (len(grid), 1, 1))
    )
    fine = fit_energy(points, ())
    assert fine.spline.size > coarse.spline.size
    truth = 0.04 * (grid[:, 1] + 4.0 * 0.6 * np.arctan(grid[:, 1] / 0.6))
    assert np.abs(fine.flux(grid)[0][:, 1] - truth).max() < 0.01 * truth.max()
