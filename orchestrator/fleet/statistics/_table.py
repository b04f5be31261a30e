"""A fleet's table as arrays: the recordings, and their quantities with intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orchestrator.fleet.statistics._validation import MAKES_A_TABLE, validate_types
from orchestrator.formatting.names import parameter_words, plain
from orchestrator.numerics.types import Array, Mask
from protocols import InputError
from protocols.fleet import arrow_schema
from protocols.fleet_report import FleetRecording

if TYPE_CHECKING:
    import pyarrow as pa

COPPER_PER_K = 0.00393
"""Relative rise of copper's resistance, at 20 C (IEC 60028)."""
PARQUET_ENDINGS = (".parquet", ".parq", ".pq")
_REFERRED = "R_s_20_ohm"
_PLAIN = {
    "R_s_ohm": ("R_s", "ohm"),
    "L_d_h": ("L_d", "H"),
    "L_q_h": ("L_q", "H"),
    "psi_pm_wb": ("ψ_pm", "Wb"),
    "saliency": ("saliency", "1"),
    "temperature_c": ("temperature", "°C"),
    "chi2": ("chi2", "1"),
    "error_mv": ("error", "mV"),
}
"""Columns that are numbers: symbol and unit."""
_OF_THE_MEASUREMENT = ("temperature_c", "chi2", "error_mv")
"""Columns that describe the measurement rather than the motor."""


@dataclass(frozen=True)
class Column:
    """One quantity of each recording.

    Attributes
    ----------
    name, label, unit : str
    values, low, high : array, shape (n,)
        With 95 % intervals; NaN where it was not measured, or an interval is not known.
    observable : array of bool, shape (n,)
        Where the quantity was searched for: an effect in diagnosed recordings.
    is_effect : bool
    of_motor : bool
        Whether it belongs to the motor rather than to the measurement, and follows from no other quantity.
    """

    name: str
    label: str
    unit: str
    values: Array
    low: Array
    high: Array
    observable: Mask
    is_effect: bool = False
    of_motor: bool = True

    @property
    def known(self) -> Mask:
        return np.isfinite(self.values)

    def scatters(self, least: float) -> bool:
        """Whether half of its values lie further from the median than this share of it."""
        values = self.values[self.known]
        middle = float(np.median(values)) if len(values) else 0.0
        return len(values) > 1 and float(np.median(np.abs(values - middle))) > least * abs(middle)

    def of_rows(self, rows: Mask) -> Column:
        """Some of the recordings alone."""
        parts = {name: getattr(self, name)[rows] for name in ("values", "low", "high", "observable")}
        return replace(self, **parts)

    @property
    def deviations(self) -> Array:
        """Standard deviation of each value by its own interval; NaN where it has none."""
        from scipy.stats import norm

        return np.asarray((self.high - self.low) / (2.0 * norm.ppf(0.975)), dtype=np.float64)


@dataclass(frozen=True)
class FleetTable:
    """The recordings with results, and the quantities of each.

    Attributes
    ----------
    place : str
    recordings : sequence of FleetRecording
    seconds : array, shape (n,)
        Since 1970, when each began; NaN where that is not known.
    motors : sequence of (str or None)
        The nameplate's names.
    verdicts : sequence of (str or None)
    usable : sequence of (bool or None)
    columns : mapping of Column
    failures : sequence of str
        The errors of the other recordings.
    damaged : sequence of str
        The errors of parts of the table that cannot be read.
    """

    place: str
    recordings: Sequence[FleetRecording]
    seconds: Array
    motors: Sequence[str | None]
    verdicts: Sequence[str | None]
    usable: Sequence[bool | None]
    columns: Mapping[str, Column]
    failures: Sequence[str]
    damaged: Sequence[str] = ()

    def __len__(self) -> int:
        return len(self.recordings)

    def of_rows(self, rows: Mask) -> FleetTable:
        """Some of the recordings alone."""
        return replace(
            self,
            recordings=list(compress(self.recordings, rows)),
            seconds=self.seconds[rows],
            motors=list(compress(self.motors, rows)),
            verdicts=list(compress(self.verdicts, rows)),
            usable=list(compress(self.usable, rows)),
            columns={name: column.of_rows(rows) for name, column in self.columns.items()},
        )


