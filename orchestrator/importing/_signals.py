"""Model of one quantity in a mapping: its columns, unit, frame, offset and factor; no I/O."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from orchestrator.importing._units import AngleUnit, CurrentUnit, TemperatureUnit, TimeUnit, VoltageUnit
from protocols import Positive, Strict

Axis = Literal["a", "b", "c", "alpha", "beta", "d", "q", "ab", "bc", "ca", "state"]
Frame = Literal["abc", "line_to_line", "alpha_beta", "dq", "switching"]
Scaling = Literal["amplitude_invariant", "power_invariant", "rms"]
Numbering = Literal["sectors", "bits_abc", "bits_cba"]

Column = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]+$")]
"""A column's name: anything that fits on a line."""
_AXES: dict[Frame, tuple[Axis, ...]] = {
    "abc": ("a", "b", "c"),
    "line_to_line": ("ab", "bc", "ca"),
    "alpha_beta": ("alpha", "beta"),
    "dq": ("d", "q"),
    "switching": ("state",),
}
_OF_THREE: tuple[Frame, ...] = ("abc", "line_to_line")
"""Frames in which two columns determine the third."""
DUTIES = ("duty", "duty_percent")
"""Units of voltages relative to the bus voltage."""


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise ValueError("a factor of zero leaves nothing")
    return value


NotZero = Annotated[float, AfterValidator(_not_zero)]


class _Raw(Strict):
    """Numbers of a column, as ``(number - offset) * factor`` in the unit."""

    offset: float = 0.0
    """The column's reading at zero, in raw numbers: a converter's midpoint."""
    factor: NotZero = 1.0
    """Factor from raw numbers less the offset to the unit: a probe's ratio, -1 for a reversed probe."""

    @property
    def is_in_unit(self) -> bool:
        """Whether the column is in its unit already."""
        return self.factor == 1.0 and self.offset == 0.0


class Angle(_Raw):
    """An electrical angle: a fixed value, or a column."""

    value: float | None = None
    column: Column | None = None
    unit: AngleUnit
    mechanical: bool = False
    """Whether the angle is mechanical: the electrical angle is the pole pairs times it."""

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.value is None) == (self.column is None):
            raise ValueError("expected either value or column")
        return self


class _Signal(Strict):
    """Columns and scaling of a current or a voltage."""

    frame: Frame
    columns: dict[Axis, Column]
    """Column names by axis: two or all of a, b, c; alpha and beta; d and q; two or all of ab, bc, ca; or state."""
    other_axis: Literal["zero"] | None = None
    """The value of an axis that was not logged, where only one of alpha and beta, or d and q, was."""
    scaling: Scaling | None = None
    """Scaling of the transform to alpha-beta or dq; for phases, rms where values are peak / sqrt 2."""
    offset: float | dict[Axis, float] = 0.0
    """Readings at zero, in raw numbers: one for all columns, or one per axis."""
    factor: NotZero | dict[Axis, NotZero] = 1.0
    """Factor from raw numbers less the offset to `unit`, for all columns or per axis; -1 for a reversed probe."""
    angle: Angle | None = None
    """Angle of the d axis of dq values. None: the segment's rotor angle."""

    @model_validator(mode="after")
    def _columns_make_a_vector(self) -> Self:
        self._check_columns()
        for name, by_axis in (("offset", self.offset), ("factor", self.factor)):
            if isinstance(by_axis, dict) and by_axis.keys() != self.columns.keys():
                raise ValueError(f"{name} needs one number, or one for each of {', '.join(self.columns)}")
        if self.frame in ("alpha_beta", "dq") and self.scaling is None:
            raise ValueError(
                f"frame {self.frame} needs scaling: amplitude_invariant (a peak stays a peak), power_invariant or rms"
            )
        if self.frame in _OF_THREE and self.scaling == "power_invariant":
            raise ValueError("phase quantities have no transform to be power_invariant; leave scaling out, or rms")
        if self.frame != "dq" and self.angle is not None:
            raise ValueError(f"frame {self.frame} has no angle; a rotor angle belongs to rotor_angle")
        return self

    def _check_columns(self) -> None:
        axes, of_three = _AXES[self.frame], self.frame in _OF_THREE
        lone = len(axes) == 2 and self.other_axis is not None
        if self.other_axis is not None and not (lone and len(self.columns) == 1):
            raise ValueError("other_axis: zero is for one column of alpha and beta, or of d and q")
        fewest = 1 if lone else 2 if of_three else len(axes)
        if set(self.columns) <= set(axes) and len(self.columns) >= fewest:
            return
        what = f"two or all of {', '.join(axes)}" if of_three else " and ".join(axes)
        alone = len(axes) == 2 and len(self.columns) == 1 and set(self.columns) <= set(axes)
        hint = "; other_axis: zero says that nothing was on the other" if alone else ""
        raise ValueError(f"frame {self.frame} needs columns for {what}, got {', '.join(self.columns) or 'none'}{hint}")

    def offset_of(self, axis: str) -> float:
        """The axis column's reading at zero."""
        return self.offset[axis] if isinstance(self.offset, dict) else self.offset  # type: ignore[index]  # an Axis

    def factor_of(self, axis: str) -> float:
        """The axis column's factor."""
        return self.factor[axis] if isinstance(self.factor, dict) else self.factor  # type: ignore[index]  # an Axis

    @property
    def is_in_unit(self) -> bool:
        """Whether the columns are in their unit already."""
        return self.factor == 1.0 and self.offset == 0.0


