"""Flux maps survive their file; files that are none are named."""

from __future__ import annotations

import gc
from pathlib import Path

import numpy as np
import pytest

from orchestrator.estimation import flux_dataset, load_flux_map, save_flux_map
from protocols import Basis, FluxMap, RecordingError, StorageError
from tests.orchestrator.analysis.test_checks import exact_map
from tests.support.cases import few


def test_a_map_survives_the_file(tmp_path: Path) -> None:
    import xarray as xr

    flux_map = exact_map("injection").model_copy(update={"basis": Basis.INJECTION})
    save_flux_map(tmp_path / "flux_map.nc", flux_map, motor="m", recording="r")
    back = load_flux_map(tmp_path / "flux_map.nc")
    for name in FluxMap.model_fields:
        np.testing.assert_array_equal(getattr(back, name), getattr(flux_map, name))
    with xr.open_dataset(tmp_path / "flux_map.nc", engine="h5netcdf") as dataset:
        assert dataset.attrs["method"] == "injection"
        assert dataset.attrs["motor"] == "m"
        assert dataset["psi_d"].attrs["units"] == "Wb"
        assert dataset["l_dq_std"].dims == ("i_d", "i_q")
        assert float(dataset["psi_d"].interp(i_d=0.0, i_q=0.0)) == pytest.approx(0.3)
    assert [path.name for path in tmp_path.iterdir()] == ["flux_map.nc"]


def test_a_written_map_is_the_dataset_of_the_map(tmp_path: Path) -> None:
    import xarray as xr

    flux_map = exact_map("injection").model_copy(update={"basis": Basis.INJECTION})
    save_flux_map(tmp_path / "flux_map.nc", flux_map, motor="m", recording="r")
    with xr.open_dataset(tmp_path / "flux_map.nc", engine="h5netcdf") as dataset:
        xr.testing.assert_identical(dataset.load(), flux_dataset(flux_map, motor="m", recording="r"))


def test_packed_and_transposed_tables_are_read_as_they_are_meant(tmp_path: Path) -> None:
    flux_map = exact_map()
    psi_d = np.array(flux_map.psi_d)
    psi_d[0, 0] = np.nan
    dataset = flux_dataset(flux_map.model_copy(update={"psi_d": psi_d}))
    packing = {"dtype": "int32", "scale_factor": 1e-9, "add_offset": 0.25, "_FillValue": -(2**31)}
    dataset["psi_q"] = dataset["psi_q"].transpose("i_q", "i_d")
    dataset.to_netcdf(tmp_path / "packed.nc", engine="h5netcdf", encoding={"psi_d": packing})
    back = load_flux_map(tmp_path / "packed.nc")
    np.testing.assert_allclose(back.psi_d, psi_d, rtol=0.0, atol=1e-9)
    np.testing.assert_array_equal(back.psi_q, flux_map.psi_q)


def test_bad_map_files_are_named(tmp_path: Path) -> None:
    import xarray as xr

    with pytest.raises(RecordingError, match=r"missing\.nc: no such file"):
        load_flux_map(tmp_path / "missing.nc")
    (tmp_path / "text.nc").write_text("not a map")
    with pytest.raises(RecordingError, match=r"text\.nc: not a readable NetCDF file"):
        load_flux_map(tmp_path / "text.nc")
    xr.Dataset(coords={"i_d": [0.0, 1.0], "i_q": [0.0, 1.0]}).to_netcdf(tmp_path / "empty.nc", engine="h5netcdf")
    with pytest.raises(RecordingError, match="psi_d"):
        load_flux_map(tmp_path / "empty.nc")


def test_inductances_that_are_not_there_are_the_slopes_of_the_flux(tmp_path: Path) -> None:
    import xarray as xr

    flux_map = exact_map()
    save_flux_map(tmp_path / "whole.nc", flux_map)
    with xr.open_dataset(tmp_path / "whole.nc", engine="h5netcdf") as dataset:
        dataset.load()[["psi_d", "psi_q"]].to_netcdf(tmp_path / "flux.nc", engine="h5netcdf")
    bare = load_flux_map(tmp_path / "flux.nc")
    for name in ("l_dd", "l_dq", "l_qq"):
        inside = getattr(bare, name)[1:-1, 1:-1] - getattr(flux_map, name)[1:-1, 1:-1]
        assert np.nanmax(np.abs(inside)) < 0.02 * np.nanmax(flux_map.l_qq)
    assert np.isnan(bare.l_dd_std).all()


def test_map_files_that_are_cut_off_or_wrong_inside_are_named(tmp_path: Path) -> None:
    import xarray as xr

    save_flux_map(tmp_path / "whole.nc", exact_map())
    content = (tmp_path / "whole.nc").read_bytes()
    random = np.random.default_rng(1)
    for k in range(12):
        broken = bytearray(content[: len(content) * (k + 1) // 13])
        for at in random.integers(0, len(broken), 20):
            broken[at] ^= 0xFF
        (tmp_path / "broken.nc").write_bytes(bytes(broken))
        with pytest.raises(RecordingError, match=r"^[^\n]*broken\.nc: not a readable[^\n]*$"):
            load_flux_map(tmp_path / "broken.nc")
    grid = (("i_d", "i_q"), np.zeros((2, 2)))
    falling = {"i_d": [1.0, 0.0], "i_q": [0.0, 1.0]}
    xr.Dataset({"psi_d": grid, "psi_q": grid}, falling).to_netcdf(tmp_path / "falling.nc", engine="h5netcdf")
    with pytest.raises(RecordingError, match=r"falling\.nc: i_d: expected a coordinate"):
        load_flux_map(tmp_path / "falling.nc")
    words = (("i_d", "i_q"), np.array([["a", "b"], ["c", "d"]]))
    rising = {"i_d": [0.0, 1.0], "i_q": [0.0, 1.0]}
    xr.Dataset({"psi_d": grid, "psi_q": words}, rising).to_netcdf(tmp_path / "words.nc", engine="h5netcdf")
    with pytest.raises(RecordingError, match="psi_q: expected numbers"):
        load_flux_map(tmp_path / "words.nc")


@few("place", range(120, 360, 40), fast=2)
def test_a_damaged_head_of_a_map_file_is_named_and_nothing_else_is_printed(place: int, tmp_path: Path) -> None:
    path = tmp_path / "map.nc"
    save_flux_map(path, exact_map())
    content = bytearray(path.read_bytes())
    content[place : place + 8] = bytes(255 - b for b in content[place : place + 8])
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"map\.nc: not a readable NetCDF file"):
        load_flux_map(path)
    gc.collect()  # what a destructor raises fails the test as well


def test_a_folder_that_is_not_there_is_a_storage_error(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="cannot be written"):
        save_flux_map(tmp_path / "nowhere" / "flux_map.nc", exact_map())
