"""A map goes out from Python as it does from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.interface import api
from protocols import InputError, Motor
from tests.support.tiny import run_tiny


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with its estimates."""
    return run_tiny(tmp_path_factory.mktemp("exported")).path


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
