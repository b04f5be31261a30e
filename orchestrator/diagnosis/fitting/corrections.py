"""Effects applied to signals, from the sensors inwards; what each of them returns is checked, not copied."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestrator.diagnosis.fitting.candidates import Active
from protocols import Correction, EffectLayer, FluxbenchError, PluginError, RealArray, Signals


@dataclass(frozen=True)
class Corrected:
    """Signals with some effects accounted for.

    Attributes
    ----------
    signals : Signals
    changed : frozenset of str
        Names of those arrays that these effects changed.
    """

    signals: Signals
    changed: frozenset[str] = frozenset()


def apply_effects(signals: Signals, active: Sequence[Active]) -> Corrected:
    """The signals with all effects accounted for that are there.

    Raises
    ------
    PluginError
        Where an effect raises, or returns what signals cannot be.
    """
    changed: set[str] = set()
    for item in sorted(active, key=lambda a: a.candidate.effect.layer):
        one = apply_effect(signals, item)
        changed |= one.changed
        signals = one.signals
    return Corrected(signals, frozenset(changed))


def apply_effect(signals: Signals, item: Active) -> Corrected:
    """The signals with one effect accounted for if it is there; with the bridge off nothing is but what sensors do.

    Raises
    ------
    PluginError
        As `apply_effects`.
    """
    if item.is_absent or not (signals.bridge_on or item.candidate.effect.layer is EffectLayer.CURRENT_SENSORS):
        return Corrected(signals)
    return _applied(item, "correct", signals, _said(item, "correct", signals))


def is_doubtful(item: Active) -> bool:
    """Whether an effect that is there says what it cannot know."""
    return not item.is_absent and hasattr(item.candidate.effect, "doubts")


def doubts_of(item: Active, signals: Signals) -> list[Corrected]:
    """The signals with one standard deviation of each thing that an effect cannot know of a segment.

    Raises
    ------
    PluginError
        Where the effect raises, or returns what signals cannot be.
    """
    if not (signals.bridge_on and is_doubtful(item)):
        return []
    found = _said(item, "doubts", signals)
    if not isinstance(found, Sequence):
        raise PluginError("effects", item.name, f"doubts: returned {type(found).__name__} instead of a sequence")
    return [_applied(item, "doubts", signals, doubt) for doubt in found]


def _said(item: Active, method: str, signals: Signals) -> Any:
    try:
        return getattr(item.candidate.effect, method)(signals, item.parameters)
    except FluxbenchError:
        raise
    except (Exception, SystemExit) as error:  # somebody else's code may raise anything
        raise PluginError("effects", item.name, f"{method}: {type(error).__name__}: {error}") from error


def _applied(item: Active, method: str, signals: Signals, correction: object) -> Corrected:
    """The signals with what a method of an effect returned, which is checked."""
    if not isinstance(correction, Correction):
        returned = type(correction).__name__
        raise PluginError("effects", item.name, f"{method}: returned {returned} instead of a Correction")
    arrays = correction.arrays
    for name, array in arrays.items():
        before = getattr(signals, name)
        _require_array(item.name, f"{method}: {name}", signals.v_ab if before is None else before, array)
    changed = signals.changed_along(arrays)
    return Corrected(signals.replaced(changed), frozenset(changed))


def _require_array(effect: str, name: str, before: RealArray, now: object) -> None:
    shape = getattr(now, "shape", None)
    if not isinstance(now, np.ndarray) or shape != before.shape:
        raise PluginError("effects", effect, f"{name} has shape {shape}, not {before.shape}")
    if now.dtype.kind != "f":
        raise PluginError("effects", effect, f"{name} is of type {now.dtype}, not float64")
    # What is finite has a finite sum of squares, unless it is beyond all bounds: then each number is asked.
    if not math.isfinite(np.vdot(now, now)) and not np.isfinite(now).all():
        raise PluginError("effects", effect, f"{name} is not finite")
