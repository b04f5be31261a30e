from __future__ import annotations

import numpy as np
import pytest

from orchestrator.flux_maps import MapSurface, fill_smoothly
from orchestrator.flux_maps.exporting import invert
from orchestrator.flux_maps.exporting._inverse import currents_at
from protocols import InputError
from tests.orchestrator.flux_maps.exporting.machines import (
    L_D,
    L_Q,
    PSI_M,
    SHIPPED,
    linear_map,
    saturated_current,
    saturated_flux,
    saturated_map,
    shipped,
)
from tests.support.close import assert_close


def test_a_plane_is_continued_exactly_and_what_is_known_is_left_alone() -> None:
    x, y = np.array([-3.0, -1.0, 0.0, 0.5, 2.0, 5.0]), np.linspace(-2.0, 2.0, 9)
    plane = 0.3 + 0.04 * x[:, None] - 0.02 * y[None, :]
    holed = plane.copy()
    holed[0, :] = holed[-2:, 3:] = holed[2, 2] = np.nan
    filled = fill_smoothly(x, y, holed)
    assert_close(filled, plane, 1e-12)
    np.testing.assert_array_equal(filled[np.isfinite(holed)], holed[np.isfinite(holed)])


def test_a_curved_table_is_continued_smoothly() -> None:
    x = np.linspace(-1.0, 1.0, 21)
    bowl = x[:, None] ** 2 + x[None, :] ** 2
    holed = bowl.copy()
    holed[8:13, 8:13] = np.nan
    np.testing.assert_allclose(fill_smoothly(x, x, holed), bowl, atol=0.02)


def test_points_on_one_line_cannot_be_continued() -> None:
    table = np.full((4, 4), np.nan)
    table[1] = 1.0
    with pytest.raises(InputError, match="do not span an area"):
        fill_smoothly(np.arange(4.0), np.arange(4.0), table)


def test_surface_passes_through_every_measured_point() -> None:
    surface = MapSurface(saturated_map())
    assert_close(surface.psi(surface.currents), surface.fluxes, 1e-14)


def test_slopes_of_the_surface_are_those_of_its_values_inside_and_beyond_the_grid() -> None:
    surface = MapSurface(saturated_map())
    at = np.array([[0.3, -0.7], [1.9, 1.9], [3.4, 0.2], [-3.5, 4.0]])
    step = 1e-6 * np.eye(2)
    numeric = np.stack([(surface.psi(at + e) - surface.psi(at - e)) / 2e-6 for e in step], axis=-1)
    assert_close(surface.jacobian(at)[:2], numeric[:2], 1e-6)
    beyond, onward = at[2:], np.array([[0.1, 0.0], [-0.1, 0.1]])
    went = surface.psi(beyond + onward) - surface.psi(beyond)
    assert_close(went, np.einsum("nij,nj->ni", surface.jacobian(beyond), onward), 1e-10)


def test_measured_region_holds_its_nodes_and_whole_triangles_and_nothing_else() -> None:
    flux_map = saturated_map()
    surface = MapSurface(flux_map)
    assert surface.inside(surface.currents).all()
    rows, columns = np.nonzero(~surface.known)
    assert not surface.inside(np.column_stack((flux_map.i_d[rows], flux_map.i_q[columns]))).any()
    places = np.random.default_rng(1).uniform(-3.5, 3.5, (4000, 2))
    radius, cell = np.linalg.norm(places, axis=1), np.sqrt(2.0) * 0.2
    inside = surface.inside(places)
    assert inside[radius < 3.0 - cell].all()
    assert not inside[radius > 3.0].any()


def test_linear_machine_is_inverted_exactly() -> None:
    inverse = invert(linear_map())
    assert inverse.measured.all()
    assert_close(inverse.i_d, np.broadcast_to((inverse.psi_d[:, None] - PSI_M) / L_D, (51, 51)), 1e-9)
    assert_close(inverse.i_q, np.broadcast_to(inverse.psi_q[None, :] / L_Q, (51, 51)), 1e-9)


