"""Effects: physical imperfections that a model may lack, as the diagnosis tries them one by one.

An effect turns what the drive believes into what the motor felt: sensor readings into stator
current, commanded voltage into impressed voltage, believed angle into the true one. It is a pure
function of a recording's signals; entry point group ``fluxbench.effects``.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Protocol, dataclass_transform, runtime_checkable

from protocols._errors import PluginError
from protocols._recording import DriveRecord
from protocols._remarks import Remark
from protocols._signal_batch import SignalBatch
from protocols._signals import Correction, Signals


class EffectLayer(IntEnum):
    """Where an effect acts; effects are applied in this order, from the sensors inwards."""

    CURRENT_SENSORS = 1
    DELAY = 2
    BUS = 3
    INVERTER = 4
    RESISTANCE = 5
    FRAME = 6
    IRON = 7


LAYER_CHANGES: Mapping[EffectLayer, frozenset[str]] = MappingProxyType(
    {
        EffectLayer.CURRENT_SENSORS: frozenset({"i_ab"}),
        EffectLayer.DELAY: frozenset({"v_ab", "v_late_ab"}),
        EffectLayer.BUS: frozenset({"v_dc", "v_ab"}),
        EffectLayer.INVERTER: frozenset({"v_ab"}),
        EffectLayer.RESISTANCE: frozenset({"resistance_ohm", "v_ab"}),
        EffectLayer.FRAME: frozenset({"theta_rad"}),
        EffectLayer.IRON: frozenset({"i_m_ab", "v_ab"}),
    }
)
"""What an effect of a layer can be about; the layers beyond it see what it has changed."""


class Contrast(StrEnum):
    """Additional content of a recording that separates similar effects."""

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
    """A direct current held long enough to warm the winding."""


class ParameterRole(StrEnum):
    """Role of a parameter in its effect; the diagnosis frees them in this order."""

    AMPLITUDE = "amplitude"
    """Alone decides whether the effect is there: nothing happens while all amplitudes are neutral."""
    SHAPE = "shape"
    """Says how the amplitude acts; has no effect of its own, and is positive (fitted as a logit within its bounds)."""
    REFINEMENT = "refinement"
    """Makes the effect's form more flexible; neutral is the simple form."""


SCALED_UNITS = ("A", "V", "ohm", "Wb", "H", "W", "Nm")
"""Units of quantities that grow with the machine: the diagnosis scales such a parameter by the nameplate."""
PLAIN_UNITS = ("1", "s", "Hz", "rad", "K")
"""Units of quantities that do not scale with the machine."""

_PREFIXES = {"n": "1e-9", "u": "1e-6", "µ": "1e-6", "m": "1e-3", "k": "1e3", "M": "1e6"}


def _without_prefix(unit: str, known: tuple[str, ...]) -> str:
    """What to write for a known unit behind a prefix, such as ``us``; empty for any other."""
    prefix, plain = unit[:1], unit[1:]
    return f"write {plain}, and {_PREFIXES[prefix]} in the sizes" if prefix in _PREFIXES and plain in known else ""


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
        expected = f"expected a product or quotient of {', '.join(known)}"
        if hint := _without_prefix(unit, known):
            expected += f"; {hint}"
        raise ValueError(f"unit {unit!r} cannot be scaled to a machine; {expected}")
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
    """Standard deviation of the prior about zero effect; for a shape, that of its logit about the typical value."""
    low: float
    high: float
    neutral: float
    """The value at which the effect is absent (may be infinite in principle; then the bound)."""
    strong_when_small: bool = False
    """Relative size is typical / value instead of value / typical."""
    role: ParameterRole = ParameterRole.AMPLITUDE
    other_form: float | None = None
    """Alternative start of a refinement or a shape: a second form, so unlike the first that a fit begins at both."""
    detail: bool = False
    """Whether the search tries this refinement after all others, because it can imitate them."""

    def problem(self) -> str | None:
        """Reason why a declaration cannot be fitted, in a few words; None where it can."""
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
        parameters = [EffectParameter(name=field.name, **field.metadata) for field in fields]
        return tuple(sorted(parameters, key=lambda p: list(ParameterRole).index(p.role)))


_ROLES = "declared without a role: expected amplitude(...), shape(...) or refinement(...)"


@runtime_checkable
class Effect(Protocol):
    """A candidate for what the model lacks.

    What is below is required. An effect may have any of the methods in `EFFECT_HOOKS` besides; a public method that is
    neither is refused when the effect is loaded, for it would never be called.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    """One sentence that describes the effect."""
    signature: ClassVar[str]
    """One sentence on its pattern in the residual."""
    layer: ClassVar[EffectLayer]
    needs: ClassVar[tuple[Contrast, ...]]
    """Contrasts that separate it from another effect which needs the same one; mostly none."""
    gauge: ClassVar[str]
    """Ambiguity that no measurement of this kind resolves; reports that name the effect print it. Empty: none."""

    @property
    def Parameters(self) -> type[EffectParameters]:
        """The effect's own class of parameters, mostly nested in it."""
        ...

    def correct(self, signals: Signals, parameters: Any, /) -> Correction:
        """Change of the signals when this effect is accounted for.

        Asked only where the effect is there: where an amplitude is not neutral and, beyond the current sensors, the
        bridge is on. The nearer to neutral, the less is changed. The signals are not to be written to.

        Parameters
        ----------
        signals : Signals
        parameters : EffectParameters
            Instance of the effect's own class.
        """
        ...


