"""An import that lacks its mapping, its measurement or its folder says which."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from orchestrator.interface.cli._exchange import guess_import, require_import_files
from orchestrator.interface.cli._file_commands import commands
from protocols import InputError

LOG, MAPPING = Path("log.csv"), Path("mapping.yaml")


@pytest.mark.parametrize(
    ("files", "problem"),
    [
        ([LOG], "a measurement without its mapping: `fluxbench import --guess log.csv` writes one"),
        ([LOG, LOG], "a measurement without its mapping"),
        ([LOG, MAPPING], "the mapping comes first, mapping.yaml log.csv"),
        ([MAPPING], "a mapping without a measurement"),
    ],
)
def test_what_an_import_lacks_is_named(files: list[Path], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        require_import_files(files, has_out=True)
    with pytest.raises(InputError, match="--out names the new folder"):
        require_import_files(files, has_out=False)
    require_import_files([MAPPING, LOG], has_out=False)


def test_a_folder_that_is_not_named_is_the_only_thing_missing() -> None:
    assert "--out is missing" in CliRunner().invoke(commands, ["import", str(MAPPING), str(LOG)]).output


def test_a_mapping_or_a_folder_is_no_measurement_to_guess_from(tmp_path: Path) -> None:
    (tmp_path / "mapping.yaml").touch()
    for path, problem in ((tmp_path, "a folder"), (tmp_path / "mapping.yaml", "a YAML file")):
        with pytest.raises(InputError, match=problem):
            guess_import([path], None, None, False)
