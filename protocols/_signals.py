"""Signals: input and output of an effect for one segment."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated

import numpy as np

from protocols._base import Phases, RealArray, Samples, Shape, Vectors, arrays_problem, shapes_of
from protocols._errors import InputError
from protocols._motor import Motor
from protocols._recording import DriveRecord

Curve = Annotated[RealArray, Shape(("m",))]
Points = Annotated[RealArray, Shape(("points", 2))]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LossHistory:
    """Copper loss over the whole experiment, coarsely sampled; what was not captured is estimated.

    Raises
    ------
    InputError
        Where a field is not an array of float32 or float64 of its shape, or two arrays differ in length.
    """

    time_s: Curve
    """Since the start of the experiment, increasing, shape (m,)."""
    power_w: Curve
    """Mean loss from this instant to the next, shape (m,)."""
    captured: Curve | None = None
    """1 where it was measured, 0 where it is assumed, shape (m,); None: measured throughout."""

    def __post_init__(self) -> None:
        _require_arrays(self)


@dataclass(frozen=True)
class Correction:
    """Signals changed by an effect, as new arrays of the same shape; None: unchanged."""

    i_ab: RealArray | None = None
    v_ab: RealArray | None = None
    v_late_ab: RealArray | None = None
    v_dc: RealArray | None = None
    theta_rad: RealArray | None = None
    resistance_ohm: RealArray | None = None
    i_m_ab: RealArray | None = None
    """None where `i_ab` is given: what magnetises moves along with it."""

    @property
    def arrays(self) -> dict[str, RealArray]:
        """The changed signals, by name."""
        return {name: array for name, array in vars(self).items() if array is not None}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signals:
    """One segment as an effect sees it, each quantity at its current best; time first.

    Starts as what was measured and commanded; what effects return is put in its place. Arrays are held by reference,
    never copied. `dataclasses.replace` gives the same segment with other fields, and checks them again.

    Raises
    ------
    InputError
        Where an array is not of float32 or float64 and of its field's shape, or two arrays differ in length.
    """

    start_s: float
    sampling_frequency_hz: float
    pwm_frequency_hz: float
    i_ab: Vectors
    """Stator current [A]."""
    v_ab: Vectors
    """Voltage at the terminals [V], its mean over each interval."""
    v_dc: Samples
    theta_rad: Samples
    """Electrical angle of the d axis."""
    turned_rad: float = 0.0
    """How far the rotor is believed to lie from where most of the recording has it."""
    resistance_ohm: Samples
    i_m_ab: Vectors
    """The part of the stator current that magnetises [A]."""
    heat_j: Samples
    """Copper loss since the start of the experiment."""
    v_late_ab: Vectors | None = None
    """What an interval's end has beside its mean [V], where the voltage changes within it; None: nothing."""
    psi_ab: Vectors | None = None
    """Flux linkage at the measured current by the model as it stands, magnet included [Wb]; None without a model."""
    inductance_ab: Phases | None = None
    """L_aa, L_ab, L_bb of the model there, in the stator frame [H]; None without a model."""
    psi_smooth_ab: Vectors | None = None
    """The flux without the current's noise: fast changes from the voltage, slow ones from the model [Wb]."""
    i_smooth_ab: Vectors | None = None
    """The stator current that belongs to the smooth flux [A]."""
    i_quiet_ab: Vectors | None = None
    """The stator current as a hold's readings tell it without their noise [A], for what bends within it; else None."""
    i_abc: Phases | None = None
    """Phase currents as the sensors read them [A], where the recording holds them; no effect changes them."""
    clarke_of_three: bool | None = None
    """Whether the vector was made of three readings (else of a and b); None where the recording does not tell."""
    largest_command_abc: Phases | None = None
    """Of a mean's readings, the part before which each phase had the largest command; None: rows are readings."""
    temperature_c: Samples | None = None
    """Logged temperature, where the drive has a thermometer."""
    start_temperature_c: float | None = None
    """The first one that was logged in the experiment."""
    came_from_ab: Points | None = None
    """Where the stator current was on its way to where the segment begins, oldest first, (points, 2) [A]; None: not
    known."""
    losses: LossHistory | None = None
    motor: Motor | None = None
    """The nameplate."""
    drive: DriveRecord | None = None
    bridge_on: bool = True
    """False while all gates are off: then no voltage is commanded and none is impressed."""

    def __post_init__(self) -> None:
        _require_arrays(self)

    @property
    def time_s(self) -> RealArray:
        """When each sample was, since the start of the experiment, shape (n,) [s]."""
        return self.start_s + np.arange(len(self.v_dc)) / self.sampling_frequency_hz

    def corrected(self, correction: Correction) -> Signals:
        """These signals with what an effect changed of them."""
        changed = self.changed_along(correction.arrays)
        return self.replaced(changed) if changed else self

    def changed_along(self, arrays: Mapping[str, RealArray]) -> Mapping[str, RealArray]:
        """All that changes where some arrays do, by their names: what magnetises moves along with the current."""
        return with_magnetising(arrays, self.i_ab, self.i_m_ab, self.i_quiet_ab)

    def replaced(self, arrays: Mapping[str, RealArray]) -> Signals:
        """These signals with other arrays of the same shapes in the place of some, by their names.

        Nothing is checked: effects that are evaluated segment by segment need this for each of them in every iteration.
        """
        other = object.__new__(Signals)
        put = object.__setattr__
        for name in _SIGNAL_NAMES:
            put(other, name, arrays[name] if name in arrays else getattr(self, name))
        return other


def with_magnetising(
    arrays: Mapping[str, RealArray], i_ab: RealArray, i_m_ab: RealArray, i_quiet_ab: RealArray | None
) -> Mapping[str, RealArray]:
    """Changed arrays by their names, and what moves along with a current that changes from `i_ab`, each (n, 2) [A]."""
    if "i_ab" not in arrays:
        return arrays
    shift = arrays["i_ab"] - i_ab
    changed = {"i_m_ab": i_m_ab + shift, **arrays}
    if i_quiet_ab is not None:
        changed["i_quiet_ab"] = i_quiet_ab + shift
    return changed


_SIGNAL_NAMES = tuple(field.name for field in dataclasses.fields(Signals))
_SHAPES = MappingProxyType({holder: shapes_of(holder) for holder in (LossHistory, Signals)})
_OPTIONAL = frozenset(f.name for holder in _SHAPES for f in dataclasses.fields(holder) if f.default is None)


def _require_arrays(holder: LossHistory | Signals) -> None:
    """Raise `InputError` where an array is not what its field is declared as."""
    problem = arrays_problem(_SHAPES[type(holder)], _OPTIONAL, holder)
    if problem is not None:
        raise InputError(type(holder).__name__, *problem)
