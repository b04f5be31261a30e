"""Effects that somebody brings along in a file are kept from the recording's own arrays.

What is installed has passed its conformance kit; a file just written has not. Its effect sees the signals through
views that cannot be written to.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from protocols import (
    Contrast,
    Correction,
    Effect,
    EffectLayer,
    EffectParameters,
    LossHistory,
    ParameterRole,
    PluginError,
    RealArray,
    Signals,
)


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

    def correct(self, signals: Signals, parameters: EffectParameters) -> Correction:
        """As the effect does it.

        Raises
        ------
        PluginError
            Where it writes into what it was given, or returns no correction.
        """
        try:
            found: object = self._effect.correct(_sealed(signals), parameters)
        except ValueError as error:
            if "read-only" not in str(error):
                raise
            told = "writes into the signals it was given; return a Correction with new arrays"
            raise PluginError("effects", self._effect.name, f"correct: {told}") from error
        if not isinstance(found, Correction):
            raise PluginError("effects", self._effect.name, f"correct: returned {type(found).__name__}, no Correction")
        return Correction(**{name: _own(array) for name, array in found.arrays.items()})


def _sealed(signals: Signals) -> Signals:
    """The same arrays, not to be written to."""
    losses = signals.losses
    return signals.model_copy(update={**_views(signals), "losses": losses and losses.model_copy(update=_views(losses))})


def _views(of: Signals | LossHistory) -> dict[str, RealArray]:
    arrays = {name: getattr(of, name) for name in type(of).model_fields}
    views = {name: array.view() for name, array in arrays.items() if isinstance(array, np.ndarray)}
    for view in views.values():
        view.flags.writeable = False
    return views


def _own(array: Any) -> Any:
    """As the kernels are compiled for: float64 without gaps, and writable; what is no array of numbers as it is."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        return array
    return np.require(array, np.float64, ("C", "W"))


def require_effect(effect: Effect) -> None:
    """Raise `PluginError` where an effect's metadata would make no sense to a fit."""
    name = effect.name
    if not isinstance(effect.layer, EffectLayer):
        raise PluginError("effects", name, f"layer: expected an EffectLayer, got {effect.layer!r}"[:120])
    for need in effect.needs:
        if not isinstance(need, Contrast):
            raise PluginError("effects", name, f"needs: expected a Contrast, got {need!r}"[:120])
    if not any(p.role is ParameterRole.AMPLITUDE for p in effect.Parameters.declared()):
        raise PluginError("effects", name, "Parameters: none has the role of an amplitude: there is nothing to fit")
