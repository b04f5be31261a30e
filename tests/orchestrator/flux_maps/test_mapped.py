from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from orchestrator.flux_maps import load_map, read_map
from protocols import InputError
from tests.orchestrator.flux_maps.exporting.machines import L_D, L_Q, PSI_M, linear_map
from tests.support.close import assert_close

ROOT2 = np.sqrt(2.0)
MAPPING = """\
format: fluxbench-map
version: 1
file: {file}
current: {{columns: {{d: {d}, q: {q}}}, unit: {ampere}, scaling: {scaling}}}
flux: {{columns: {{d: FD, q: FQ}}, unit: mVs, scaling: {scaling}}}
"""


def mapping(
    folder: Path, file: str, *, d: str = "ID", q: str = "IQ", ampere: str = "A", scaling: str = "rms", more: str = ""
) -> Path:
    path = folder / "map.yaml"
    path.write_text(MAPPING.format(file=file, d=d, q=q, ampere=ampere, scaling=scaling) + more)
    return path


def test_a_semicolon_table_in_milliamperes_rms_comes_as_peak_values_with_its_torque(tmp_path: Path) -> None:
    rows = [
        f"{d};{q};{1e3 * (PSI_M + L_D * d * ROOT2) / ROOT2};{1e3 * L_Q * q};{10 * d}".replace(".", ",")
        for d in (-2, 0, 2) for q in (-1, 0, 3)
    ]  # fmt: skip
    (tmp_path / "table.txt").write_text("\n".join(["made by hand", "ID;IQ;FD;FQ;Md [Nm]", *rows]))
    more = 'torque: {column: "Md [Nm]", unit: Nm, factor: -1}\ncsv: {delimiter: ";", decimal: ",", skip_rows: 1}\n'
    found = read_map(mapping(tmp_path, "table.txt", more=more))
    assert_close(found.flux_map.i_d, ROOT2 * np.array([-2.0, 0.0, 2.0]), 1e-12)
    assert_close(found.flux_map.psi_d[:, 0], PSI_M + L_D * found.flux_map.i_d, 1e-12)
    assert found.torque_nm is not None
    assert_close(found.torque_nm[:, 1], np.array([20.0, 0.0, -20.0]), 1e-12)


@pytest.mark.parametrize("kind", ["tables", "rows along d", "rows along q"])
def test_arrays_of_a_struct_over_axes_or_over_tables_are_one_map(tmp_path: Path, kind: str) -> None:
    m = linear_map(nodes=5)
    i_d, i_q = m.i_d, m.i_q[:4]
    content = {"FD": 1e3 * m.psi_d[:, :4], "FQ": 1e3 * m.psi_q[:, :4]}
    if kind == "rows along q":
        content = {name: table.T for name, table in content.items()}
    axes = np.meshgrid(i_d, i_q, indexing="ij") if kind == "tables" else [i_d, i_q]
    savemat(tmp_path / "m.mat", {"log": {"ID": axes[0], "IQ": axes[1]}, **content})
    found = load_map(mapping(tmp_path, "m.mat", d="log.ID", q="log.IQ", scaling="amplitude_invariant"))
    assert_close(found.psi_d, m.psi_d[:, :4], 1e-12)
    assert_close(found.l_qq, L_Q, 1e-6)


def test_reluctance_axes_are_turned(tmp_path: Path) -> None:
    m = linear_map(nodes=5)
    i_d, i_q = np.meshgrid(m.i_d, m.i_q, indexing="ij")
    np.savez(tmp_path / "sr.npz", ID=i_q, IQ=-i_d, FD=1e3 * m.psi_q, FQ=-1e3 * m.psi_d)
    path = mapping(tmp_path, "sr.npz", scaling="amplitude_invariant", more="magnet_axis: -q\n")
    assert_close(load_map(path).psi_d, m.psi_d, 1e-12)


def test_a_mapping_of_waveforms_names_the_command_that_reads_it(tmp_path: Path) -> None:
    (tmp_path / "log.yaml").write_text("format: fluxbench-import\nversion: 1\n")
    with pytest.raises(InputError, match="the mapping of waveforms, not of a flux map: `fluxbench import` reads it"):
        load_map(tmp_path / "log.yaml")


@pytest.mark.parametrize(
    ("file", "changes", "message"),
    [
        ("none.csv", {}, "file: no such file"),
        ("t.csv", {"d": "Id"}, "Id: no such column; valid: FD, FQ, ID, IQ"),
        ("t.csv", {"ampere": "amps"}, "map.yaml:4: current.unit"),
        ("t.csv", {"more": "torqe: 1\n"}, "torqe"),
        ("square.npz", {}, "dimensions: set axes: [d, q] or [q, d]"),
    ],
)
def test_a_wrong_mapping_is_one_line(tmp_path: Path, file: str, changes: dict[str, str], message: str) -> None:
    (tmp_path / "t.csv").write_text("ID,IQ,FD,FQ\n0,0,1,0\n")
    np.savez(tmp_path / "square.npz", ID=np.arange(3.0), IQ=np.arange(3.0), FD=np.eye(3), FQ=np.eye(3))
    with pytest.raises(InputError) as caught:
        load_map(mapping(tmp_path, file, **changes))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
