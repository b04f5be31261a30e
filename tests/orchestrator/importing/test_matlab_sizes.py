"""What a .mat file says little of: how large it is in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from orchestrator.importing import inflated_size
from orchestrator.importing._mapping import CsvLayout
from orchestrator.importing._opening import open_columns
from orchestrator.importing._source import Wanted
from protocols import InputError


@pytest.mark.parametrize("compressed", [True, False])
def test_zeros_in_a_small_file_are_counted_as_they_will_be(tmp_path: Path, compressed: bool) -> None:
    path = tmp_path / "log.mat"
    columns = {name: np.full(200_000, 0.1) for name in ("ia", "ib")}
    savemat(path, {**columns, "log": {"t": np.zeros((7, 3)) + 0.1}}, do_compression=compressed)
    size = sum(column.nbytes for column in columns.values())
    assert size < inflated_size(path) < 1.001 * size
    assert (path.stat().st_size < 0.01 * size) == compressed


def test_a_damaged_file_ends_where_it_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    savemat(path, {"ia": np.arange(1000.0), "ib": np.arange(1000.0)}, do_compression=True)
    whole = path.read_bytes()
    for k in range(0, len(whole), 97):
        path.write_bytes(whole[:k] + bytes(8) + whole[k + 8 :])
        assert 0 <= inflated_size(path) < 1e10
        path.write_bytes(whole[:k])
        assert 0 <= inflated_size(path) < 1e10


@pytest.mark.timeout(20)
@pytest.mark.parametrize("header", [bytes(128), b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"])
def test_a_large_file_of_zeros_is_refused_as_soon_as_a_small_one(header: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    with path.open("wb") as file:
        file.write(header)
        file.truncate(300_000_000)
    assert inflated_size(path) == 0
    with pytest.raises(InputError, match=r"log\.mat: not a readable MATLAB file: "):
        list(open_columns(path, Wanted(("ia",)), CsvLayout()).blocks)


@pytest.mark.parametrize("part", [0.3, 0.6, 0.95])
def test_a_version_7_3_file_that_was_cut_off_is_to_blame_itself(part: float, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in ("ia", "ib"):
            file.create_dataset(name, data=np.random.default_rng(1).random((1, 20_000)), chunks=(1, 1000))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    with pytest.raises(InputError, match=r"log\.mat: not a readable MATLAB file: .*truncated file"):
        list(open_columns(path, Wanted(("ia", "ib")), CsvLayout()).blocks)
