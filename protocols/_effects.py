"""Effects: physical imperfections that a model may lack, as the diagnosis tries them one by one.

An effect turns what the drive believes into what the motor felt: sensor readings into stator
current, commanded voltage into impressed voltage, believed angle into the true one. It is a pure
function of a recording's signals; entry point group ``fluxbench.effects``.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Annotated, Any, ClassVar, Protocol, dataclass_transform, runtime_checkable

import numpy as np

from protocols._base import ArrayModel, Phases, RealArray, Samples, Shape, Vectors
from protocols._errors import PluginError
from protocols._motor import Motor
from protocols._recording import DriveRecord


class EffectLayer(IntEnum):
    """Where an effect acts; effects are applied in this order, from the sensors inwards."""

    CURRENT_SENSORS = 1
    DELAY = 2
    BUS = 3
    INVERTER = 4
    RESISTANCE = 5
    FRAME = 6
    IRON = 7


class Contrast(StrEnum):
    """What a recording may hold beside the usual, by which effects that look alike part."""

    GATES_OFF = "gates_off"
    """A reading of the sensors with all gates off."""
    SECOND_PWM_FREQUENCY = "second_pwm_frequency"
    """Direct currents held at two PWM frequencies."""
    SECOND_ANGLE = "second_angle"
    """The rotor locked at two angles."""
    SECOND_INJECTION_FREQUENCY = "second_injection_frequency"
    """Ripple of two frequencies."""
    SECOND_INJECTION_AMPLITUDE = "second_injection_amplitude"
    """Ripple of two amplitudes, at the same points."""
    OPERATING_POINTS = "operating_points"
    """Ripple along both axes."""
    SMALL_CURRENTS = "small_currents"
    """Direct currents held densely about zero."""
    DIRECTIONS = "directions"
    """Direct currents held all around."""
    ANCHOR = "anchor"
    """One point measured twice, when the machine was colder and when it was warmer."""
    LONG_HOLD = "long_hold"
    """A direct current held for so long that the winding warms up under it."""


class ParameterRole(StrEnum):
    """What a parameter does in its effect; the diagnosis frees them in this order."""

    AMPLITUDE = "amplitude"
    """Alone decides whether the effect is there: nothing happens while all amplitudes are neutral."""
    SHAPE = "shape"
    """Says how the amplitude acts; has no effect of its own, and is positive (fitted on a log scale)."""
    REFINEMENT = "refinement"
    """Makes the effect's form more flexible; neutral is the simple form."""


SCALED_UNITS = ("A", "V", "ohm", "Wb", "H", "W", "Nm")
"""Units of what is larger in a larger machine: the diagnosis scales a parameter by the nameplate."""
PLAIN_UNITS = ("1", "s", "Hz", "rad", "K")
"""Units of what is the same in every machine."""


