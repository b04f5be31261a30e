from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.io import loadmat

from orchestrator.estimation import load_flux_map
from orchestrator.flux_maps import load_map, resistance_basis
from orchestrator.flux_maps.exporting import FORMATS, ExportReport, export_map, invert, mtpa, torque_nm
from protocols import FluxMap, InputError, Motor, StorageError
from tests.orchestrator.flux_maps.exporting.machines import MOTOR, POLE_PAIRS, linear_map, saturated_map, shipped
from tests.support.cases import few
from tests.support.close import assert_close

READABLE = {
    "netcdf": "flux_map.nc",
    "csv": "flux_map.csv",
    "syre": "flux_map_syre.mat",
    "simulink": "flux_based_pmsm.mat",
    "npz": "flux_map.npz",
}
FIELDS = [name for name in FluxMap.model_fields if name not in ("method", "basis", "i_d", "i_q")]


@pytest.fixture(scope="module")
def holed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FluxMap, ExportReport]:
    """Every format of a map with holes."""
    folder, flux_map = tmp_path_factory.mktemp("holed"), saturated_map()
    return folder, flux_map, export_map(flux_map, MOTOR, folder)


def assert_same(found: FluxMap, expected: FluxMap) -> None:
    assert_close(found.i_d, expected.i_d, 1e-15)
    assert_close(found.i_q, expected.i_q, 1e-15)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("form", READABLE)
def test_a_map_with_holes_comes_back_bit_for_bit(form: str, holed: tuple[Path, FluxMap, ExportReport]) -> None:
    folder, flux_map, _ = holed
    assert_same(load_map(folder / READABLE[form]), flux_map)


@few("form", READABLE, fast=2)
def test_a_whole_map_comes_back_bit_for_bit(form: str, tmp_path: Path) -> None:
    flux_map = shipped("beckhoff-am8141-800rpm")
    export_map(flux_map, MOTOR, tmp_path, [form])
    assert_same(load_map(tmp_path / READABLE[form]), flux_map)


@pytest.mark.parametrize("form", ["netcdf", "syre", "simulink", "npz"])
def test_the_method_comes_along(form: str, holed: tuple[Path, FluxMap, ExportReport]) -> None:
    assert load_map(holed[0] / READABLE[form]).method == "exact"


def test_a_run_is_read_by_its_results(tmp_path: Path) -> None:
    export_map(linear_map(), MOTOR, tmp_path / "results", ["netcdf"])
    assert_same(load_map(tmp_path), linear_map())


def test_netcdf_holds_units_torque_inverse_and_trajectories(holed: tuple[Path, FluxMap, ExportReport]) -> None:
    import xarray as xr

    folder, flux_map, _ = holed
    with xr.open_dataset(folder / "flux_map.nc", engine="h5netcdf") as dataset:
        assert dataset.attrs["motor"] == "pm400"
        assert dataset["psi_d"].attrs["units"] == "Wb"
        np.testing.assert_array_equal(dataset["torque_nm"], torque_nm(flux_map, POLE_PAIRS))
        np.testing.assert_array_equal(dataset["inverse_i_d"], invert(flux_map).i_d)
        np.testing.assert_array_equal(dataset["mtpa_i_q"], mtpa(flux_map, POLE_PAIRS).i_dq[:, 1])
    assert load_flux_map(folder / "flux_map.nc").method == "exact"


def test_csv_has_one_header_row_with_units_and_a_row_a_measured_point(
    holed: tuple[Path, FluxMap, ExportReport],
) -> None:
    folder, flux_map, _ = holed
    lines = (folder / "flux_map.csv").read_text().splitlines()
    assert lines[0].startswith("i_d_a,i_q_a,psi_d_wb,psi_q_wb,l_dd_h,l_dq_h,l_qq_h,psi_d_std_wb,")
    assert lines[0].endswith("torque_nm,l_max_h,l_min_h,saliency_ratio,saliency_angle_rad,recording")
    assert len(lines) == 1 + np.isfinite(flux_map.psi_d).sum()


def test_syre_arrays_are_meshgrids_with_i_d_along_the_columns(holed: tuple[Path, FluxMap, ExportReport]) -> None:
    folder, flux_map, _ = holed
    mat = loadmat(folder / "flux_map_syre.mat", simplify_cells=True)
    np.testing.assert_array_equal(mat["Id"][0], flux_map.i_d)
    np.testing.assert_array_equal(mat["Iq"][:, 0], flux_map.i_q)
    np.testing.assert_array_equal(mat["Fd"][:, 3], flux_map.psi_d[3])
    torque = 1.5 * POLE_PAIRS * (mat["Fd"] * mat["Iq"] - mat["Fq"] * mat["Id"])
    assert_close(mat["T"], torque, 1e-14)
    assert mat["fluxbench"]["mtpa"]["i_dq"].shape == (41, 2)


def test_simulinks_tables_have_rows_along_flux_d_no_nan_and_say_what_is_measured(
    holed: tuple[Path, FluxMap, ExportReport],
) -> None:
    folder, flux_map, report = holed
    mat, inverse = loadmat(folder / "flux_based_pmsm.mat", simplify_cells=True), invert(flux_map)
    assert mat["id"].shape == mat["iq"].shape == (51, 51)
    assert mat["flux_d"].shape == (51,)
    assert np.isfinite(mat["id"]).all()
    assert np.isfinite(mat["lambda_d"]).all()
    measured = mat["id_measured"].astype(bool)
    np.testing.assert_array_equal(measured, inverse.measured)
    np.testing.assert_array_equal(mat["id"][measured], inverse.i_d[measured])
    np.testing.assert_array_equal(mat["iq"][measured], inverse.i_q[measured])
    assert (np.diff(mat["id"], axis=0)[measured[1:] & measured[:-1]] > 0).all()
    assert (mat["P"], mat["Rs"]) == (2, 4.25)
    written = next(file for file in report.files if file.format == "simulink")
    assert written.filled_nodes == (~measured).sum()
    assert any("continued" in note for note in written.notes)