class CurrentSignal(_Signal):
    """Measured currents."""

    frame: Literal["abc", "alpha_beta", "dq"]
    unit: CurrentUnit


class VoltageSignal(_Signal):
    """Commanded voltages: of phases, against any common point; as volts, or as shares of the bus voltage."""

    unit: VoltageUnit
    numbering: Numbering | None = None
    """Code of the switching states: sectors (1 = 100, 2 = 110, 3 = 010 ... 0 and 7 zero), or the legs as bits with a
    or c as the highest."""

    @model_validator(mode="after")
    def _states_are_numbered(self) -> Self:
        if (self.frame == "switching") != (self.numbering is not None):
            raise ValueError("frame switching and numbering (sectors, bits_abc or bits_cba) go together")
        if self.frame == "switching" and self.unit != "duty":
            raise ValueError("frame switching has unit: duty, for a leg's state is a share of the bus voltage")
        if self.unit in DUTIES and self.frame == "abc" and len(self.columns) == 2:
            raise ValueError("of two duties the third is not known: they do not add up to zero; give columns for all")
        return self


class PhaseCurrents(_Raw):
    """All three phase currents, to check a current in another frame against."""

    columns: dict[Literal["a", "b", "c"], Column]
    unit: CurrentUnit

    @model_validator(mode="after")
    def _all_three(self) -> Self:
        if len(self.columns) != 3:
            raise ValueError(f"expected columns for a, b and c, got {', '.join(self.columns) or 'none'}")
        return self


class BusVoltage(_Raw):
    """The measured DC-bus voltage."""

    column: Column
    unit: Literal["V", "mV", "uV", "kV"]


class Temperature(_Raw):
    """Temperature of the winding or the housing."""

    column: Column
    unit: TemperatureUnit


class PwmFrequency(_Raw):
    """The PWM frequency of each row, where the drive changes it."""

    column: Column
    unit: Literal["Hz", "kHz"]


class TimeColumn(Strict):
    """The time stamps: of any clock, a counter's, or dates."""

    column: Column
    unit: TimeUnit
    tick_hz: Positive | None = None
    """Ticks per second, where `unit` is tick."""
    wraps_at: Positive | None = None
    """Number at which a counter wraps to zero, such as 65536."""

    @model_validator(mode="after")
    def _ticks_have_a_rate(self) -> Self:
        if (self.unit == "tick") != (self.tick_hz is not None):
            raise ValueError("unit tick and tick_hz (ticks a second) go together")
        if self.unit == "iso" and self.wraps_at is not None:
            raise ValueError("dates do not wrap")
        return self
