"""Effects applied to signals, from the sensors inwards; what each of them returns is checked, not copied."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

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
        sensors = item.candidate.effect.layer is EffectLayer.CURRENT_SENSORS
        if item.is_absent or not (signals.bridge_on or sensors):
            continue
        correction = _correction(item, signals)
        arrays = correction.arrays
        for name, array in arrays.items():
            before = getattr(signals, name)
            _require_array(item.name, name, signals.v_ab if before is None else before, array)
        changed |= arrays.keys()
        if "i_ab" in arrays:
            changed |= {"i_m_ab"} if signals.i_quiet_ab is None else {"i_m_ab", "i_quiet_ab"}
        signals = signals.corrected(correction)
    return Corrected(signals, frozenset(changed))


def _correction(item: Active, signals: Signals) -> Correction:
    try:
        found: object = item.candidate.effect.correct(signals, item.parameters)
    except FluxbenchError:
        raise
    except (Exception, SystemExit) as error:  # somebody else's code may raise anything
        raise PluginError("effects", item.name, f"correct: {type(error).__name__}: {error}") from error
    if not isinstance(found, Correction):
        raise PluginError("effects", item.name, f"correct: returned {type(found).__name__} instead of a Correction")
    return found


def _require_array(effect: str, name: str, before: RealArray, now: object) -> None:
    shape = getattr(now, "shape", None)
    if not isinstance(now, np.ndarray) or shape != before.shape:
        raise PluginError("effects", effect, f"correct: {name} has shape {shape}, not {before.shape}")
    if now.dtype.kind != "f":
        raise PluginError("effects", effect, f"correct: {name} is of type {now.dtype}, not float64")
    # What is finite adds up to something finite, unless it is beyond all bounds: then each number is asked.
    if not math.isfinite(now.sum()) and not np.isfinite(now).all():
        raise PluginError("effects", effect, f"correct: {name} is not finite")
