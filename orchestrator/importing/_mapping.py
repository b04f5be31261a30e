"""Model of a mapping file: role, unit and frame of each column, and the segments' ranges; no I/O."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from orchestrator.importing._findings import Finding
from orchestrator.importing._signals import (
    DUTIES,
    Angle,
    BusVoltage,
    Column,
    CurrentSignal,
    PhaseCurrents,
    PwmFrequency,
    Temperature,
    TimeColumn,
    VoltageSignal,
)
from protocols import Positive, ProcedureMotor, SegmentStage, Strict


class CsvLayout(Strict):
    """Layout of a text file."""

    delimiter: Annotated[str, Field(min_length=1, max_length=1, pattern=r"^[\x09\x20-\x7e]$")] = ","
    decimal: Literal[".", ","] = "."
    skip_rows: Annotated[int, Field(ge=0, le=1_000_000)] = 0
    """Number of lines before the column names."""
    skip_rows_after_names: Annotated[int, Field(ge=0, le=1_000_000)] = 0
    """Number of lines after the column names, such as a line of units."""
    names: tuple[Column, ...] | None = None
    """Column names for a file that has no line of names."""
    encoding: Literal["utf-8", "latin-1", "utf-16"] = "utf-8"

    @model_validator(mode="after")
    def _telling_apart(self) -> Self:
        if self.delimiter == self.decimal:
            raise ValueError(f"delimiter and decimal are both {self.delimiter!r}")
        return self


class ImportedDrive(Strict):
    """The drive's data for the manifest."""

    name: str
    dc_bus_voltage_v: Positive
    pwm_frequency_hz: Positive | None = None
    voltage_delay_samples: float | None = None


class SegmentRule(Strict):
    """Conditions on the rows of a segment, and the segment's data. A row belongs to the first rule that it matches.

    An omitted condition matches every row. Each uninterrupted run of rows of one rule, label and file
    becomes one segment.
    """

    stage: SegmentStage
    file: str | None = None
    """Name of the file, ``*`` and ``?`` allowed."""
    label: str | int | None = None
    """Pattern for the label in `segment_column`, ``*`` and ``?`` allowed."""
    from_s: float | None = None
    to_s: float | None = None
    """Start of the time range on the time column [s], or since the file's first row without one."""
    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)] | None = None
    """None: the stage and a number. Of several segments the second becomes ``<id>.2``."""
    start_s: float | None = None
    """Start on the experiment's clock [s], where the time stamps do not determine it."""
    rotor_angle: Angle | None = None
    settings: dict[str, Any] = Field(default_factory=dict)
    """Set points and settings, as in the recording format."""

    @model_validator(mode="after")
    def _range_is_one(self) -> Self:
        if self.from_s is not None and self.to_s is not None and self.to_s <= self.from_s:
            raise ValueError(f"to_s {self.to_s:g} is not after from_s {self.from_s:g}")
        return self

    @property
    def has_range(self) -> bool:
        """Whether the rule has a condition on the time."""
        return self.from_s is not None or self.to_s is not None


class FileRule(Strict):
    """Deviations for some of the files: each given key overrides the mapping's own.

    A file belongs to the first rule that it matches. A section, such as ``current``, needs only the keys that differ.
    """

    file: Annotated[str, Field(min_length=1)]
    """Name of the file, ``*`` and ``?`` allowed."""
    columns: tuple[Column, ...] | dict[Column, Column] | None = None
    """Names in this file by the mapping's names; with `beside`, the columns that this file has."""
    beside: Annotated[str, Field(min_length=1)] | None = None
    """Name pattern of the files that this file's columns are joined to, in order: the first to the first."""
    align: Literal["stamps", "edges"] = "stamps"
    """Alignment: by time stamps of a common clock, or by voltage edges that change the current's slope."""
    time: dict[str, Any] | None = None
    sampling_frequency_hz: Positive | None = None
    current: dict[str, Any] | None = None
    voltage: dict[str, Any] | None = None
    phase_currents: dict[str, Any] | None = None
    bus: dict[str, Any] | None = None
    temperature: dict[str, Any] | None = None
    pwm_frequency: dict[str, Any] | None = None
    rotor_angle: dict[str, Any] | None = None
    segment_column: Column | None = None
    csv: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _beside_has_columns(self) -> Self:
        if self.beside is not None and not self.columns:
            raise ValueError("beside needs columns: those that this file has")
        if self.beside is None and isinstance(self.columns, tuple):
            raise ValueError("columns needs the name in the file for each, such as {ia: CH1}")
        if self.align == "edges" and self.beside is None:
            raise ValueError("align is for files that are laid beside others")
        return self

    @property
    def names(self) -> dict[str, str]:
        """The names in the file, by the names in the mapping."""
        columns = self.columns or {}
        return dict(columns) if isinstance(columns, dict) else {name: name for name in columns}


