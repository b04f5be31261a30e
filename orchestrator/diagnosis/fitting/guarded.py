"""Protection of a recording's arrays from effects loaded from a user's file.

Installed effects have passed the conformance kit; one from a user's file gets read-only views of the signals.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any, cast

import numpy as np

from orchestrator.registry.plugin_methods import hook_problem
from protocols import (
    FORMER_HOOKS,
    Contrast,
    Correction,
    Effect,
    EffectLayer,
    EffectParameters,
    LossHistory,
    ParameterRole,
    PluginError,
    RealArray,
    SignalBatch,
    Signals,
)


def guarded(effect: Effect) -> Effect:
    """The effect, called with read-only views of the signals; otherwise unchanged.

    Raises
    ------
    PluginError
        If the effect's metadata cannot be fitted.
    """
    require_effect(effect)
    return cast(Effect, _Guarded(effect))


class _Guarded:
    """Proxy of an effect whose methods get read-only signals; attributes it lacks are missing here too."""

    def __init__(self, effect: Effect) -> None:
        self._effect = effect

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._effect, name)
        return partial(self._call, name, found) if name in _READS_SIGNALS else found

    def _call(self, name: str, method: Callable[..., object], signals: Any, *parameters: EffectParameters) -> Any:
        """Call the effect's method with read-only signals; raises `PluginError` on writing or without a correction."""
        try:
            found = method(_sealed(signals), *parameters)
        except ValueError as error:
            if "read-only" not in str(error):
                raise
            message = "writes into the signals it was given; return a Correction with new arrays"
            raise PluginError("effects", self._effect.name, f"{name}: {message}") from error
        if name in _RETURNS_CORRECTION:
            return self._owned(name, found)
        if name in _RETURNS_CORRECTIONS:
            if not isinstance(found, Sequence):
                problem = f"{name}: returned {type(found).__name__} instead of a sequence"
                raise PluginError("effects", self._effect.name, problem + method_source(self._effect, name))
            return [self._owned(name, one) for one in found]
        return found

    def _owned(self, name: str, found: object) -> Correction:
        if not isinstance(found, Correction):
            problem = f"{name}: returned {type(found).__name__}, no Correction"
            raise PluginError("effects", self._effect.name, problem + method_source(self._effect, name))
        return Correction(**{of: _kernel_array(array) for of, array in found.arrays.items()})


_RETURNS_CORRECTION = ("correct", "correct_batch")
_RETURNS_CORRECTIONS = (*FORMER_HOOKS, *FORMER_HOOKS.values())
_READS_SIGNALS = (*_RETURNS_CORRECTION, *_RETURNS_CORRECTIONS, "shows_in", "measured")


def _sealed(signals: Signals | SignalBatch | Sequence[Signals]) -> Signals | SignalBatch | list[Signals]:
    """The signals with read-only arrays."""
    if isinstance(signals, SignalBatch):
        return signals.with_segments(_all_sealed(signals.segments)).replaced(_views(signals))
    if isinstance(signals, Signals):
        return _all_sealed([signals])[0]
    return _all_sealed(signals)


def _all_sealed(segments: Sequence[Signals]) -> list[Signals]:
    """Each segment with read-only arrays; segments that share a loss history share the read-only one."""
    histories = {id(s.losses): s.losses for s in segments}
    sealed = {k: h and replace(h, **_views(h)) for k, h in histories.items()}
    return [replace(s.replaced(_views(s)), losses=sealed[id(s.losses)]) for s in segments]


def _views(holder: Signals | SignalBatch | LossHistory) -> dict[str, RealArray]:
    """Read-only views of the fields that are arrays."""
    values = {field.name: getattr(holder, field.name) for field in fields(holder)}
    views = {name: array.view() for name, array in values.items() if isinstance(array, np.ndarray)}
    for view in views.values():
        view.flags.writeable = False
    return views


def _kernel_array(array: Any) -> Any:
    """A contiguous, writable float64 array as kernels expect; anything but a numeric array is returned unchanged."""
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        return array
    return np.require(array, np.float64, ("C", "W"))


def is_own(effect: object) -> bool:
    """Whether an effect was given beside the installed ones."""
    return isinstance(effect, _Guarded)


def method_source(effect: object, *names: str) -> str:
    """Where the first of these methods that an effect has begins: `` (mine.py, line 12)``; empty without a source."""
    own = effect._effect if isinstance(effect, _Guarded) else effect
    methods = (getattr(type(own), name, None) for name in names)
    codes = (getattr(method, "__code__", None) for method in methods)
    return next((f" ({code.co_filename}, line {code.co_firstlineno})" for code in codes if code is not None), "")


def source_file(effect: object) -> str | None:
    """The Python file that an effect is from, as it was given; None where it is installed, or has no file."""
    if not isinstance(effect, _Guarded):
        return None
    return getattr(sys.modules.get(type(effect._effect).__module__), "__file__", None)


def require_effect(effect: Effect) -> None:
    """Raise `PluginError` where an effect's metadata cannot be fitted, or one of its methods would never be called."""
    name = effect.name
    problem = hook_problem(type(effect))
    if problem is not None:
        raise PluginError("effects", name, problem)
    if not isinstance(effect.layer, EffectLayer):
        raise PluginError("effects", name, f"layer: expected an EffectLayer, got {effect.layer!r}"[:120])
    for need in effect.needs:
        if not isinstance(need, Contrast):
            raise PluginError("effects", name, f"needs: expected a Contrast, got {need!r}"[:120])
    if not any(p.role is ParameterRole.AMPLITUDE for p in effect.Parameters.declared()):
        raise PluginError("effects", name, "Parameters: none has the role of an amplitude: there is nothing to fit")
