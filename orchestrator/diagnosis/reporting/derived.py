"""An effect's parameters as quantities of a drive's data sheet, with their intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping

from orchestrator.diagnosis.fitting.candidates import EffectTerm
from protocols import DriveRecord, ParameterValue, PluginError, hook_of


def derived_quantities(
    active: EffectTerm, parameters: Mapping[str, ParameterValue], drive: DriveRecord
) -> dict[str, ParameterValue]:
    """What the effect makes of its parameters and the drive's data; empty where it has nothing to say.

    Each interval follows from the parameters' own, moved to their ends one at a time and added as squares:
    correlations between them are left out.

    Raises
    ------
    PluginError
        Where the effect's own code fails.
    """
    hook = hook_of(active.candidate.effect, "derived")
    if hook is None:
        return {}

    def at(values: Mapping[str, float]) -> Mapping[str, tuple[float, str]]:
        try:
            return dict(hook(active.candidate.effect.Parameters(**values), drive))
        except Exception as error:  # somebody else's code may raise anything
            raise PluginError("effects", active.name, f"derived: {type(error).__name__}: {error}") from error

    middle = at(active.values)
    below, above = dict.fromkeys(middle, 0.0), dict.fromkeys(middle, 0.0)
    for parameter, interval in parameters.items():
        for end in (interval.low, interval.high):
            if end is None:
                continue
            moved = at({**active.values, parameter: end})
            for name, (value, _) in middle.items():
                change = moved.get(name, (value, ""))[0] - value
                side = below if change < 0.0 else above
                side[name] = math.hypot(side[name], change)
    return {
        name: ParameterValue(value=value, low=value - below[name], high=value + above[name], unit=unit)
        for name, (value, unit) in middle.items()
    }
