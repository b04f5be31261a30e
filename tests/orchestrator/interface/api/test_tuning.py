"""A drive is tuned from Python and from the command line, or nothing is written."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.estimation import save_flux_map
from orchestrator.interface import api
from orchestrator.interface.api.exporting import winding_c
from orchestrator.runs import RunDirectory
from protocols import FluxMap, InputError, Motor
from tests.orchestrator.tuning.machines import flux_map, saturated
from tests.plugins.streams.example_run import CAPABILITIES, a_procedure
from tests.support.processes import called

MOTOR = Motor(
    name="Test motor 1", pole_pairs=2, rated_current_rms_a=2.0, rated_speed_rpm=3000.0, stator_resistance_ohm=1.0
)
DRIVE: dict[str, Any] = {"bus_v": 300.0, "sampling_hz": 10e3}


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "map.nc"
    save_flux_map(path, flux_map(saturated(), 4.0, std=0.005))
    return path


@pytest.mark.usefixtures("undrawn")
def test_a_map_file_gives_references_gains_code_and_a_picture(map_file: Path, tmp_path: Path) -> None:
    report = api.tune(map_file, motor=MOTOR, out=tmp_path / "out", **DRIVE)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == set(report.files)
    assert {"test_motor_1_drive.h", "test_motor_1_drive.c", "references.csv", "tuning.svg"} < written
    assert report.least_phase_margin_deg == pytest.approx(60.0, abs=1e-3)
    assert report.torque_at_largest_speed_nm <= report.largest_torque_nm
    again = json.loads((tmp_path / "out" / "tuning.json").read_text())
    assert again["largest_torque_nm"] == pytest.approx(report.largest_torque_nm)
    rows = np.genfromtxt(tmp_path / "out" / "references.csv", delimiter=",", names=True)
    assert float(np.hypot(rows["i_d_a"], rows["i_q_a"]).max()) <= 2.0 * np.sqrt(2.0) * (1.0 + 1e-6)


@pytest.mark.slow
def test_by_default_the_files_are_beside_the_map(map_file: Path) -> None:
    api.tune(map_file, motor=MOTOR, **DRIVE)
    assert (map_file.parent / "tuning" / "tuning.json").is_file()


@pytest.mark.parametrize(
    ("motor", "given", "message"),
    [
        (None, DRIVE, "a map file has no motor"),
        (MOTOR.model_copy(update={"stator_resistance_ohm": None}), DRIVE, "R_s is unknown"),
        (MOTOR, {"sampling_hz": 10e3}, "--bus-v"),
        (MOTOR, {**DRIVE, "current_a": 40.0}, "beyond the map"),
        (MOTOR, {**DRIVE, "bus_v": 2.0}, "R_s alone takes"),
    ],
)
def test_what_does_not_suffice_is_one_line_and_nothing_is_written(
    motor: Motor | None, given: dict[str, Any], message: str, map_file: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        api.tune(map_file, motor=motor, out=tmp_path / "out", **given)
    assert not (tmp_path / "out").exists()


def test_all_that_is_missing_is_named_at_once(map_file: Path, tmp_path: Path) -> None:
    motor = Motor(name="unknown", pole_pairs=1)
    with pytest.raises(InputError, match=r"(?s)R_s is unknown.*--bus-v.*--sampling-hz.*--speed-rpm"):
        api.tune(map_file, motor=motor, out=tmp_path / "out")


def test_a_locked_rotor_s_map_is_not_tuned_without_its_magnet(tmp_path: Path) -> None:
    save_flux_map(tmp_path / "map.nc", flux_map(saturated(pm_flux_wb=0.0), 4.0, std=0.005))
    with pytest.raises(InputError, match=r"pm_flux_wb: unknown.*pole_pairs"):
        api.tune(tmp_path / "map.nc", motor=MOTOR, out=tmp_path / "out", **DRIVE)
    assert not (tmp_path / "out").exists()


def test_a_map_that_its_audit_refuses_is_not_tuned(tmp_path: Path) -> None:
    made = flux_map(saturated(), 4.0)
    # A psi_d that has been read with the wrong sign of i_d.
    wrong = FluxMap(**{**made.model_dump(), "psi_d": made.psi_d[::-1].copy()})
    save_flux_map(tmp_path / "wrong.nc", wrong)
    with pytest.raises(InputError, match="fluxbench audit"):
        api.tune(tmp_path / "wrong.nc", motor=MOTOR, out=tmp_path / "out", **DRIVE)
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("undrawn")
def test_a_run_is_tuned_with_its_own_drive_and_resistance_unless_its_map_is_not_usable(
    run: Path, tmp_path: Path
) -> None:
    run = shutil.copytree(run, tmp_path / "run")
    report = api.tune(run)
    assert "not_diagnosed" in [remark.code for remark in report.remarks]
    assert report.bus_v == pytest.approx(api.open(run).manifest.drive.dc_bus_voltage_v)
    assert (run / "tuning" / "tuning.json").is_file()
    path = run / "results" / "estimates.json"
    estimates = json.loads(path.read_text())
    estimates["usable"] = False
    estimates["checks"][0]["outcome"] = "failed"
    path.write_text(json.dumps(estimates))
    with pytest.raises(InputError, match=r"not usable: .*; `fluxbench diagnose .*` looks for the cause"):
        api.tune(run, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("undrawn")
def test_the_command_prints_the_main_figures(map_file: Path, tmp_path: Path) -> None:
    (tmp_path / "motor.yaml").write_text(json.dumps({"motor": MOTOR.model_dump(exclude_none=True)}))
    words: list[str | Path] = [
        "tune",
        map_file,
        "--motor",
        tmp_path / "motor.yaml",
        "--bus-v",
        "300",
        "--sampling-hz",
        "10000",
    ]
    done = called(*words)
    assert done.returncode == 0
    for figure in (
        "largest torque",
        "phase margin at least 60°",
        "sensorless by injection",
        "sensorless by back-EMF",
        "test_motor_1_drive.c",
    ):
        assert figure in done.stdout
    refused = called(*words, "--current-a", "99")
    assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)
    assert "beyond the map" in refused.stderr


def test_resistance_holds_at_the_room_s_temperature_of_the_run_where_it_is_known(tmp_path: Path) -> None:
    plain = a_procedure("motor")
    warm = plain.model_copy(update={"about": plain.about.model_copy(update={"ambient_c": 35.0})})
    for name, procedure, expected in (("plain", plain, None), ("warm", warm, 35.0)):
        RunDirectory.create(tmp_path / name, procedure, CAPABILITIES)
        assert winding_c(tmp_path / name) == expected
    assert winding_c(tmp_path / "map.nc") is None


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_magnet_s_coefficient_makes_its_temperature_an_argument_of_the_code(map_file: Path, tmp_path: Path) -> None:
    magnet = MOTOR.model_copy(update={"pm_flux_wb": 0.3})
    api.tune(map_file, motor=magnet, magnet_percent_per_k=-0.11, out=tmp_path / "with", **DRIVE)
    for name, function in (("drive", "torque_reference_nm"), ("drive_int32", "torque_reference_unm")):
        assert function in (tmp_path / "with" / f"test_motor_1_{name}.h").read_text()
    for motor, percent, message in ((magnet, -110.0, "expected 1 %/K at most"), (MOTOR, -0.11, "pm_flux_wb: unknown")):
        with pytest.raises(InputError, match=message):
            api.tune(map_file, motor=motor, magnet_percent_per_k=percent, out=tmp_path / "none", **DRIVE)
    assert not (tmp_path / "none").exists()
