"""What a simulator would read out of the tables is looked up here by their own rules."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from orchestrator.flux_maps import MapSurface
from orchestrator.flux_maps.exporting import export_map
from protocols import Motor
from tests.orchestrator.flux_maps.exporting.machines import MOTOR, Array, saturated_map
from tests.support.cases import few
from tests.support.close import assert_close

CURRENTS = np.array([[0.4, -1.1], [-1.9, 0.7], [1.2, 2.1], [0.0, 0.0]])
NUMBER = r"-?\d+\.?\d*(?:e-?\d+)?"


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    export_map(saturated_map(), MOTOR, folder, ["modelica", "plecs", "ltspice"], recording="bench-7")
    return folder


def truth() -> Array:
    return MapSurface(saturated_map()).psi(CURRENTS)


def test_modelica_s_matrices_have_their_axes_in_the_first_row_and_column(exported: Path) -> None:
    lines = (exported / "flux_map_modelica.txt").read_text().splitlines()
    assert lines[0] == "#1"
    for column, name in enumerate(("psi_d", "psi_q")):
        start = next(k for k, line in enumerate(lines) if line.startswith(f"double {name}("))
        rows, columns = map(int, re.findall(r"\d+", lines[start].split("(")[1]))
        matrix = np.array([[float(word) for word in line.split()] for line in lines[start + 1 : start + 1 + rows]])
        assert matrix.shape == (rows, columns)
        lookup = RegularGridInterpolator((matrix[1:, 0], matrix[0, 1:]), matrix[1:, 1:])
        assert_close(lookup(CURRENTS), truth()[:, column], 0.01)


def test_plecs_gets_axes_and_tables_of_one_struct(exported: Path) -> None:
    text = (exported / "flux_map_plecs.m").read_text()

    def numbers(name: str) -> Array:
        found = re.search(rf"^pm400\.{name} = \[(.*?)\];", text, flags=re.DOTALL | re.MULTILINE)
        assert found is not None, name
        rows = re.sub("%.*", "", found[1]).split(";")
        return np.array([[float(word) for word in row.split()] for row in rows if row.split()])

    axes = numbers("flux_d")[0], numbers("flux_q")[0]
    for column, name in enumerate(("i_d_table", "i_q_table")):
        assert_close(RegularGridInterpolator(axes, numbers(name))(truth()), CURRENTS[:, column], 0.01)
    assert "pm400.R_s = 4.25;" in text


@pytest.mark.slow
def test_ltspice_s_sums_of_hats_are_bilinear_tables(exported: Path) -> None:
    text = (exported / "flux_map_ltspice.lib").read_text().replace("\n+ ", "")
    assert ".subckt pm400_dq vd vq we id iq te" in text
    for column, name in enumerate(("id", "iq")):
        (source,) = re.findall(rf"^B{name} {name} 0 V=(.*)$", text, flags=re.MULTILINE)
        total = np.zeros(len(CURRENTS))
        for hat, along in re.findall(r"table\(V\(psiq\),([^)]*)\)\*table\(V\(psid\),([^)]*)\)", source):
            across, d = (
                np.array([float(x) for x in re.findall(NUMBER, words)]).reshape(-1, 2) for words in (hat, along)
            )
            total += np.interp(truth()[:, 1], *across.T) * np.interp(truth()[:, 0], *d.T)
        assert_close(total, CURRENTS[:, column], 0.02)


@pytest.mark.slow
def test_every_file_names_the_recording(tmp_path: Path) -> None:
    report = export_map(saturated_map(nodes=9), MOTOR, tmp_path, recording="bench-7 of tuesday")
    for file in report.files:
        content = file.path.read_bytes()
        if file.path.suffix in (".h", ".txt", ".m", ".lib", ".csv"):
            assert b"bench-7 of tuesday" in content, file.path.name
    with np.load(tmp_path / "flux_map.npz") as held:
        assert str(held["recording"]) == "bench-7 of tuesday"


@few("name, symbol", [("400 W test", "motor_400_w_test"), ("AM8141-0J00 Ω", "am8141_0j00"), ("电机", "motor")])
def test_names_in_c_are_the_motor_s(tmp_path: Path, name: str, symbol: str) -> None:
    motor = Motor(name=name, pole_pairs=2, pm_flux_wb=0.3, stator_resistance_ohm=4.25)
    export_map(saturated_map(nodes=9), motor, tmp_path, ["c"])
    text = (tmp_path / "flux_map.h").read_text()
    assert f"static inline float {symbol}_psi_d(" in text
    assert f"#define {symbol.upper()}_R_S_OHM (4.25f)" in text
    assert f"#define {symbol.upper()}_PSI_M_WB (0.3" in text