OVERRIDING = tuple(FileRule.model_fields.keys() - {"file", "columns", "beside", "align"})
"""Keys of the mapping that a rule for files may override."""


class ImportMapping(Strict):
    """A complete mapping file; motor and drive may be paths of YAML files with these sections."""

    format: Literal["fluxbench-import"]
    version: Literal[1]
    name: Annotated[str, Field(min_length=1)]
    """The recording's name."""
    created: str | None = None
    """Date of the measurement. None: the time of the import."""
    motor: ProcedureMotor
    drive: ImportedDrive
    current: CurrentSignal
    voltage: VoltageSignal
    phase_currents: PhaseCurrents | None = None
    bus: BusVoltage | None = None
    """None: the drive's `dc_bus_voltage_v` in every row."""
    temperature: Temperature | None = None
    pwm_frequency: PwmFrequency | None = None
    """None: the drive's in every row, but for rules whose settings state another one."""
    time: TimeColumn | None = None
    sampling_frequency_hz: Positive | None = None
    """None: from the time stamps."""
    jitter_tolerance_samples: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    """Largest deviation of a time stamp from even spacing [samples]."""
    resample: bool = False
    """Interpolate onto an even spacing instead of refusing an uneven one."""
    split_at_gaps: bool = False
    """End a segment where samples are missing and begin another instead of refusing."""
    rotor_angle: Angle = Angle(value=0.0, unit="rad")
    """The believed electrical angle, for segments without their own."""
    segment_column: Column | None = None
    segments: Annotated[tuple[SegmentRule, ...], Field(min_length=1)]
    csv: CsvLayout = CsvLayout()
    accept: frozenset[Finding] = frozenset()
    """Findings that are correct: reported as notes instead of errors."""

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        if self.time is None and self.sampling_frequency_hz is None:
            raise ValueError("time: missing; name the time column, or give sampling_frequency_hz")
        if self.phase_currents is not None and self.current.frame == "abc":
            raise ValueError("phase_currents: the current is given in phases already")
        for index, rule in enumerate(self.segments):
            if rule.label is not None and self.segment_column is None:
                raise ValueError(f"segments.{index}.label: needs segment_column, the column that holds labels")
        return self

    def number_columns(self) -> list[str]:
        """The columns of numbers, each once, in the order of the mapping."""
        stamps = [] if self.time is None or self.time.unit == "iso" else [self.time.column]
        return list(dict.fromkeys((*stamps, *self.signal_columns())))

    def signal_columns(self) -> list[str]:
        """The number columns without the time stamps."""
        return list(dict.fromkeys(self._all_signal_columns()))

    def units(self) -> dict[str, str]:
        """The mapping's unit of each column whose raw numbers are already in that unit."""
        found: dict[str, str] = {}
        for signal in (self.current, self.voltage, self.phase_currents):
            if signal is not None and signal.is_in_unit and signal.unit not in DUTIES:
                found |= dict.fromkeys(signal.columns.values(), signal.unit)
        if self.bus is not None and self.bus.is_in_unit:
            found[self.bus.column] = self.bus.unit
        if self.pwm_frequency is not None and self.pwm_frequency.is_in_unit:
            found[self.pwm_frequency.column] = self.pwm_frequency.unit
        if self.time is not None and self.time.unit not in ("tick", "iso"):
            found[self.time.column] = self.time.unit
        return found | {a.column: a.unit for a in self._angles() if a.column is not None and a.is_in_unit}

    def _all_signal_columns(self) -> Iterator[str]:
        yield from self.current.columns.values()
        yield from self.voltage.columns.values()
        if self.phase_currents is not None:
            yield from self.phase_currents.columns.values()
        if self.bus is not None:
            yield self.bus.column
        if self.temperature is not None:
            yield self.temperature.column
        if self.pwm_frequency is not None:
            yield self.pwm_frequency.column
        yield from (angle.column for angle in self._angles() if angle.column is not None)

    def _angles(self) -> Iterator[Angle]:
        candidates = [self.current.angle, self.voltage.angle, self.rotor_angle]
        yield from (a for a in (*candidates, *(rule.rotor_angle for rule in self.segments)) if a is not None)