def read_fleet(place: str) -> FleetTable:
    """Read a data set: a Parquet file, or a folder of them; `damaged` has the parts that cannot be read.

    Raises
    ------
    InputError
        Where no part can be read, or it is no fleet's table.
    """
    import pyarrow as pa

    path = Path(place)
    if not path.exists():
        raise InputError(place, "", f"no such table{MAKES_A_TABLE}")
    parts = list(_parts_below(path)) if path.is_dir() else [path]
    if not parts:
        raise InputError(place, "", f"no Parquet file in it{MAKES_A_TABLE}")
    tables, damage = [], []
    for part in parts:
        try:
            tables.append(validate_types(_arrow_table(part), str(part)))
        except InputError as error:
            damage.append(error)
    if not tables:
        raise damage[0]
    return replace(fleet_of(pa.concat_tables(tables), place), damaged=[str(error) for error in damage])


def _parts_below(folder: Path) -> Iterator[Path]:
    """Parquet files in and below a folder; as for other readers, names with a leading dot or underscore are none."""
    for file in sorted(folder.rglob("*")):
        hidden = any(name.startswith((".", "_")) for name in file.relative_to(folder).parts)
        if not hidden and file.suffix in PARQUET_ENDINGS and not file.is_dir():
            yield file


def _arrow_table(part: Path) -> pa.Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    known = set(arrow_schema().names)
    try:
        file = pq.ParquetFile(part)
        # Each column once: of two with one name, `validate_types` says so.
        return file.read(columns=[name for name in dict.fromkeys(file.schema_arrow.names) if name in known])
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = str(error).splitlines()[0][:160].rstrip(".")
        problem = f"cannot be read as Parquet: {'damaged, or of another format' if 'magic bytes' in reason else reason}"
        raise InputError(str(part), "", problem + MAKES_A_TABLE) from None


def fleet_of(table: pa.Table, place: str) -> FleetTable:
    """The fleet of a table in memory; of several rows of one source the one with most results, then the last."""
    table = validate_types(table, place)
    if not table.num_rows:
        raise InputError(place, "", "holds no recording")
    table = table.take(_of_each_source(table))
    failed = np.array([text is not None for text in table.column("failed").to_pylist()], dtype=bool)
    failures = [text for text in table.column("failed").to_pylist() if text is not None]
    table = table.filter(~failed)
    identity = ("source", "name", "serial", "batch", "started_at")
    rows = table.select(identity).to_pylist()
    return FleetTable(
        place,
        [FleetRecording.model_validate(row) for row in rows],
        np.array([_seconds(row["started_at"]) for row in rows], dtype=np.float64),
        table.column("motor").to_pylist(),
        table.column("verdict").to_pylist(),
        table.column("usable").to_pylist(),
        {column.name: column for column in _columns(table)},
        failures,
    )


def _of_each_source(table: pa.Table) -> list[int]:
    """The row of each source with the most results, then the last."""
    counts = np.zeros(table.num_rows, dtype=int)
    for name in ("R_s_ohm", "L_d_h", "verdict"):
        counts += table.column(name).is_valid().to_numpy(zero_copy_only=False)
    counts += 10 * table.column("failed").is_null().to_numpy(zero_copy_only=False)
    best: dict[str, int] = {}
    for row, source in enumerate(table.column("source").to_pylist()):
        if source not in best or counts[row] >= counts[best[source]]:
            best[source] = row
    return sorted(best.values())


