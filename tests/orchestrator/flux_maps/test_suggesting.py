"""`audit` of a file with names of its own prints a mapping, and that mapping reads the map that is in the file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from orchestrator.flux_maps import UnknownLayoutError, load_map, read_map, suggest_mapping
from orchestrator.interface.cli._running import run_app
from orchestrator.numerics.types import Array
from protocols import InputError
from tests.orchestrator.flux_maps.test_shapes import EXACT, INTERPOLATED, Machine, error_of, over_axes

MACHINE = Machine(magnet_wb=0.1, d_h=1e-3, q_h=2e-3, knee_a=15.0, reach_a=12.0, nodes=9)
AXIS = MACHINE.axis
FLUX = over_axes(MACHINE)
CURRENTS = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1)


def table(path: Path, head: str, rows: Array, delimiter: str = ",") -> Path:
    lines = (delimiter.join(f"{x:.12g}" for x in row) for row in rows)
    path.write_text(head + "\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def rows() -> Array:
    return np.column_stack((CURRENTS.reshape(-1, 2), FLUX[0].ravel(), FLUX[1].ravel()))


def square_axes(folder: Path) -> Path:
    savemat(folder / "m.mat", {"idVec": AXIS, "iqVec": AXIS, "fluxD": FLUX[0].T, "fluxQ": FLUX[1].T})
    return folder / "m.mat"


def rotor_angles(folder: Path) -> Path:
    angles = np.arange(0.0, 61.0, 7.5)
    d, q = (flux[..., None] + 1e-3 * np.cos(np.radians(6 * angles)) for flux in FLUX)
    savemat(folder / "m.mat", {"FEM": {"id": AXIS, "iq": AXIS, "angleVec": angles, "psid": d, "psiq": q}})
    return folder / "m.mat"


def motor_cad(folder: Path) -> Path:
    """Amplitude and phase advance, counted from q to -d."""
    amplitude, advance = np.meshgrid(np.linspace(0.0, 12.0, 9), np.arange(-180.0, 181.0, 15.0), indexing="ij")
    beta = np.radians(advance + 90.0)
    flux = MACHINE.psi(amplitude[..., None] * np.stack((np.cos(beta), np.sin(beta)), axis=-1))
    content = {"Stator_Current_Line_Peak": amplitude, "Phase_Advance": advance, "Flux_Linkage_D": flux[..., 0]}
    savemat(folder / "m.mat", content | {"Flux_Linkage_Q": flux[..., 1]})
    return folder / "m.mat"


def inverse(folder: Path) -> Path:
    fluxes = np.stack(
        np.meshgrid(np.linspace(0.092, 0.108, 21), np.linspace(-0.016, 0.016, 21), indexing="ij"), axis=-1
    )
    x = (fluxes - [0.1, 0.0]) / [1e-3, 2e-3]
    ratio = x**2 @ np.array([1e-3, 2e-3]) / (2e-3 * 15.0**2)
    i = x / np.sqrt(1.0 - ratio)[..., None]
    np.savez(
        folder / "m.npz",
        flux_d=fluxes[:, 0, 0], flux_q=fluxes[0, :, 1], i_d_table=i[..., 0], i_q_table=i[..., 1],
    )  # fmt: skip
    return folder / "m.npz"


def effective_values(folder: Path) -> Path:
    scaled = rows() / np.sqrt(2.0)
    return table(folder / "m.txt", "Id_RMS;Iq_RMS;psiD_RMS [mWb];psiQ_RMS [mWb]", scaled * [1, 1, 1e3, 1e3], ";")


def peak_beside_effective_values(folder: Path) -> Path:
    both = np.column_stack((rows() / np.sqrt(2.0), rows()))
    return table(folder / "m.csv", "Id_RMS,Iq_RMS,psiD_RMS,psiQ_RMS,Id_Pk,Iq_Pk,psiD_Pk,psiQ_Pk", both)


def milliamperes(folder: Path) -> Path:
    names = ("current_d", "current_q", "lambda_d_mVs", "lambda_q_mVs")
    pq.write_table(pa.table(dict(zip(names, 1e3 * rows().T, strict=True))), folder / "m.parquet")
    return folder / "m.parquet"


@pytest.mark.parametrize(
    ("write", "expected"),
    [
        (square_axes, EXACT),
        (rotor_angles, EXACT),
        (motor_cad, INTERPOLATED),
        (inverse, INTERPOLATED),
        (effective_values, 1e-8),
        (peak_beside_effective_values, 1e-8),
        (milliamperes, EXACT),
    ],
)
def test_the_mapping_that_is_printed_reads_the_map(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], write: Callable[[Path], Path], expected: float
) -> None:
    path = write(tmp_path)
    assert run_app(["audit", str(path)]) == 2
    printed = capsys.readouterr()
    assert f"then: fluxbench audit {path.stem}.yaml" in printed.err
    mapping = path.with_suffix(".yaml")
    mapping.write_text(printed.out)
    assert error_of(MACHINE, load_map(mapping)) < expected
    assert run_app(["audit", str(mapping)]) == 0
    assert "no fault found" in capsys.readouterr().out


def test_each_line_has_a_reason_and_units_that_no_name_has_are_doubted(tmp_path: Path) -> None:
    suggestion = suggest_mapping(square_axes(tmp_path))
    assert all("#" in line for line in suggestion.text.splitlines())
    assert "axes: [q, d]  # of one length" in suggestion.text
    assert "current: up to 12, as A: the file names no unit" in suggestion.doubts
    assert not [doubt for doubt in suggest_mapping(effective_values(tmp_path)).doubts if doubt.startswith("flux")]


def test_as_json_the_mapping_is_a_text_of_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_app(["audit", str(square_axes(tmp_path)), "--json"]) == 2
    document = json.loads(capsys.readouterr().out)
    assert document["mapping"].startswith("format: fluxbench-map")
    assert document["doubts"]


def test_a_constant_flux_leaves_the_dimensions_to_the_reader(tmp_path: Path) -> None:
    np.savez(tmp_path / "m.npz", i_d=AXIS, i_q=AXIS, psi_d=np.ones((9, 9)), psi_q=np.ones((9, 9)))
    suggestion = suggest_mapping(tmp_path / "m.npz")
    assert "axes: [d, q]  # a guess" in suggestion.text
    assert any("set axes: [d, q] or [q, d]" in doubt for doubt in suggestion.doubts)


@pytest.mark.parametrize(
    ("head", "lacking"),
    [("i_d,i_q,l_d,l_q", "flux linkages"), ("psi_d,psi_q,v_d,v_q", "currents"), ("a,b,c,d", "flux linkages")],
)
def test_names_that_tell_nothing_are_listed(tmp_path: Path, head: str, lacking: str) -> None:
    path = table(tmp_path / "m.csv", head, rows())
    with pytest.raises(InputError, match=f"the names do not show which columns are the {lacking}") as caught:
        suggest_mapping(path)
    assert list(caught.value.choices) == head.split(",")


def test_other_commands_name_audit_for_a_layout_of_its_own(tmp_path: Path) -> None:
    for path in (square_axes(tmp_path), effective_values(tmp_path), peak_beside_effective_values(tmp_path)):
        with pytest.raises(UnknownLayoutError, match="`fluxbench audit` of it prints a mapping"):
            read_map(path)
