from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orchestrator.analysis import check_map, difference_percent, rated_flux_wb
from orchestrator.estimation import load_flux_map, save_flux_map
from protocols import FluxMap, RecordingError, StorageError
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


def test_a_map_survives_the_file(tmp_path: Path) -> None:
    import xarray as xr

    flux_map = exact_map("injection")
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


def test_a_folder_that_is_not_there_is_a_storage_error(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="cannot be written"):
        save_flux_map(tmp_path / "nowhere" / "flux_map.nc", exact_map())
