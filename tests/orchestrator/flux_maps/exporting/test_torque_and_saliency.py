from __future__ import annotations

import numpy as np
import pytest

from orchestrator.flux_maps import MapSurface
from orchestrator.flux_maps.exporting import mtpa, mtpv, saliency, torque_nm
from protocols import InputError
from tests.orchestrator.flux_maps.exporting.machines import (
    L_D,
    L_Q,
    POLE_PAIRS,
    PSI_M,
    Array,
    linear_map,
    saturated_energy,
    saturated_flux,
    saturated_map,
    shipped,
)
from tests.support.close import assert_close


def coenergy(i_dq: Array) -> Array:
    psi = saturated_flux(i_dq)
    total: Array = np.einsum("...i,...i->...", psi, i_dq) - saturated_energy(psi)
    return total


def test_torque_is_the_coenergys_slope_over_the_rotor_angle_at_fixed_phase_currents() -> None:
    flux_map = saturated_map()
    d, q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")

    def turned(theta: float) -> Array:
        return np.stack((np.cos(theta) * d + np.sin(theta) * q, -np.sin(theta) * d + np.cos(theta) * q), axis=-1)

    step = 1e-5
    slope = 1.5 * POLE_PAIRS * (coenergy(turned(step)) - coenergy(turned(-step))) / (2 * step)
    torque = torque_nm(flux_map, POLE_PAIRS)
    known = np.isfinite(torque)
    assert known.mean() > 0.7
    assert_close(slope[known], torque[known], 1e-7)


def test_mtpa_of_constant_inductances_is_the_closed_form() -> None:
    currents = np.array([0.0, 0.5, 2.0, 5.0, 9.5])
    curve = mtpa(linear_map(), POLE_PAIRS, currents)
    delta = L_Q - L_D
    i_d = (PSI_M - np.sqrt(PSI_M**2 + 8.0 * delta**2 * currents**2)) / (4.0 * delta)
    i_q = np.sqrt(currents**2 - i_d**2)
    assert_close(curve.i_dq, np.column_stack((i_d, i_q)), 1e-6)
    assert_close(curve.torque_nm, 1.5 * POLE_PAIRS * (PSI_M - delta * i_d) * i_q, 1e-9)
    assert curve.interior.all()


def test_mtpv_of_constant_inductances_is_the_closed_form() -> None:
    """Largest psi_q (psi_m/L_d - psi_d (1/L_d - 1/L_q)) on a circle of flux, with the current that it takes."""
    fluxes = np.array([0.02, 0.05, 0.1, 0.15])
    curve = mtpv(linear_map(), POLE_PAIRS, fluxes)
    a, b = PSI_M / L_D, 1 / L_D - 1 / L_Q
    cosine = (a - np.sqrt(a**2 + 8.0 * b**2 * fluxes**2)) / (4.0 * b * fluxes)
    psi_d, psi_q = fluxes * cosine, fluxes * np.sqrt(1.0 - cosine**2)
    assert_close(curve.psi_dq, np.column_stack((psi_d, psi_q)), 6e-6)
    assert_close(curve.i_dq, np.column_stack(((psi_d - PSI_M) / L_D, psi_q / L_Q)), 1e-5)
    np.testing.assert_allclose(curve.torque_nm, 1.5 * POLE_PAIRS * psi_q * (a - b * psi_d), rtol=1e-9)
    assert curve.interior.all()


def test_mtpa_of_a_measured_machine_is_what_trying_every_angle_finds() -> None:
    flux_map, currents = shipped("baldor-5k6"), np.array([3.0, 9.0, 16.0])
    curve = mtpa(flux_map, POLE_PAIRS, currents)
    turn = np.linspace(0.0, np.pi, 40001)
    surface = MapSurface(flux_map)
    for row, current in enumerate(currents):
        i = current * np.column_stack((np.cos(turn), np.sin(turn)))
        psi = surface.psi(i)
        torque = 1.5 * POLE_PAIRS * (psi[:, 0] * i[:, 1] - psi[:, 1] * i[:, 0])
        assert curve.torque_nm[row] == pytest.approx(torque.max(), rel=1e-8)
        np.testing.assert_allclose(curve.i_dq[row], i[np.argmax(torque)], atol=2e-3)
    assert curve.interior.all()


