from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from orchestrator.estimation import save_flux_map
from orchestrator.flux_maps import load_map
from orchestrator.flux_maps.exporting import export_map
from protocols import FluxbenchError, InputError
from tests.orchestrator.flux_maps.exporting.machines import L_D, L_Q, MOTOR, linear_map, saturated_map
from tests.support.close import assert_close

ROWS = [f"{d},{q},{0.3 + L_D * d:.9g},{L_Q * q:.9g}" for d in (-2, 0, 1) for q in (-1, 0, 3)]


def write(folder: Path, text: str) -> Path:
    path = folder / "map.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_rows_in_any_order_make_the_same_grid(tmp_path: Path) -> None:
    header = "i_q_A,i_d_A,psi_d_Vs,psi_q_Vs\n"
    rows = [",".join((q, d, f, g)) for d, q, f, g in (row.split(",") for row in ROWS)]
    found = load_map(write(tmp_path, "# a comment\n" + header + "\n".join(reversed(rows)) + "\n"))
    np.testing.assert_array_equal(found.i_d, [-2.0, 0.0, 1.0])
    np.testing.assert_array_equal(found.i_q, [-1.0, 0.0, 3.0])
    np.testing.assert_allclose(found.psi_d, np.broadcast_to(0.3 + L_D * found.i_d[:, None], (3, 3)))


def test_missing_inductances_are_derivatives_and_missing_deviations_are_nan(tmp_path: Path) -> None:
    found = load_map(write(tmp_path, "i_d_a,i_q_a,psi_d_wb,psi_q_wb\n" + "\n".join(ROWS)))
    np.testing.assert_allclose(found.l_dd, L_D, rtol=1e-7)
    np.testing.assert_allclose(found.l_qq, L_Q, rtol=1e-7)
    assert_close(found.l_dq, np.zeros_like(found.l_dq), 1e-8, of=L_Q)
    assert np.isnan(found.psi_d_std).all()


def test_derivatives_of_a_saturated_map_are_its_inductances(tmp_path: Path) -> None:
    exact = saturated_map()
    export_map(exact, MOTOR, tmp_path, ["csv"])
    kept = [line.split(",")[:4] for line in (tmp_path / "flux_map.csv").read_text().splitlines()]
    found = load_map(write(tmp_path, "\n".join(",".join(row) for row in kept)))
    d, q = np.meshgrid(exact.i_d, exact.i_q, indexing="ij")
    inner = np.hypot(d, q) < 2.5
    for name in ("l_dd", "l_dq", "l_qq"):
        np.testing.assert_allclose(getattr(found, name)[inner], getattr(exact, name)[inner], atol=2e-4, err_msg=name)
        np.testing.assert_array_equal(np.isnan(getattr(found, name)), np.isnan(exact.psi_d))


def test_a_missing_point_is_a_hole(tmp_path: Path) -> None:
    found = load_map(write(tmp_path, "i_d_a,i_q_a,psi_d_wb,psi_q_wb\n" + "\n".join(ROWS[1:])))
    assert np.isnan(found.psi_d[0, 0])
    assert np.isnan(found.psi_d).sum() == 1


