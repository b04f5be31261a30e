"""Read columns of a table as a whole, such as a flux map."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from orchestrator.importing._columnar import open_csv, open_parquet
from orchestrator.importing._mapping import CsvLayout
from orchestrator.importing._source import Numbers, Wanted, held


def read_table(path: Path, names: Sequence[str], layout: CsvLayout) -> dict[str, Numbers]:
    """Columns of a Parquet file, or of a text file with the given layout; raises `InputError`."""
    wanted = Wanted(tuple(dict.fromkeys(names)))
    source = (
        open_parquet(path, wanted) if path.suffix.lower() in (".parquet", ".pq") else open_csv(path, wanted, layout)
    )
    blocks = list(held(path, source.blocks))
    return {name: np.concatenate([block.numbers[name] for block in blocks] or [np.empty(0)]) for name in wanted.all}