class SegmentDependentEffect(Protocol):
    """An effect that only some recordings can show, such as one that needs a thermometer's readings."""

    def shows_in(self, signals: Signals, /) -> bool:
        """Whether a segment can show the effect.

        Called once for each segment before the search. Where it is true of no segment, a diagnosis leaves the effect
        out, which then costs nothing.

        Parameters
        ----------
        signals : Signals
            As measured, without any effect accounted for.
        """
        ...


class MeasurableEffect(Protocol):
    """An effect that the readings alone establish, whatever the motor is, such as unequal sensor gains."""

    def measured(self, segments: Sequence[Signals], /) -> EffectParameters | None:
        """The parameters that the readings give, or None where they do not tell.

        Called once, before the search, which then includes the effect from the start if that improves the fit.

        Parameters
        ----------
        segments : sequence of Signals
            All segments of the recording, as measured.

        Returns
        -------
        EffectParameters or None
            Instance of the effect's own class, in SI; only the amplitudes are read.
        """
        ...


class RemarkingEffect(Protocol):
    """An effect whose parameters tell an engineer more than a size, such as which leg of the inverter it is."""

    def remarks(self, parameters: Any, /) -> Sequence[Remark]:
        """Remarks that are shown where the effect is reported as a cause.

        Parameters
        ----------
        parameters : EffectParameters
            Fitted values, of the effect's own class.
        """
        ...


class DriveQuantitiesEffect(Protocol):
    """An effect whose parameters are, with the drive's data, quantities of a data sheet, such as a dead time."""

    def derived(self, parameters: Any, drive: DriveRecord, /) -> Mapping[str, tuple[float, str]]:
        """Values in SI and their units, by names with underscores; shown beside the parameters.

        Called for the fitted parameters and for the ends of their intervals.

        Parameters
        ----------
        parameters : EffectParameters
            Instance of the effect's own class.
        drive : DriveRecord
            The recording's drive; its PWM frequency may be unknown.
        """
        ...


class RandomDirectionsEffect(Protocol):
    """An effect that cannot know all of what it does, such as what iron remembers of before a segment."""

    def random_directions(self, signals: Signals, parameters: Any, /) -> Sequence[Correction]:
        """Random directions: what one standard deviation of each unknown quantity would change of a segment.

        Called wherever `Effect.correct` is, with the bridge on. The segment is expected to have noise of these forms;
        the unknown quantities are independent of each other, and of those of other segments.

        Parameters
        ----------
        signals : Signals
        parameters : EffectParameters
            Instance of the effect's own class.

        Returns
        -------
        sequence of Correction
            One for each unknown quantity, with arrays of the same shapes and units as in `signals`.
        """
        ...


class BatchEffect(Protocol):
    """An effect that is evaluated on many segments in a single call; any other is called segment by segment."""

    def correct_batch(self, batch: SignalBatch, parameters: Any, /) -> Correction:
        """What `Effect.correct` returns of each segment, laid end to end.

        Called in its place in every iteration of a fit. No segment may depend on its neighbours in the batch.

        Parameters
        ----------
        batch : SignalBatch
            N samples in all; those of segment k are `batch.slice_of(k)`.
        parameters : EffectParameters
            Instance of the effect's own class.

        Returns
        -------
        Correction
            With arrays of the batch's shapes, (N,) or (N, 2), and units.
        """
        ...


class RandomDirectionsBatchEffect(Protocol):
    """A `RandomDirectionsEffect` that is evaluated on many segments in a single call."""

    def random_directions_batch(self, batch: SignalBatch, parameters: Any, /) -> Sequence[Correction]:
        """What `RandomDirectionsEffect.random_directions` returns of each segment, laid end to end.

        Called in its place. Each correction changes every segment by that segment's own standard deviation.

        Parameters
        ----------
        batch : SignalBatch
            N samples in all; those of segment k are `batch.slice_of(k)`.
        parameters : EffectParameters
            Instance of the effect's own class.

        Returns
        -------
        sequence of Correction
            One for each unknown quantity of a segment, with arrays of the batch's shapes, (N,) or (N, 2), and units.
        """
        ...


EffectHook = Literal[
    "shows_in", "measured", "remarks", "derived", "random_directions", "correct_batch", "random_directions_batch"
]
"""The name of a method that an effect may have."""

EFFECT_HOOKS: Mapping[EffectHook, type] = MappingProxyType(
    {
        "shows_in": SegmentDependentEffect,
        "measured": MeasurableEffect,
        "remarks": RemarkingEffect,
        "derived": DriveQuantitiesEffect,
        "random_directions": RandomDirectionsEffect,
        "correct_batch": BatchEffect,
        "random_directions_batch": RandomDirectionsBatchEffect,
    }
)
"""Every method that an effect may have, and the protocol that declares it."""


FORMER_HOOKS: Mapping[str, EffectHook] = MappingProxyType(
    {"doubts": "random_directions", "doubts_batch": "random_directions_batch"}
)
"""Former names of such methods, which effects may go on using, and today's."""


def is_compensable(effect: Effect | type[Effect]) -> bool:
    """Whether a drive can take an effect out of its readings and commands.

    It can for what acts in the drive itself: sensors, delays, the bus, the inverter. An effect on another layer that it
    can take out too, such as a wrong rotor angle, has `compensable = True`.
    """
    return bool(getattr(effect, "compensable", effect.layer <= EffectLayer.INVERTER))


def hook_of(effect: Effect, hook: EffectHook) -> Callable[..., Any] | None:
    """The effect's own method of this name, or of its former name; None where it has neither."""
    names = (hook, *(former for former, today in FORMER_HOOKS.items() if today == hook))
    return next((method for name in names if (method := getattr(effect, name, None)) is not None), None)
