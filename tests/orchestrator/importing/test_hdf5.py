"""Names of what an HDF5 file holds."""

from __future__ import annotations

from pathlib import Path

import h5py

from orchestrator.importing._hdf5 import list_datasets
from orchestrator.importing.guessing._columns import columns_of


def test_columns_of_a_matrix_are_along_its_second_axis_and_in_matlab_s_files_along_its_first(tmp_path: Path) -> None:
    for ending, shape in ((".h5", (5000, 2)), (".mat", (2, 5000))):
        path = tmp_path / f"log{ending}"
        with h5py.File(path, "w") as file:
            file.create_dataset("log", shape=shape, dtype="f8")
            file.create_dataset("t", shape=(1, 5000) if ending == ".mat" else (5000, 1), dtype="f8")
        assert columns_of(path).names == ["log(:,1)", "log(:,2)", "t"]


def test_a_matrix_of_a_billion_columns_is_not_listed_to_its_end(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.create_dataset("log", shape=(3, 10**9), dtype="f8", chunks=(1, 1 << 16))
        assert len(list_datasets(file, most=20)) == 20