@pytest.mark.parametrize(("d", "q"), [(2, 2), (2, 5), (3, 2), (4, 3)])
def test_the_smallest_grids_are_inverted_too(d: int, q: int) -> None:
    whole = linear_map()
    fields = [name for name in type(whole).model_fields if name not in ("method", "basis", "i_d", "i_q")]
    part = {name: getattr(whole, name)[:d, :q] for name in fields} | {"i_d": whole.i_d[:d], "i_q": whole.i_q[:q]}
    inverse = invert(whole.model_copy(update=part))
    assert inverse.coverage_percent == 100.0
    assert_close(inverse.i_d[:, 0], (inverse.psi_d - PSI_M) / L_D, 1e-9)


def inversion_error(nodes: int) -> float:
    """Largest |i - grad H(psi)| well inside the hull."""
    surface = MapSurface(saturated_map(nodes))
    turn = np.linspace(0.0, 2.0 * np.pi, 60)
    i = np.concatenate([r * np.column_stack((np.cos(turn), np.sin(turn))) for r in (0.4, 1.1, 1.8)])
    psi = saturated_flux(i)
    found = currents_at(surface, psi)
    assert_close(saturated_current(psi), i, 1e-9)
    return float(np.linalg.norm(found - i, axis=1).max())


def test_inverse_is_the_gradient_of_the_energy_and_converges_with_the_grid() -> None:
    coarse, fine = inversion_error(16), inversion_error(31)
    assert fine < 1e-4
    assert coarse > 7.0 * fine


def test_nothing_outside_the_hull_is_called_measured_and_nothing_inside_is_lost() -> None:
    inverse = invert(saturated_map())
    grid = np.stack(np.meshgrid(inverse.psi_d, inverse.psi_q, indexing="ij"), axis=-1)
    radius = np.linalg.norm(saturated_current(grid), axis=-1)
    assert inverse.measured[radius < 3.0 - np.sqrt(2.0) * 0.2].all()
    assert not inverse.measured[radius > 3.001].any()
    assert 0.7 < inverse.measured.mean() < 1.0


@pytest.mark.parametrize("name", SHIPPED)
def test_every_measured_point_of_a_real_machine_is_given_back(name: str) -> None:
    flux_map = shipped(name)
    inverse = invert(flux_map)
    assert inverse.coverage_percent == 100.0
    assert inverse.misfit_wb < 1e-9 * np.nanmax(np.abs(flux_map.psi_q))


def test_points_that_an_inscribed_rectangle_loses_are_kept() -> None:
    flux_map = shipped("baldor-5k6")
    surface = MapSurface(flux_map)
    low_d, high_d = flux_map.psi_d.min(axis=0).max(), flux_map.psi_d.max(axis=0).min()
    low_q, high_q = flux_map.psi_q.min(axis=1).max(), flux_map.psi_q.max(axis=1).min()
    d, q = surface.fluxes.T
    lost = (d < low_d) | (d > high_d) | (q < low_q) | (q > high_q)
    assert lost.mean() > 0.4
    assert_close(currents_at(surface, surface.fluxes[lost]), surface.currents[lost], 1e-7)


def test_filled_inverse_keeps_what_was_measured() -> None:
    inverse = invert(saturated_map())
    i_d, i_q = inverse.filled()
    assert np.isfinite(i_d).all()
    np.testing.assert_array_equal(i_d[inverse.measured], inverse.i_d[inverse.measured])
    np.testing.assert_array_equal(i_q[inverse.measured], inverse.i_q[inverse.measured])


def test_axes_that_do_not_increase_are_refused() -> None:
    flux_map = linear_map()
    with pytest.raises(InputError, match="flux map: i_q: expected two or more finite, increasing currents"):
        invert(flux_map.model_copy(update={"i_q": flux_map.i_q[::-1]}))