def unit_powers(unit: str) -> dict[str, int]:
    """The powers of the known units in a product or a quotient: ``rad/Nm``, ``1/A^2``, ``V s``.

    Raises
    ------
    ValueError
        Where the unit holds something else.
    """
    known = SCALED_UNITS + PLAIN_UNITS
    factor = rf"({'|'.join(known)})(\^[2-9])?"
    if not re.fullmatch(rf"{factor}( {factor})*(/{factor}( {factor})*)?", unit):
        known_words = ", ".join(known)
        raise ValueError(
            f"unit {unit!r} cannot be scaled to a machine; expected a product or quotient of {known_words}"
        )
    powers: dict[str, int] = {}
    for sign, product in zip((1, -1), unit.split("/"), strict=False):
        for symbol, _, power in (part.partition("^") for part in product.split()):
            powers[symbol] = powers.get(symbol, 0) + sign * int(power or 1)
    return powers


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect, in SI, at the size of a 400 W machine (1.66 A rms, 540 V, 4.25 ohm)."""

    name: str
    unit: str
    """A product or quotient of `SCALED_UNITS` and `PLAIN_UNITS`."""
    typical: float
    """The size met in practice; relative sizes refer to it."""
    prior_width: float
    """Standard deviation of the prior about zero effect; of a shape in its logarithm."""
    low: float
    high: float
    neutral: float
    """The value at which the effect is absent (may be infinite in principle; then the bound)."""
    strong_when_small: bool = False
    """Relative size is typical / value instead of value / typical."""
    role: ParameterRole = ParameterRole.AMPLITUDE
    other_form: float | None = None
    """Of a refinement or a shape: where a second form stands, so unlike the first that a fit begins at each of them."""
    detail: bool = False
    """Of a refinement: asked only once the others bring nothing more, for it can stand in for them, and less well."""

    def problem(self) -> str | None:
        """What would make no sense to a fit, in a few words; None where all is well."""
        for name in ("low", "high", "neutral", "typical", "prior_width"):
            if not math.isfinite(getattr(self, name)):
                return f"{name} is {getattr(self, name)}"
        if not self.low < self.high:
            return f"low {self.low:g} is not below high {self.high:g}"
        for name in ("neutral", "typical", "other_form"):
            value = getattr(self, name)
            if value is not None and not self.low <= value <= self.high:
                return f"{name} {value:g} is not between low {self.low:g} and high {self.high:g}"
        if self.prior_width <= 0.0:
            return f"prior_width {self.prior_width:g} is not positive"
        if self.role is ParameterRole.SHAPE and self.low <= 0.0:
            return f"low {self.low:g} of a shape is not positive"
        if self.role is ParameterRole.AMPLITUDE and self.typical in (self.neutral, 0.0):
            return f"typical {self.typical:g} of an amplitude is zero, or its neutral value: it has no size"
        try:
            unit_powers(self.unit)
        except ValueError as error:
            return str(error)
        return None


def amplitude(
    unit: str,
    *,
    typical: float,
    prior_width: float,
    low: float,
    high: float,
    neutral: float = 0.0,
    strong_when_small: bool = False,
) -> Any:
    """A field of `EffectParameters` that decides whether the effect is there; its default is the neutral value."""
    return _declared(
        ParameterRole.AMPLITUDE, neutral, unit, typical, prior_width, low, high, neutral, strong_when_small
    )


def shape(
    unit: str, *, typical: float, prior_width: float, low: float, high: float, other_form: float | None = None
) -> Any:
    """A positive field of `EffectParameters` that says how the amplitude acts; its default is the typical value."""
    facts = (unit, typical, prior_width, low, high, typical, False)
    return _declared(ParameterRole.SHAPE, typical, *facts, other_form)


def refinement(
    unit: str,
    *,
    neutral: float,
    prior_width: float,
    low: float,
    high: float,
    other_form: float | None = None,
    detail: bool = False,
) -> Any:
    """A field of `EffectParameters` that bends the effect's form; its default, neutral, is the simple form."""
    facts = (unit, neutral, prior_width, low, high, neutral, False)
    return _declared(ParameterRole.REFINEMENT, neutral, *facts, other_form, detail)


def _declared(role: ParameterRole, default: float, *facts: Any) -> Any:
    names = ("unit", "typical", "prior_width", "low", "high", "neutral", "strong_when_small", "other_form", "detail")
    return dataclasses.field(default=default, metadata={"role": role, **dict(zip(names, facts, strict=False))})


@dataclass_transform(kw_only_default=True, frozen_default=True)
class EffectParameters:
    """Base of an effect's parameters: each field is declared once, by its role, and read as an attribute.

    A sub-class is a frozen dataclass; without arguments it is the effect's absence::

        class Parameters(EffectParameters):
            voltage_v: float = amplitude("V", typical=8.0, prior_width=8.0, low=-20.0, high=20.0)

    Raises
    ------
    PluginError
        When such a class is defined: where a field is no parameter, or one that cannot be fitted.
    """

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        dataclass(frozen=True, kw_only=True)(cls)
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]  # a dataclass by now
            if "role" not in field.metadata:
                raise PluginError("effects", f"{cls.__qualname__}.{field.name}", _ROLES)
        for parameter in cls.declared():
            problem = parameter.problem()
            if problem is not None:
                raise PluginError("effects", f"{cls.__qualname__}.{parameter.name}", problem)

    @classmethod
    def declared(cls) -> tuple[EffectParameter, ...]:
        """What the fields say: amplitudes first, then shapes, then refinements."""
        fields = dataclasses.fields(cls)  # type: ignore[arg-type]  # its sub-classes are dataclasses
        found = [EffectParameter(name=field.name, **field.metadata) for field in fields]
        return tuple(sorted(found, key=lambda p: list(ParameterRole).index(p.role)))


_ROLES = "declared without a role: expected amplitude(...), shape(...) or refinement(...)"

Curve = Annotated[np.ndarray[Any, np.dtype[np.floating[Any]]], Shape(("m",))]


class LossHistory(ArrayModel):
    """Copper loss over the whole experiment, coarsely sampled; what was not captured is estimated."""

    time_s: Curve
    """Since the start of the experiment, increasing, shape (m,)."""
    power_w: Curve
    """Mean loss from this instant to the next, shape (m,)."""
    captured: Curve | None = None
    """1 where it was measured, 0 where it is assumed, shape (m,); None: measured throughout."""


