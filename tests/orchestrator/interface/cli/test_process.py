"""One line on stderr, whatever the libraries below would like to add, and one for memory that is not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orchestrator.estimation.flux_map_file import save_flux_map
from protocols import FluxMap
from tests.support.processes import called, start_fluxbench


def test_a_damaged_map_is_one_line(tmp_path: Path) -> None:
    i, square = np.linspace(-1.0, 1.0, 3), np.outer(np.linspace(-1.0, 1.0, 3), np.ones(3))
    names = ("psi_d", "psi_q", "l_dd", "l_dq", "l_qq")
    grids = {name: square for one in names for name in (one, f"{one}_std")}
    file = tmp_path / "map.nc"
    save_flux_map(file, FluxMap(method="x", basis=None, i_d=i, i_q=i, **grids))
    file.write_bytes(file.read_bytes()[:3000])  # h5netcdf's destructor then complains in eight lines of its own
    _, message = start_fluxbench("check", "demo", "--model", str(file), "--isolability").communicate(timeout=30)
    assert message.count("\n") == 1, message
    assert "map.nc: not a readable NetCDF file" in message


def test_memory_that_is_not_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def greedy(*_: object) -> int:
        raise MemoryError("Unable to allocate 16. GiB for an array")

    monkeypatch.setattr("orchestrator.interface.cli._inspect.schema", greedy)
    done = called("schema", "run")
    assert (done.returncode, done.stderr) == (
        3,
        "fluxbench: not enough memory: Unable to allocate 16. GiB for an array\n",
    )


def test_a_name_that_no_file_system_takes_is_bad_input() -> None:
    done = called("estimate", "a" * 5000)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
