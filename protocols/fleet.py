"""One row of a fleet's table: who was measured, what was found, and what it cost. Reads and writes no files.

The table is a Parquet data set; `arrow_schema` is its schema, made from these models, so that they cannot disagree.
"""

from __future__ import annotations

from datetime import datetime
from functools import cache
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

from pydantic import AwareDatetime, BaseModel, Field

from protocols._base import Lenient
from protocols._remarks import Number

if TYPE_CHECKING:
    import pyarrow as pa

FleetStep = Literal["import", "estimate", "compare", "diagnose", "export"]
"""Steps for each recording, in this order."""


class FleetSetPoint(Lenient):
    """Flux linkage at one current, by the recommended map."""

    i_d_a: float
    i_q_a: float
    psi_d_wb: float
    psi_q_wb: float


class FleetEffect(Lenient):
    """The size of an effect that a diagnosis has in its model: one entry for each parameter in its first one's unit."""

    name: str
    parameter: str
    size: Number
    unit: str
    low: Number
    high: Number
    """95 % interval."""
    probability: Number = None
    """Probability that it is present, given all others in the model."""
    relative_size: Number = None
    """|first parameter| over its typical value."""
    material: bool | None = None
    """Whether it is named as a cause, rather than only measured; null where that was not judged."""
    twins: tuple[str, ...] = ()
    """Effects that do as well in its place, in this recording."""


class HiddenEffect(Lenient):
    """What a campaign hid in its simulated motor; written by the campaign when the result is in."""

    name: str
    parameter: str
    size: float


class FleetVersions(Lenient):
    """Software that computed the row."""

    fluxbench: str
    python: str
    numpy: str


class FleetRow(Lenient):
    """One recording; null means not requested, or not available."""

    key: str
    """Hash of the recording's content, the requested steps and fluxbench's version; unique in a table."""
    source: str
    """Location: a path or URL."""
    name: str | None = None
    serial: str | None = None
    """Serial number of the motor, from its run."""
    motor: str | None = None
    """The nameplate's name."""
    batch: str | None = None
    """By the run's tag ``batch=...``, else the folder that it lies in, where that is not the source itself."""
    started_at: AwareDatetime | None = None
    recorded_samples: int | None = None
    content_sha256: str | None = None
    """Hash of the recording's files alone, whatever steps were requested."""
    fingerprint: str | None = None
    """Hash of names, sizes and times in the listing; an equal one is not opened again."""
    asked: tuple[str, ...] = ()
    """The steps, and of an import which mapping, by its hash."""

    R_s_ohm: Number = None
    R_s_low_ohm: Number = None
    R_s_high_ohm: Number = None
    """95 % interval."""
    temperature_c: Number = None
    """Mean of what was measured beside the currents; else the room's, where the run says it."""
    L_d_h: Number = None
    """Incremental, at zero current; likewise L_q."""
    L_q_h: Number = None
    psi_pm_wb: Number = None
    """psi_d at zero current; null where neither nameplate nor measurement know it."""
    saliency: Number = None
    """L_q_h over L_d_h."""
    set_points: tuple[FleetSetPoint, ...] | None = None
    """At rest, and at halves and wholes of the rated current on both axes, where the map was measured."""
    effects: tuple[FleetEffect, ...] | None = None
    verdict: str | None = None
    usable: bool | None = None
    """Whether the recommended map can be relied on; null where there is none, or only a diagnosis can judge it."""
    chi2: Number = None
    """Per degree of freedom: of the diagnosed model, else of the one compared with."""
    error_mv: Number = None
    """rms on held-out data, after."""
    error_before_mv: Number = None

    failed: str | None = None
    """Why there is no result, in one line."""
    attempts: Annotated[int, Field(ge=1)] = 1
    seconds: float = 0.0
    """Duration of the last attempt on its worker."""
    peak_mb: float = 0.0
    """Largest memory of the worker's process so far; 0 where the system does not report it."""
    versions: FleetVersions | None = None

    condition: str | None = None
    """Procedure, motor, effect, size and seed of a campaign's run, in one line."""
    hidden: tuple[HiddenEffect, ...] | None = None
    """Effects that a campaign hid; empty for a motor without any."""


@cache
def arrow_schema() -> pa.Schema:
    """The table's schema; its columns are `FleetRow`'s fields, in their order."""
    import pyarrow as pa

    return pa.schema(_fields(FleetRow))


def _fields(model: type[BaseModel]) -> list[pa.Field]:
    import pyarrow as pa

    return [
        pa.field(name, _arrow_type(field.annotation), nullable=not (field.is_required() and field.annotation is str))
        for name, field in model.model_fields.items()
    ]


def _arrow_type(kind: Any) -> pa.DataType:
    import pyarrow as pa

    plain = {str: pa.string(), bool: pa.bool_(), int: pa.int64(), float: pa.float64()}
    if kind in plain:
        return plain[kind]
    if kind is datetime or kind is AwareDatetime:
        return pa.timestamp("us", tz="UTC")
    if isinstance(kind, UnionType) or get_origin(kind) is Annotated:
        inner = next(arg for arg in get_args(kind) if arg is not NoneType)
        return _arrow_type(inner)
    if get_origin(kind) is tuple:
        return pa.list_(_arrow_type(get_args(kind)[0]))
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return pa.struct(_fields(kind))
    raise TypeError(f"no column can hold {kind!r}")