def test_motulators_arrays_are_complex_with_i_d_along_the_rows(tmp_path: Path) -> None:
    flux_map = linear_map()
    export_map(flux_map, MOTOR, tmp_path, ["npz"])
    with np.load(tmp_path / "flux_map.npz", allow_pickle=False) as content:
        assert content["i_s_dq"].dtype == content["psi_s_dq"].dtype == np.complex128
        np.testing.assert_array_equal(content["i_s_dq"][:, 0].real, flux_map.i_d)
        np.testing.assert_array_equal(content["psi_s_dq"], flux_map.psi_d + 1j * flux_map.psi_q)
        torque = 1.5 * POLE_PAIRS * np.imag(content["i_s_dq"] * np.conj(content["psi_s_dq"]))
        assert_close(content["tau_M"], torque, 1e-14)


def test_motulator_gets_no_nan_even_from_a_map_with_holes(holed: tuple[Path, FluxMap, ExportReport]) -> None:
    with np.load(holed[0] / "flux_map.npz", allow_pickle=False) as content:
        assert content["i_s_dq"].ndim == 1
        assert np.isfinite(content["psi_s_dq"]).all()


def test_report_says_what_was_measured_and_what_the_inverse_covers(
    holed: tuple[Path, FluxMap, ExportReport],
) -> None:
    folder, flux_map, report = holed
    assert [file.format for file in report.files] == list(FORMATS)
    assert sorted(file.path for file in report.files) == sorted(folder.iterdir())
    assert report.measured_percent == pytest.approx(100.0 * np.isfinite(flux_map.psi_d).mean())
    assert report.inverse_coverage_percent == 100.0
    assert report.inverse_misfit_wb < 1e-9 * np.nanmax(np.abs(flux_map.psi_q))
    assert ExportReport.model_validate_json(report.model_dump_json()) == report


def test_a_magnet_that_a_locked_rotor_cannot_show_is_stated_to_be_missing(tmp_path: Path) -> None:
    unknown = Motor(name="unknown", pole_pairs=2)
    assert any("magnet" in note for note in export_map(linear_map(psi_m=0.0), unknown, tmp_path, ["csv"]).notes)
    assert not any("magnet" in note for note in export_map(linear_map(), unknown, tmp_path, ["csv"]).notes)


def test_a_header_states_the_temperature_of_r_s_and_a_magnet_that_was_copied(tmp_path: Path) -> None:
    export_map(linear_map(), MOTOR, tmp_path, ["c"], resistance=resistance_basis(4.25, 35.0))
    header = (tmp_path / "flux_map.h").read_text(encoding="ascii")
    assert "R_s: 4.25 ohm a phase with the winding at 35 degC" in header
    assert "300 mWb, copied from the nameplate, not from a measurement" in header
    assert "lookup of psi" not in header


@pytest.mark.slow
def test_a_map_that_is_not_convex_says_so_in_every_file_and_beside_the_inverses_coverage(tmp_path: Path) -> None:
    psi_d = np.array(saturated_map(nodes=15).psi_d)
    psi_d[6:9, 7] += [0.05, -0.05, 0.0]
    report = export_map(saturated_map(nodes=15).model_copy(update={"psi_d": psi_d}), MOTOR, tmp_path, ["netcdf", "c"])
    assert report.non_convex_points > 0
    assert any("not convex" in note for note in report.notes)
    with xr.open_dataset(tmp_path / "flux_map.nc") as held:
        assert "not convex" in held.attrs["notes"]
    assert "not convex" in (tmp_path / "flux_map.h").read_text()


def test_a_map_without_motoring_half_is_exported_without_trajectories(tmp_path: Path) -> None:
    flux_map = linear_map()
    lower = {name: getattr(flux_map, name)[:, :10] for name in FIELDS} | {"i_q": flux_map.i_q[:10]}
    report = export_map(flux_map.model_copy(update=lower), MOTOR, tmp_path)
    assert any("no MTPA" in note for note in report.notes)
    assert "mtpa" not in (tmp_path / "flux_map.h").read_text()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("simulnk", "no such format; did you mean simulink? there are netcdf, csv, "),
        ("matlb", "no such format; MATLAB reads syre and simulink; there are netcdf, csv, "),
        ("xyz", "no such format; there are netcdf, csv, "),
    ],
)
def test_unknown_format_is_one_line_with_the_nearest(name: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=re.escape(f"export: {name}: {message}")):
        export_map(linear_map(), MOTOR, tmp_path, [name])
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"):
        export_map(linear_map(), MOTOR, tmp_path / "file", ["csv"])


def test_a_map_that_cannot_be_interpolated_leaves_no_files(tmp_path: Path) -> None:
    flux_map = linear_map()
    empty = flux_map.model_copy(update={"psi_d": np.full_like(flux_map.psi_d, np.nan)})
    with pytest.raises(InputError, match="psi_d"):
        export_map(empty, MOTOR, tmp_path)
    assert not list(tmp_path.iterdir())
