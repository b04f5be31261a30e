"""Plants from anybody's map: every form of file, half planes, holes, magnets off the axis; how well they are met."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from orchestrator.flux_maps import load_map
from orchestrator.flux_maps.exporting import export_map
from plugins.drives.simulated import SimulatedDrive, SimulatedOptions, TrueMagnetics, map_motor, true_flux
from plugins.drives.simulated._map import FluxTable, describe_misfit, fit_error, load_table, map_energy, usable_reach
from protocols import DriveSetup, FluxMap
from tests.support.cases import few
from tests.support.close import assert_close

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
MOTOR = map_motor("baldor-5k6")
INSIDE_A = np.stack(np.meshgrid([-10.0, -5.0, 0.0, 4.0], [-8.0, -3.0, 0.0, 6.0]), axis=-1).reshape(-1, 2)


@cache
def shipped() -> FluxTable:
    return load_table("baldor-5k6", None)


def plant(**magnetics: str) -> TrueMagnetics:
    return true_flux(SimulatedOptions.model_validate({"plant": {"magnetics": {"kind": "map", **magnetics}}}), MOTOR)


def written(path: Path, table: FluxTable) -> Path:
    rows = (",".join(map(str, row)) for row in np.hstack((table.psi_dq, table.i_dq)))
    path.write_text("\n".join(("psi_d_Vs,psi_q_Vs,i_d_A,i_q_A", *rows)))
    return path


@pytest.mark.slow
@few("format_name", ["csv", "netcdf", "npz", "syre"])
def test_what_we_export_is_a_plant(tmp_path: Path, format_name: str) -> None:
    whole = load_map(written(tmp_path / "whole.csv", shipped()))
    (file,) = export_map(whole, MOTOR, tmp_path / "exported", [format_name]).files
    assert_close(plant(file=str(file.path)).flux(INSIDE_A), plant(name="baldor-5k6").flux(INSIDE_A), 1e-6)


@pytest.mark.slow
def test_half_a_plane_is_completed_by_evenness(tmp_path: Path) -> None:
    table = shipped()
    half = table.i_dq[:, 1] >= 0.0
    path = written(tmp_path / "half.csv", replace(table, i_dq=table.i_dq[half], psi_dq=table.psi_dq[half]))
    assert_close(plant(file=str(path)).flux(INSIDE_A), plant(name="baldor-5k6").flux(INSIDE_A), 2e-3)


@pytest.mark.slow
def test_corners_without_a_flux_are_left_to_smoothness(tmp_path: Path) -> None:
    table = shipped()
    corners = np.linalg.norm(table.i_dq / np.array([20.0, 26.0]), axis=1) > 1.05
    holed = np.where(corners[:, None], np.nan, table.psi_dq)
    path = written(tmp_path / "holed.csv", replace(table, psi_dq=holed))
    assert_close(plant(file=str(path)).flux(INSIDE_A), plant(name="baldor-5k6").flux(INSIDE_A), 2e-3)


@pytest.mark.slow
@few("degrees", [4.0, -90.0])
def test_a_magnet_off_the_axis_is_put_on_it(tmp_path: Path, degrees: float) -> None:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, s], [-s, c]])  # rows times this: by the angle
    truth = plant(name="baldor-5k6")
    axis = np.linspace(-12.0, 12.0, 13)
    i_dq = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    path = written(tmp_path / "turned.csv", FluxTable("turned", i_dq, truth.flux(i_dq @ turn.T) @ turn))
    table = load_table(None, path)
    assert np.degrees(table.turned_rad) == pytest.approx(degrees, abs=0.01)
    assert f"turned by {-degrees:+.1f} degrees" in describe_misfit(table, map_energy(table))
    inside_a = 0.8 * INSIDE_A
    assert_close(plant(file=str(path)).flux(inside_a), truth.flux(inside_a), 5e-3)


@pytest.mark.slow
def test_a_quarter_of_a_plane_beside_zero_current_is_as_the_shipped_one_of_its_points(tmp_path: Path) -> None:
    table = load_table("ipm-femm-60c", None)  # bridges that saturate before the first point are no turn of the magnet
    path = written(tmp_path / "quarter.csv", table)
    own = load_table(None, path)
    assert own.turned_rad == 0.0
    magnetics = map_energy(own)
    assert "so the magnet is taken to lie on d, as in the file" in describe_misfit(own, magnetics)
    # Between the points and their mirror images no point says that the energy is convex: it has to be nevertheless.
    reach_a = usable_reach(table, map_energy(table), positive_d=False)
    assert usable_reach(own, magnetics, positive_d=False) == pytest.approx(reach_a)
    assert reach_a > 180.0


@pytest.mark.slow
def test_the_misfit_is_that_of_the_scatter(tmp_path: Path) -> None:
    table = shipped()
    noise = np.random.default_rng(1).normal(scale=2e-3, size=table.psi_dq.shape)
    rough = load_table(None, written(tmp_path / "rough.csv", replace(table, psi_dq=table.psi_dq + noise)))
    smooth = fit_error(table, map_energy(table))
    assert fit_error(rough, map_energy(rough)) > 2.0 * smooth


def test_a_drive_says_beforehand_how_well_its_map_is_met() -> None:
    options = SimulatedOptions.model_validate({"plant": {"magnetics": {"kind": "map", "name": "baldor-5k6"}}})
    drive = SimulatedDrive(DriveSetup(motor=MOTOR, options=options, seed=1))
    bus, note = drive.connect().notes
    drive.close()
    assert "simulated with a bus of" in bus
    assert "baldor-5k6" in note
    assert "567 points within 0.12 % of the current" in note


def test_the_loader_is_the_one_of_models(tmp_path: Path) -> None:
    path = written(tmp_path / "own.csv", shipped())
    flux_map: FluxMap = load_map(path)
    assert np.isfinite(flux_map.psi_d).sum() == len(load_table(None, path).i_dq)