@pytest.mark.slow
def test_saturated_mtpv_is_what_trying_every_current_finds() -> None:
    flux_map = saturated_map()
    curve = mtpv(flux_map, POLE_PAIRS, np.array([0.33]))
    axis = np.linspace(-3.0, 3.0, 601)
    i = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    i = i[MapSurface(flux_map).inside(i) & (i[:, 1] > 0)]
    psi = saturated_flux(i)
    on_circle = np.abs(np.linalg.norm(psi, axis=1) - 0.33) < 1e-4
    torque = 1.5 * POLE_PAIRS * (psi[:, 0] * i[:, 1] - psi[:, 1] * i[:, 0])[on_circle]
    assert on_circle.sum() > 100
    assert curve.torque_nm[0] == pytest.approx(torque.max(), rel=0.01)
    assert np.linalg.norm(curve.psi_dq[0]) == pytest.approx(0.33)


def test_a_best_point_at_the_edge_of_the_measurement_is_stated_to_be_one() -> None:
    flux_map = linear_map()
    right = {
        name: getattr(flux_map, name)[10:]
        for name in type(flux_map).model_fields
        if name not in ("method", "basis", "i_q")
    }
    curve = mtpa(flux_map.model_copy(update=right), POLE_PAIRS, np.array([2.0, 8.0]))
    assert not curve.interior.any()
    assert_close(curve.i_dq, [[0.0, 2.0], [0.0, 8.0]], 1e-5)


def test_magnitudes_that_were_never_measured_are_nan() -> None:
    curve = mtpa(saturated_map(), POLE_PAIRS, np.array([1.0, 5.0]))
    assert np.isfinite(curve.i_dq[0]).all()
    assert np.isnan(curve.i_dq[1]).all()
    assert np.isnan(curve.psi_dq[1]).all()
    assert curve.interior.tolist() == [True, False]


def test_a_map_without_a_motoring_half_has_no_curves() -> None:
    flux_map = linear_map()
    fields = [name for name in type(flux_map).model_fields if name not in ("method", "basis", "i_d", "i_q")]
    lower = {name: getattr(flux_map, name)[:, :11] for name in fields} | {"i_q": flux_map.i_q[:11]}
    with pytest.raises(InputError, match="no measured point with i_q > 0"):
        mtpa(flux_map.model_copy(update=lower), POLE_PAIRS)


def test_saliency_is_the_inductance_matrixs_own() -> None:
    flux_map = saturated_map()
    found = saliency(flux_map)
    known = np.isfinite(flux_map.l_dd)
    matrix = np.stack(
        (np.stack((flux_map.l_dd, flux_map.l_dq), -1), np.stack((flux_map.l_dq, flux_map.l_qq), -1)), axis=-2
    )[known]
    eigenvalues = np.linalg.eigvalsh(matrix)
    np.testing.assert_allclose(found.l_min[known], eigenvalues[:, 0], rtol=1e-12)
    np.testing.assert_allclose(found.l_max[known], eigenvalues[:, 1], rtol=1e-12)
    np.testing.assert_allclose(found.ratio[known], eigenvalues[:, 1] / eigenvalues[:, 0], rtol=1e-12)
    angle = found.angle_rad[known]
    axis = np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    np.testing.assert_allclose(np.einsum("ni,nij,nj->n", axis, matrix, axis), eigenvalues[:, 0], rtol=1e-10)
    assert np.isnan(found.ratio[~known]).all()


def test_saliency_without_cross_saturation_lies_on_the_d_axis() -> None:
    found = saliency(linear_map())
    np.testing.assert_allclose(found.ratio, L_Q / L_D)
    np.testing.assert_allclose(found.angle_rad, 0.0, atol=1e-15)


def test_saliency_angle_is_odd_in_i_q_where_the_energy_is_even() -> None:
    angle = saliency(saturated_map()).angle_rad
    assert_close(angle, -angle[:, ::-1], 1e-9)
    assert np.nanmax(np.abs(angle)) > 0.05


def test_an_inductance_that_is_not_positive_has_no_ratio() -> None:
    flux_map = linear_map()
    found = saliency(flux_map.model_copy(update={"l_dd": -flux_map.l_dd}))
    assert np.isnan(found.ratio).all()
