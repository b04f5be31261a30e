"""What a .mat file says little of: how large it is in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from orchestrator.importing import inflated_size


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
