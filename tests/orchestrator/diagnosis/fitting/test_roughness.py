"""Local roughness of a map: where it comes from, and that the evidence prefers it."""

from dataclasses import replace

import numpy as np
import pytest

from orchestrator.diagnosis.fitting.baseline import (
    DiagnosisSetup,
    has_fine_grid,
    map_log_evidence,
    map_space,
    with_local_roughness,
    with_sharpest_map,
)
from orchestrator.diagnosis.fitting.candidates import scaled_library
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.fitting.roughness import NODES, estimated_roughness
from orchestrator.diagnosis.weak_form.magnetics import shares_of_nodes
from orchestrator.numerics.tensor_spline import EvenSpline
from plugins.drives.simulated._map import load_table
from plugins.effects.timing import CurrentFilter
from protocols import Saturated


@pytest.mark.slow
def test_iron_that_bends_at_zero_flux_is_rough_there_and_smooth_elsewhere(sharp_fit_without_kink: Fit) -> None:
    roughness = estimated_roughness(sharp_fit_without_kink)
    assert roughness.shape == NODES
    at_zero, outside = roughness[1:-1, 0], roughness[1:-1, 2]
    assert at_zero.min() > 2.0 * outside.max()


@pytest.mark.slow
def test_a_rough_map_gains_evidence_by_its_places(sharp: DiagnosisSetup, sharp_fit_without_kink: Fit) -> None:
    fit = sharp_fit_without_kink
    assert has_fine_grid(fit)
    local = with_local_roughness(sharp, sharp.fitter, fit)
    assert map_log_evidence(local) >= map_log_evidence(fit)


@pytest.mark.slow
def test_the_last_map_is_likelier_and_nearer_to_the_iron_and_effects_keep_their_values(
    sharp: DiagnosisSetup, sharp_fit_without_kink: Fit
) -> None:
    before = sharp_fit_without_kink.model
    (lag,) = scaled_library([CurrentFilter()], sharp.prepared.manifest)

    def on(cells: tuple[int, int]) -> Fit:
        grid = replace(before.space.grid, cells=cells)
        space = map_space(sharp, Saturated(), grid, np.zeros(grid.size), np.full((1, 1), 9.0))
        return sharp.fitter.fit(
            replace(before, space=space, magnetics=before.magnetics.on(grid), active=(lag.absent(),))
        )

    # To what is more than noise a finer map would adapt.
    off = on((10, 14))
    assert with_sharpest_map(sharp, sharp.fitter, off) is off
    coarse = on((14, 20))
    finest = with_sharpest_map(sharp, sharp.fitter, coarse)
    assert map_log_evidence(finest) > map_log_evidence(coarse) + 50.0
    assert finest.model.active == coarse.model.active
    assert _off_wb(finest) < 0.95 * _off_wb(coarse)


def _off_wb(fit: Fit) -> float:
    """rms error of the flux over the currents that were measured, against the table of the machine."""
    table = load_table("ipm-femm-60c", None)
    low, high = fit.model.space.grid.low, fit.model.space.grid.high
    d, q = table.i_dq.T
    inside = (d >= low) & (d <= high) & (np.abs(q) <= fit.model.space.grid.reach)
    error = fit.model.magnetics.flux_and_inductance(table.i_dq[inside])[0] - table.psi_dq[inside]
    return float(np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)))


def test_a_usual_map_stays_as_it_is(setup: DiagnosisSetup, linear_fit: Fit) -> None:
    assert not has_fine_grid(linear_fit)
    assert with_local_roughness(setup, setup.fitter, linear_fit) is linear_fit
    assert with_sharpest_map(setup, setup.fitter, linear_fit) is linear_fit


def test_an_even_roughness_at_all_nodes_is_that_of_a_single_one(setup: DiagnosisSetup) -> None:
    grid = EvenSpline(-3.0, 2.0, 4.0, (7, 9))
    one, many = (map_space(setup, Saturated(), grid, np.zeros(grid.size), np.full(n, 5.0)) for n in ((1, 1), NODES))
    np.testing.assert_allclose(many.prior, one.prior, rtol=1e-12)


def test_shares_of_nodes_add_up_and_follow_the_place() -> None:
    places = np.random.default_rng(1).uniform(size=(40, 2))
    shares = shares_of_nodes(places, NODES)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    nodes = np.stack(np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in NODES), indexing="ij"), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(shares @ nodes, places, atol=1e-12)


def test_places_of_derivatives_cover_the_grid_in_the_order_of_its_differences() -> None:
    grid = EvenSpline(-3.0, 2.0, 4.0, (7, 9))
    places = grid.difference_places(4)
    assert len(places) == sum(len(block) for block in grid.differences(4))
    assert places.min(axis=0).tolist() == [0.0, 0.0]
    assert places.max(axis=0).tolist() == [1.0, 1.0]


def test_a_constant_of_the_energy_leaves_the_normal_matrix_regular(linear_fit: Fit) -> None:
    size = np.sqrt(np.diag(linear_fit.normal))
    assert np.linalg.eigvalsh(linear_fit.normal / np.outer(size, size))[0] > 1e-14
