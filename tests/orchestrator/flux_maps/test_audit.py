"""Faults are planted in maps that have none; each is named, sized, and gone after a repair."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from orchestrator.flux_maps import MapSurface, audit_map, load_map, repair_map
from protocols import FluxMap, InputError, RealArray
from tests.orchestrator.flux_maps.exporting.machines import (
    MOTOR,
    POLE_PAIRS,
    Array,
    saturated_map,
    shipped,
    shipped_path,
)
from tests.support.cases import few
from tests.support.close import assert_close

AXIS = np.linspace(-16.0, 16.0, 17)
PLANE = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1)


@cache
def sound() -> FluxMap:
    return saturated_map(nodes=25)


def codes(flux_map: FluxMap, torque_nm: Array | None = None) -> list[str]:
    return [fault.remark.code for fault in audit_map(flux_map, MOTOR, torque_nm).faults]


def changed(**tables: RealArray) -> FluxMap:
    return sound().model_copy(update=tables)


def turned(degrees: float) -> FluxMap:
    """A measured machine in a frame whose d axis lies so far behind the magnet's."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    psi = (MapSurface(shipped("baldor-5k6")).psi(PLANE.reshape(-1, 2) @ turn) @ turn.T).reshape(PLANE.shape)
    unknown = {name: np.full(psi.shape[:2], np.nan) for name in FluxMap.model_fields if name[:2] in ("l_", "ps")}
    return FluxMap(method="turned", i_d=AXIS, i_q=AXIS, **unknown | {"psi_d": psi[..., 0], "psi_q": psi[..., 1]})


def test_a_map_that_is_an_energys_gradient_has_no_fault() -> None:
    assert codes(sound()) == []
    assert (audit_map(sound()).reciprocity_percent or np.nan) < 0.01


def test_a_flux_that_no_energy_has_is_named_with_its_size() -> None:
    curled = changed(psi_d=sound().psi_d + 2e-3 * sound().i_q[None, :])
    found = audit_map(curled)
    assert found.reciprocity_h == pytest.approx(2e-3, rel=0.01)
    assert "not_reciprocal" in codes(curled)


@few("degrees", [-1.9, 3.7, -90.0, -86.3], fast=2)
def test_a_turned_frame_is_reported_to_a_hundredth_of_a_degree_and_turned_back(degrees: float) -> None:
    flux_map = turned(degrees)
    found = audit_map(flux_map)
    assert found.axis_rad is not None
    assert np.degrees(found.axis_rad) == pytest.approx(degrees, abs=0.01)
    expected = (["other_axes"] if degrees < -45 else []) + (["turned"] if degrees != -90 else [])
    assert [fault.remark.code for fault in found.faults] == expected
    repaired = repair_map(flux_map)
    at = np.array([[3.0, 5.0], [-8.0, 7.0]])
    assert_close(MapSurface(repaired.flux_map).psi(at), MapSurface(shipped("baldor-5k6")).psi(at), 2e-3)
    assert codes(repaired.flux_map) == []


def test_an_energy_that_is_not_even_is_no_turn() -> None:
    d, q = np.meshgrid(sound().i_d, sound().i_q, indexing="ij")
    uneven = changed(psi_d=sound().psi_d + 2e-3 * d * q, psi_q=sound().psi_q + 1e-3 * d**2)
    assert codes(uneven) == ["not_even"]


def test_points_that_are_not_convex_are_counted_and_repaired() -> None:
    psi_d = np.array(sound().psi_d)
    psi_d[10:14, 10:15] += np.array([0.0, 0.03, -0.03, 0.0])[:, None]
    found = audit_map(changed(psi_d=psi_d))
    assert len(found.non_convex) > 3
    assert found.least_inductance_h < 0.0
    assert any("not convex" in note and "inverse map" in note for note in found.notes)
    repaired = repair_map(changed(psi_d=psi_d)).flux_map
    assert codes(repaired) == []
    assert audit_map(repaired).least_inductance_h > 0.0


def test_one_point_out_of_line_is_found_where_it_is() -> None:
    psi_q = np.array(sound().psi_q)
    psi_q[8, 15] += 2e-3
    (fault,) = [f for f in audit_map(changed(psi_q=psi_q)).faults if f.remark.code == "out_of_line"]
    assert f"{sound().i_d[8]:+.3f}".replace("-", "−") in fault.remark.text


def test_a_hole_counts_and_what_lies_outside_does_not() -> None:
    psi_d = np.array(sound().psi_d)
    assert np.isnan(psi_d[0, 0])
    assert audit_map(sound()).holes == 0
    psi_d[12, 12] = np.nan
    assert codes(changed(psi_d=psi_d)) == ["holes"]


def test_errors_below_the_maps_own_are_no_fault() -> None:
    offset = sound().psi_q + 2e-3
    std = np.full(offset.shape, 2e-3)
    assert codes(changed(psi_q=offset, psi_d_std=std, psi_q_std=std)) == []


@pytest.mark.parametrize(("factor", "words"), [(-1.0, "opposite sign"), (2 / 3, "power-invariant"), (0.5, "rms")])
def test_a_torque_of_another_scale_is_named_by_what_makes_such_scales(factor: float, words: str) -> None:
    m = sound()
    torque = 1.5 * POLE_PAIRS * (m.psi_d * m.i_q[None, :] - m.psi_q * m.i_d[:, None])
    (fault,) = audit_map(m, MOTOR, factor * torque).faults
    assert words in fault.remark.text
    assert codes(m, torque) == []


def test_what_cannot_be_requested_is_stated() -> None:
    codes = {remark.code for remark in audit_map(shipped("ipm-femm-60c")).remarks}
    assert codes == {"parity_unasked", "rest_unknown", "torque_unasked"}


def test_public_maps_of_real_machines_are_what_they_are() -> None:
    assert [f.remark.code for f in audit_map(shipped("baldor-5k6")).faults] == []
    slow, fast = (load_map(shipped_path(f"beckhoff-am8141-{rpm}rpm")) for rpm in (400, 800))
    assert [f.remark.code for f in audit_map(slow).faults] == ["not_reciprocal", "turned", "not_even"]
    assert [f.remark.code for f in audit_map(fast).faults] == ["turned"]


@pytest.mark.parametrize("scale", [0.0, 1e300, 1e-300])
def test_fluxes_of_no_motor_are_one_line(scale: float) -> None:
    silly = changed(psi_d=scale * sound().psi_d, psi_q=scale * sound().psi_q)
    for judged in (audit_map, repair_map):
        with pytest.raises(InputError, match="is impossible for a motor"):
            judged(silly)