@dataclass(frozen=True)
class Correction:
    """What an effect changes of the signals, as new arrays of the same shape; None: unchanged."""

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
        """What is changed, by its name."""
        return {name: array for name, array in vars(self).items() if array is not None}


class Signals(ArrayModel):
    """One segment as an effect sees it, each quantity at its current best; time first.

    Starts as what was measured and commanded; what effects return is put in its place.
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
    """The same without the current's noise: fast changes from the voltage, slow ones from the model [Wb]."""
    i_smooth_ab: Vectors | None = None
    """The stator current that belongs to the smooth flux [A]."""
    i_quiet_ab: Vectors | None = None
    """The stator current as a hold's readings tell it without their noise [A], for what bends within it; else None."""
    i_abc: Phases | None = None
    """Phase currents as the sensors read them [A], where the recording holds them; no effect changes them."""
    clarke_of_three: bool | None = None
    """Whether the vector was made of three readings (else of a and b); None where the recording does not tell."""
    temperature_c: Samples | None = None
    """As logged, where the drive has a thermometer."""
    start_temperature_c: float | None = None
    """The first one that was logged in the experiment."""
    came_from_ab: Vectors | None = None
    """Where the stator current was on its way to where the segment begins, oldest first, (points, 2) [A]; None: not
    known."""
    losses: LossHistory | None = None
    motor: Motor | None = None
    """The nameplate."""
    drive: DriveRecord | None = None
    bridge_on: bool = True
    """False while all gates are off: then no voltage is commanded and none is impressed."""

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
        if "i_ab" not in arrays:
            return arrays
        moved = arrays["i_ab"] - self.i_ab
        changed = {"i_m_ab": self.i_m_ab + moved, **arrays}
        if self.i_quiet_ab is not None:
            changed["i_quiet_ab"] = self.i_quiet_ab + moved
        return changed

    def replaced(self, arrays: Mapping[str, RealArray]) -> Signals:
        """These signals with other arrays of the same shapes in the place of some, by their names.

        Nothing is checked: a diagnosis does it half a million times, and pydantic's own copy takes ten times as long.
        """
        other = object.__new__(type(self))
        object.__setattr__(other, "__dict__", {**self.__dict__, **arrays})
        for name in ("__pydantic_fields_set__", "__pydantic_extra__", "__pydantic_private__"):
            object.__setattr__(other, name, getattr(self, name))
        return other


@runtime_checkable
class Effect(Protocol):
    """A candidate for what the model lacks.

    One that shows only in some recordings says so by a method ``shows_in(signals) -> bool``: where it is true of no
    segment, a diagnosis does not look for the effect, which then costs nothing. One that readings prove, whatever the
    motor is, says it by ``measured(segments) -> EffectParameters | None``: a diagnosis then begins with it. One whose
    parameters say more than a size says that by ``remarks(parameters) -> Sequence[Remark]`` where it is named. One that
    cannot know all of what it does, such as what iron remembers of before a segment, says it by
    ``doubts(signals, parameters) -> Sequence[Correction]``: each is what a standard deviation of that would change, and
    noise of that form is expected in the segment.

    A diagnosis evaluates an effect on many segments at once. One that can do that in a single call says so by
    ``correct_batch(batch, parameters) -> Correction`` of a `SignalBatch`, and for what it cannot know by
    ``doubts_batch(batch, parameters) -> Sequence[Correction]``, each of which changes every segment by its own; any
    other is asked segment by segment.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    """One sentence: what it is."""
    signature: ClassVar[str]
    """One sentence: what it does to the residual."""
    layer: ClassVar[EffectLayer]
    needs: ClassVar[tuple[Contrast, ...]]
    """Contrasts without which it cannot be told from an effect that needs the same one; mostly none."""
    gauge: ClassVar[str]
    """What no measurement of this kind can show, said wherever the effect is named; empty where nothing."""

    @property
    def Parameters(self) -> type[EffectParameters]:
        """The effect's own class of parameters, mostly nested in it."""
        ...

    def correct(self, signals: Signals, parameters: Any, /) -> Correction:
        """What becomes of the signals when this effect is accounted for.

        Asked only where the effect is there: where an amplitude is not neutral and, beyond the current sensors, the
        bridge is on. The nearer to neutral, the less is changed. The signals are not to be written to.

        Parameters
        ----------
        signals : Signals
        parameters : EffectParameters
            Of the effect's own class.
        """
        ...