def _columns(table: pa.Table) -> Iterator[Column]:
    every = np.ones(table.num_rows, dtype=bool)
    nothing = np.full(table.num_rows, np.nan)
    numbers = {name: _numbers(table, name) for name in (*_PLAIN, "R_s_low_ohm", "R_s_high_ohm")}
    for name, (label, unit) in _PLAIN.items():
        own = name == "R_s_ohm"
        low, high = (numbers["R_s_low_ohm"], numbers["R_s_high_ohm"]) if own else (nothing, nothing)
        # With temperatures, only the resistance at a reference temperature is a property of the motor.
        motors = name not in (*_OF_THE_MEASUREMENT, "saliency") and not (own and _is_referred(numbers))
        yield Column(name, label, unit, numbers[name], low, high, every, of_motor=motors)
        if own and _is_referred(numbers):
            cold = 1.0 / (1.0 + COPPER_PER_K * (numbers["temperature_c"] - 20.0))
            yield Column(
                _REFERRED, "R_s at 20 °C", unit, numbers[name] * cold, low * cold, high * cold, every, of_motor=True
            )
    yield from _effects(table)
    yield from _set_points(table)


def _is_referred(numbers: Mapping[str, Array]) -> bool:
    """Whether wherever a resistance is known, its temperature is too."""
    known = np.isfinite(numbers["R_s_ohm"])
    return bool(known.any() and np.isfinite(numbers["temperature_c"][known]).all())


def _effects(table: pa.Table) -> Iterator[Column]:
    diagnosed, parents, items = _flattened(table, "effects")
    fields = ("name", "parameter", "unit")
    names = list(zip(*(items.field(k).to_pylist() for k in fields), strict=True))
    sizes = {name: _floats(items.field(name)) for name in ("size", "low", "high")}
    for kind in dict.fromkeys(names):
        here = np.array([one == kind for one in names])
        effect, parameter, unit = kind
        out = {name: np.full(table.num_rows, np.nan) for name in sizes}
        for name, values in sizes.items():
            out[name][parents[here]] = values[here]
        label = f"{plain(effect)}: {parameter_words(parameter)}"
        yield Column(
            f"{effect}.{parameter}", label, unit, out["size"], out["low"], out["high"], diagnosed, is_effect=True
        )


def _set_points(table: pa.Table) -> Iterator[Column]:
    """Fluxes at the currents that most recordings have."""
    mapped, parents, items = _flattened(table, "set_points")
    if not len(items):
        return
    currents = np.column_stack([_floats(items.field(name)) for name in ("i_d_a", "i_q_a")])
    nothing = np.full(table.num_rows, np.nan)
    for place in np.unique(currents, axis=0):
        here = (currents == place).all(axis=1)
        if 2 * int(here.sum()) < int(mapped.sum()) or not place.any():
            continue
        for axis in "dq":
            values = nothing.copy()
            values[parents[here]] = _floats(items.field(f"psi_{axis}_wb"))[here]
            at = f"({place[0] + 0.0:.3g}, {place[1] + 0.0:.3g})"
            yield Column(
                f"psi_{axis}_wb{at}",
                f"ψ_{axis} at {at} A".replace("-", "−"),
                "Wb",
                values,
                nothing,
                nothing,
                mapped,
                of_motor=False,
            )


def _flattened(table: pa.Table, name: str) -> tuple[Mask, Array, Any]:
    """Which rows have a list, the row of each item, and the items as a struct array."""
    import pyarrow as pa

    chunked = table.column(name)
    column = chunked.combine_chunks() if chunked.num_chunks != 1 else chunked.chunk(0)
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], type=column.type)
    valid = column.is_valid().to_numpy(zero_copy_only=False)
    parents = column.value_parent_indices().to_numpy(zero_copy_only=False)
    return np.asarray(valid, dtype=bool), parents, column.flatten()


def _numbers(table: pa.Table, name: str) -> Array:
    if name not in table.column_names:
        return np.full(table.num_rows, np.nan)
    return _floats(table.column(name))


def _floats(column: Any) -> Array:
    import pyarrow as pa

    values = np.asarray(column.cast(pa.float64()).fill_null(float("nan")).to_numpy(zero_copy_only=False))
    return np.where(np.isfinite(values), values, np.nan)


def _seconds(at: datetime | None) -> float:
    return float("nan") if at is None else at.timestamp()
