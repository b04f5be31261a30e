"""Effects that somebody brings along in a file: held to their metadata, and kept from the recording's own arrays.

What is installed has passed its conformance kit; a file just written has not. Its effect sees the signals through
views that cannot be written to, and of what it returns only what an effect may change is taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from protocols import Effect, EffectLayer, EffectParameter, LossHistory, ParameterRole, PluginError, Signals

Array = NDArray[np.floating[Any]]

CHANGEABLE = ("i_ab", "v_ab", "v_dc", "theta_rad", "resistance_ohm", "i_m_ab")
"""What an effect may change of its signals."""
_SEEN = (*CHANGEABLE, "heat_j", "psi_ab", "psi_smooth_ab", "i_smooth_ab")


def guarded(effect: Effect) -> Effect:
    """The effect behind views that cannot be written to; in everything else it is the effect itself.

    Raises
    ------
    PluginError
        Where the effect's metadata cannot be fitted.
    """
    require_effect(effect)
    return cast(Effect, _Guarded(effect))


class _Guarded:
    def __init__(self, effect: Effect) -> None:
        self._effect = effect

    def __getattr__(self, name: str) -> Any:
        return getattr(self._effect, name)

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """As the effect does it.

        Raises
        ------
        PluginError
            Where it writes into what it was given, or returns no signals.
        """
        seen = _sealed(signals)
        try:
            after = self._effect.correct(seen, MappingProxyType(dict(values)))
        except ValueError as error:
            if "read-only" not in str(error):
                raise
            told = "writes into the signals it was given; return signals.model_copy(update=...) with new arrays"
            raise PluginError("effects", self._effect.name, f"correct: {told}") from error
        if not isinstance(after, Signals):
            raise PluginError("effects", self._effect.name, f"correct: returned {type(after).__name__}, not Signals")
        changed = {n: getattr(after, n) for n in CHANGEABLE if getattr(after, n) is not getattr(seen, n)}
        return signals.model_copy(update={n: _own(x) for n, x in changed.items()}) if changed else signals


def _sealed(signals: Signals) -> Signals:
    """The same arrays, not to be written to; one and the same array stays one."""
    views: dict[int, Array] = {}

    def view(array: Array) -> Array:
        if id(array) not in views:
            views[id(array)] = array.view()
            views[id(array)].flags.writeable = False
        return views[id(array)]

    found = {name: view(getattr(signals, name)) for name in _SEEN if getattr(signals, name) is not None}
    losses = signals.losses
    if losses is not None:
        names = [n for n in LossHistory.model_fields if getattr(losses, n) is not None]
        losses = losses.model_copy(update={n: view(getattr(losses, n)) for n in names})
    return signals.model_copy(update={**found, "losses": losses})


def _own(array: object) -> object:
    """As the kernels are compiled for: float64 without gaps, and writable; what is no array of numbers as it is."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        return array
    return np.require(array, np.float64, ("C", "W"))


def require_effect(effect: Effect) -> None:
    """Raise `PluginError` where an effect's metadata would make no sense to a fit."""
    name = effect.name
    if not isinstance(effect.layer, EffectLayer):
        raise PluginError("effects", name, f"layer: expected an EffectLayer, got {effect.layer!r}"[:120])
    wrong = [p for p in effect.parameters if not isinstance(p, EffectParameter)]
    if wrong:
        raise PluginError("effects", name, f"parameters: expected EffectParameter, got {type(wrong[0]).__name__}")
    names = [p.name for p in effect.parameters]
    if len(set(names)) < len(names):
        raise PluginError("effects", name, f"parameters: names repeat: {', '.join(names)}")
    if not any(p.role is ParameterRole.AMPLITUDE for p in effect.parameters):
        raise PluginError("effects", name, "parameters: none has the role of an amplitude: there is nothing to fit")
    for parameter in effect.parameters:
        problem = _problem_of(parameter)
        if problem is not None:
            raise PluginError("effects", name, f"parameters: {parameter.name}: {problem}")


def _problem_of(p: EffectParameter) -> str | None:
    numbers = {n: getattr(p, n) for n in ("low", "high", "neutral", "typical", "prior_width")}
    for name, value in numbers.items():
        if not math.isfinite(value):
            return f"{name} is {value}"
    if not p.low < p.high:
        return f"low {p.low:g} is not below high {p.high:g}"
    for name in ("neutral", "typical"):
        if not p.low <= numbers[name] <= p.high:
            return f"{name} {numbers[name]:g} is not between low {p.low:g} and high {p.high:g}"
    if p.prior_width <= 0.0:
        return f"prior_width {p.prior_width:g} is not positive"
    if p.role is ParameterRole.SHAPE and p.low <= 0.0:
        return f"low {p.low:g} of a shape is not positive"
    if p.role is ParameterRole.AMPLITUDE and (p.typical == p.neutral or p.typical == 0.0):
        return f"typical {p.typical:g} of an amplitude is zero, or its neutral value: it has no size"
    return None
