"""The checks that need no truth, on a map whose energy is known."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.analysis import check_map, difference_percent, rated_flux_wb, reference_flux_wb
from protocols import FluxMap, Motor
from tests.orchestrator.analysis.plant import flux_for, saturated_current, saturated_hessian


def exact_map(method: str = "exact") -> FluxMap:
    """The saturated motor's own map, NaN in one corner."""
    axis = np.linspace(-3.0, 3.0, 41)
    psi = flux_for(np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1), saturated_current)
    inductance = np.linalg.inv(saturated_hessian(psi))
    psi[:3, :3] = np.nan
    zero = np.zeros(psi.shape[:2])
    return FluxMap(
        method=method,
        i_d=axis,
        i_q=axis,
        psi_d=psi[..., 0] + 0.3,
        psi_q=psi[..., 1],
        l_dd=inductance[..., 0, 0],
        l_dq=inductance[..., 0, 1],
        l_qq=inductance[..., 1, 1],
        psi_d_std=zero,
        psi_q_std=zero,
        l_dd_std=zero,
        l_dq_std=zero,
        l_qq_std=zero,
    )


def test_a_map_from_an_even_energy_passes_parity_and_reciprocity() -> None:
    flux_map = exact_map()
    rated = rated_flux_wb(flux_map, 2.35)
    assert rated == pytest.approx(float(np.linalg.norm(flux_for(np.array([0.0, 2.35]), saturated_current))), rel=1e-3)
    checks = check_map(flux_map, rated, None)
    assert checks.crossings is None
    assert checks.parity is not None
    assert checks.parity.d_percent is not None
    assert checks.parity.d_percent < 1e-6
    assert checks.reciprocity_percent is not None
    assert checks.reciprocity_percent < 0.5


def test_a_map_that_breaks_them_does_not() -> None:
    flux_map = exact_map()
    odd = 0.01 * np.tanh(flux_map.i_q)[None, :] * np.ones_like(flux_map.psi_d)
    broken = flux_map.model_copy(update={"psi_d": flux_map.psi_d + odd})
    rated = rated_flux_wb(flux_map, 2.35)
    assert rated is not None
    checks = check_map(broken, rated, np.array([[0.001, -0.002], [0.0, 0.001]]))
    assert checks.parity is not None
    assert checks.parity.d_percent == pytest.approx(100 * 0.01 * np.tanh(3.0) / rated, rel=1e-6)
    assert checks.crossings is not None
    assert checks.crossings.q_percent == pytest.approx(0.2 / rated)
    assert checks.reciprocity_percent is not None
    assert checks.reciprocity_percent > 1.0


def test_what_a_map_does_not_reach_is_null() -> None:
    flux_map = exact_map()
    assert rated_flux_wb(flux_map, None) is None
    assert rated_flux_wb(flux_map, 9.0) is None
    checks = check_map(flux_map, None, np.ones((2, 2)))
    assert checks.parity is None
    assert checks.crossings is None


def test_difference_of_maps_does_not_see_the_magnet() -> None:
    one = exact_map()
    moved = one.model_copy(update={"psi_d": one.psi_d - 0.3})
    assert difference_percent(one, moved, 0.14) == pytest.approx(0.0, abs=1e-9)
    scaled = one.model_copy(update={"psi_q": 1.01 * one.psi_q})
    found = difference_percent(one, scaled, 0.14)
    assert found == pytest.approx(1.0 / 0.14 * float(np.sqrt(np.nanmean(one.psi_q**2))), rel=1e-3)


def test_a_map_that_stops_early_is_reported_in_percent_of_the_flux_at_its_edge() -> None:
    flux_map, motor = exact_map(), Motor(name="m", pole_pairs=2, rated_current_rms_a=1.66, pm_flux_wb=0.3)
    assert reference_flux_wb(flux_map, motor) == rated_flux_wb(flux_map, motor.rated_current_a)
    larger = motor.model_copy(update={"rated_current_rms_a": 9.0})
    at_edge = float(np.linalg.norm(flux_for(np.array([0.0, 3.0]), saturated_current)))
    assert reference_flux_wb(flux_map, larger) == pytest.approx(at_edge, rel=1e-3)
    zero = np.zeros((1, 1))
    point = flux_map.model_copy(update={"i_d": zero[0], "i_q": zero[0], "psi_d": zero + 0.31, "psi_q": zero})
    assert reference_flux_wb(point, larger) == 0.3