def test_syres_reluctance_axes_are_turned_to_pm_axes(tmp_path: Path) -> None:
    """With the magnet on -q: i_d = -Iq, i_q = Id, and the fluxes alike."""
    pm = linear_map()
    i_d, i_q = np.meshgrid(pm.i_d, pm.i_q)
    layout = {"Id": i_q, "Iq": -i_d, "Fd": pm.psi_q.T, "Fq": -pm.psi_d.T}
    path = tmp_path / "motor.mat"
    savemat(path, {"motorModel": {"FluxMap_dq": layout, "data": {"axisType": "SR"}}})
    found = load_map(path)
    np.testing.assert_allclose(found.i_d, pm.i_d)
    np.testing.assert_allclose(found.psi_d, pm.psi_d)
    np.testing.assert_allclose(found.psi_q, pm.psi_q)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "map.csv: i_d_a: no such column; the file has none"),
        ("i_d_a,i_q_a,psi_d_wb\n1,2,3\n", "map.csv: psi_q_wb: no such column"),
        ("i_d_a,i_q_a,psi_d_wb,psi_q_wb\n1,2,3\n", "map.csv: psi_q_wb: row 1: expected a number, got nothing"),
        ("i_d_a,i_q_a,psi_d_wb,psi_q_wb\n1,2,3,x\n", "map.csv: psi_q_wb: row 1: expected a number, got 'x'"),
        ("i_d_a,i_q_a,psi_d_wb,psi_q_wb\n", "map.csv: i_d, i_q: 0 points: too few for a flux map"),
        ("i_d_a,i_q_a,psi_d_wb,psi_q_wb\n,2,3,4\n", "map.csv: i_d, i_q: a current is not finite"),
        (
            "i_d_a,i_q_a,psi_d_wb,psi_q_wb\n" + "\n".join(f"{k},{k * k},1,1" for k in range(30)),
            "map.csv: i_d, i_q: 30 points that do not lie on a rectangular grid",
        ),
        (
            "i_d_a,i_q_a,psi_d_wb,psi_q_wb\n" + "\n".join([*ROWS, ROWS[0]]),
            "map.csv: i_d, i_q: a current occurs twice",
        ),
    ],
)
def test_a_csv_that_is_no_map_is_one_line_that_names_the_column(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        load_map(write(tmp_path, text))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("missing.csv", "missing.csv: no such file"),
        ("missing.xlsx", "expected a run, a recording, or a .nc, .csv, .npz, .mat, .json or .yaml file"),
        ("missing", "no such directory; expected the directory of a run or recording"),
        (".", "a folder of runs, not a run"),
        ("run", "results/flux_map.nc: no such file; `fluxbench estimate "),
        ("run/run.json", "is a file of the run or recording"),
    ],
)
def test_what_is_not_there_is_stated(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    with pytest.raises(FluxbenchError) as caught:
        load_map(tmp_path / name)
    assert message in str(caught.value)


def test_arrays_of_the_wrong_kind_are_named(tmp_path: Path) -> None:
    np.savez(tmp_path / "real.npz", i_s_dq=np.zeros(4), psi_s_dq=np.zeros(4))
    with pytest.raises(InputError, match="i_s_dq: expected a complex array"):
        load_map(tmp_path / "real.npz")
    np.savez(tmp_path / "sizes.npz", i_s_dq=np.zeros(4, complex), psi_s_dq=np.zeros(5, complex))
    with pytest.raises(InputError, match="arrays of different sizes"):
        load_map(tmp_path / "sizes.npz")
    np.save(tmp_path / "array.npy", np.zeros(3))
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    with pytest.raises(InputError, match=r"not an \.npz file"):
        load_map(tmp_path / "array.npz")
    savemat(tmp_path / "other.mat", {"Id": np.eye(3)})
    with pytest.raises(InputError, match="Iq: no such array"):
        load_map(tmp_path / "other.mat")


def test_a_netcdf_file_that_the_library_gives_up_on_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def give_up(path: Path) -> None:
        raise RuntimeError("Link iteration failed\nwith a second line")

    (tmp_path / "map.nc").write_bytes(b"")
    monkeypatch.setattr("orchestrator.flux_maps._loading.load_flux_map", give_up)
    with pytest.raises(InputError, match=r"map\.nc: not a readable NetCDF file: Link iteration failed$"):
        load_map(tmp_path / "map.nc")


def test_a_pickle_is_never_opened(tmp_path: Path) -> None:
    np.savez(tmp_path / "pickled.npz", i_s_dq=np.array([object()], dtype=object), psi_s_dq=np.zeros(1, complex))
    with pytest.raises(InputError, match=r"not an \.npz file of plain arrays"):
        load_map(tmp_path / "pickled.npz")


def test_simulinks_tables_of_another_shape_get_one_line(tmp_path: Path) -> None:
    tables = {"id_index": [-1.0, 0.0, 1.0], "iq_index": [0.0, 1.0], "lambda_d": np.eye(3, 2), "lambda_q": np.eye(2, 3)}
    savemat(tmp_path / "turned.mat", tables)
    with pytest.raises(
        InputError, match=r"turned\.mat: lambda_q: of shape \(2, 3\), expected \(3, 2\): rows along id_index"
    ):
        load_map(tmp_path / "turned.mat")
    savemat(tmp_path / "lacking.mat", {"lambda_d": np.eye(3)})
    with pytest.raises(InputError, match=r"lacking\.mat: id_index: no such array; it goes with lambda_d"):
        load_map(tmp_path / "lacking.mat")


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A file of each kind, by suffix."""
    report = export_map(linear_map(nodes=5), MOTOR, tmp_path_factory.mktemp("good"), ["csv", "npz", "syre"])
    return {file.path.suffix: file.path for file in report.files}


def survives(suffix: str, content: bytes) -> None:
    """Loads, or refuses with one line."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"map{suffix}"
        path.write_bytes(content)
        message = ""
        try:
            load_map(path)
        except InputError as error:
            message = str(error)
    assert "\n" not in message


@given(suffix=st.sampled_from([".csv", ".npz", ".mat"]), content=st.binary(max_size=300))
def test_any_bytes_are_a_map_or_one_line(suffix: str, content: bytes) -> None:
    survives(suffix, content)


@given(
    suffix=st.sampled_from([".csv", ".npz", ".mat"]),
    cut=st.floats(0.0, 1.0),
    at=st.floats(0.0, 1.0),
    byte=st.integers(0, 255),
)
def test_a_damaged_file_is_a_map_or_one_line(
    good: dict[str, Path], suffix: str, cut: float, at: float, byte: int
) -> None:
    whole = good[suffix].read_bytes()
    content = bytearray(whole)
    content[int(at * (len(content) - 1))] = byte
    survives(suffix, bytes(content))
    survives(suffix, whole[: int(cut * len(whole))])


@pytest.mark.parametrize("ending", [".npz", ".mat", ".nc"])
def test_tables_larger_than_the_memory_are_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    path = tmp_path / f"map{ending}"
    axis = np.linspace(-1.0, 1.0, 21)
    i_d, i_q = np.meshgrid(axis, axis, indexing="ij")
    if ending == ".npz":
        np.savez_compressed(path, i_s_dq=i_d + 1j * i_q, psi_s_dq=0.3 + L_D * i_d + 1j * L_Q * i_q)
    elif ending == ".mat":
        savemat(path, {"Id": i_d, "Iq": i_q, "Fd": 0.3 + L_D * i_d, "Fq": L_Q * i_q}, do_compression=True)
    else:
        save_flux_map(path, linear_map())
    load_map(path)
    monkeypatch.setattr("orchestrator.validation.memory.spare_memory", lambda: 10_000)
    with pytest.raises(InputError, match=f"map{ending}: its (arrays|variables|tables) need some 0.0 GB of memory"):
        load_map(path)
