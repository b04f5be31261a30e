"""What the benchmark is: its name and version, its recordings by seed, and the names that an answer may use.

`missing-physics-1.csv` is frozen: a row a recording, with the SHA-256 of its data and of its sealed truth. A set with
other rows, plants, seeds or names (`missing-physics-1-names.csv`) has another version.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

NAME = "fluxbench-missing-physics"
VERSION = 1
TABLE = Path(__file__).with_name("missing-physics-1.csv")
NAMES = Path(__file__).with_name("missing-physics-1-names.csv")
MANIFEST, RECORDINGS, TRUTHS = "benchmark.json", "recordings", "truth"
"""In the folder of a set."""
LOG, MAPPING = "log.csv", "mapping.yaml"
"""In the folder of a recording that is a log of another tool."""
OWN_PLANTS = ("blind",)
"""Plants on which settings of fluxbench were chosen; the others are outer ones."""


@dataclass(frozen=True)
class Row:
    """One recording of the set: what it is made from, and what was made when the set was frozen.

    Attributes
    ----------
    kind : str
        Class of the benchmark.
    plant, case, index, seed : str, str, int, int
        What the plant draws the recording from.
    motor, plan : str
        Whose nameplate, and which experiment.
    without : str
        A name that answers may not use; empty where all may be used.
    log : bool
        Whether it is kept as a log of another tool.
    data_sha256, truth_sha256 : str
        Empty before the set is frozen.
    """

    id: str
    kind: str
    plant: str
    case: str
    index: int
    seed: int
    motor: str
    plan: str
    without: str
    log: bool
    data_sha256: str = ""
    truth_sha256: str = ""

    @property
    def origin(self) -> str:
        """``own`` or ``outer``."""
        return "own" if self.plant in OWN_PLANTS else "outer"


def frozen_rows(table: Path = TABLE) -> list[Row]:
    """The recordings of the set, in the order of their ids."""
    with table.open(encoding="utf-8", newline="") as file:
        return [
            Row(
                id=row["id"], kind=row["class"], plant=row["plant"], case=row["case"], index=int(row["index"]),
                seed=int(row["seed"]), motor=row["motor"], plan=row["plan"], without=row["without"],
                log=row["log"] == "yes", data_sha256=row["data_sha256"], truth_sha256=row["truth_sha256"],
            )
            for row in csv.DictReader(file)
        ]  # fmt: skip


@dataclass(frozen=True)
class Size:
    """The one number that an answer may state of an effect."""

    parameter: str
    """As the library of fluxbench calls it."""
    unit: str
    meaning: str


@cache
def effect_sizes() -> Mapping[str, Size]:
    """The names that an answer may use, each with its size."""
    with NAMES.open(encoding="utf-8", newline="") as file:
        return {row["name"]: Size(row["parameter"], row["unit"], row["meaning"]) for row in csv.DictReader(file)}
