"""A map goes out from Python as it does from the command line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from orchestrator.interface import api
from orchestrator.interface.cli._running import run_app
from protocols import CheckOutcome, InputError, Motor, Remark, UsabilityCheck
from tests.support.cases import few
from tests.support.tiny import run_tiny

FORMATS = ("csv", "npz", "netcdf", "c")


def test_a_run_s_map_is_written_with_the_resistance_that_was_measured(run: Path, tmp_path: Path) -> None:
    report = api.export(run, "csv", out=tmp_path / "out")
    assert [file.format for file in report.files] == ["csv"]
    assert list((tmp_path / "out").iterdir())


def test_a_map_file_takes_the_motor_that_is_named(run: Path, tmp_path: Path) -> None:
    (map_file,) = (run / "results").glob("flux_map.nc")
    with pytest.raises(InputError, match="a map file has no motor"):
        api.export(map_file, "csv", out=tmp_path / "none")
    motor = Motor(name="mine", pole_pairs=2)
    assert api.export(map_file, "csv", motor=motor, out=tmp_path / "out").files


@few(
    "outcomes, caution",
    [
        ((CheckOutcome.NOT_POSSIBLE, CheckOutcome.FAILED), "the map is not usable: "),
        (
            (CheckOutcome.NOT_POSSIBLE,),
            "the map is not judged: `fluxbench diagnose {run}` decides whether it is usable",
        ),
        ((), ""),
    ],
)
def test_a_map_that_is_not_to_be_relied_on_says_so_in_the_files_and_on_standard_error(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], outcomes: tuple[CheckOutcome, ...], caution: str
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    file = copy / "results" / "estimates.json"
    estimates = json.loads(file.read_text(encoding="utf-8"))
    remark = Remark(code="parity", text="psi_d is not even in i_q")
    unmet = [
        UsabilityCheck(name="parity", outcome=outcome, required=True, remark=remark).model_dump()
        for outcome in outcomes
    ]
    file.write_text(json.dumps(estimates | {"usable": not unmet, "checks": unmet}), encoding="utf-8")
    expected = caution.format(run=copy)
    out = tmp_path / "out"
    assert run_app(["export", str(copy), *(w for f in FORMATS for w in ("--format", f)), "--out", str(out)]) == 0
    err = capsys.readouterr().err
    assert err.startswith(f"fluxbench: {expected}") if expected else err == ""
    words = expected.partition(":")[0] or "the map is not"
    with np.load(out / "flux_map.npz") as arrays, xr.open_dataset(out / "flux_map.nc") as dataset:
        notes = [str(arrays["notes"]), dataset.attrs["notes"], (out / "flux_map.h").read_text(encoding="utf-8")]
    assert [words in text for text in notes] == [bool(expected)] * 3
    (map_file,) = (copy / "results").glob("flux_map.nc")
    of_file = api.export(map_file, "csv", motor=Motor(name="mine", pole_pairs=2), out=tmp_path / "file")
    assert of_file.caution.startswith(words if expected else "")
    assert bool(of_file.caution) == bool(expected)


@pytest.mark.slow
def test_exported_files_name_the_folder_of_the_run_that_they_are_of(tmp_path: Path) -> None:
    run_tiny(tmp_path)
    run = (tmp_path / "run").rename(tmp_path / "second motor")
    api.estimate(run)
    motor = Motor(name="mine", pole_pairs=2)
    for place in (run, run / "results" / "flux_map.nc"):
        out = tmp_path / place.name / "export"
        (file,) = (file.path for file in api.export(place, "csv", motor=motor, out=out).files)
        rows = Path(file).read_text(encoding="utf-8").splitlines()
        assert {row.rpartition(",")[2] for row in rows[1:]} == {"second motor"}
