"""Units of a mapping as factors to SI, and a search for the unit that makes a value plausible."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

CurrentUnit = Literal["A", "mA", "uA", "kA"]
VoltageUnit = Literal["V", "mV", "uV", "kV", "duty", "duty_percent"]
TimeUnit = Literal["s", "ms", "us", "ns", "min", "day", "tick", "iso"]
AngleUnit = Literal["rad", "deg", "turn"]
TemperatureUnit = Literal["degC", "K"]

FACTORS: Mapping[str, float] = MappingProxyType(
    {
        **{"A": 1.0, "mA": 1e-3, "uA": 1e-6, "kA": 1e3},
        **{"V": 1.0, "mV": 1e-3, "uV": 1e-6, "kV": 1e3, "duty": 1.0, "duty_percent": 1e-2},
        **{"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "day": 86400.0, "iso": 1.0},
        **{"rad": 1.0, "deg": math.pi / 180.0, "turn": 2.0 * math.pi},
        **{"degC": 1.0, "K": 1.0},
        **{"Hz": 1.0, "kHz": 1e3},
    }
)
"""Factor from each unit to SI; for duties, to the bus voltage."""

ZERO_CELSIUS_K = 273.15

_FAMILIES = (("A", "mA", "uA", "kA"), ("V", "mV", "uV", "kV"), ("duty", "duty_percent"), ("s", "ms", "us", "ns", "min"))


def unit_that_fits(labelled: str, value: float, low: float, high: float) -> str | None:
    """The unit in which `value` (read as `labelled`, in SI) lies between `low` and `high`; None where none does.

    Of several units, the result is nearest the middle of the range on a logarithmic scale.
    """
    family = next((units for units in _FAMILIES if labelled in units), ())
    read_as = {unit: value * FACTORS[unit] / FACTORS[labelled] for unit in family if unit != labelled}
    fitting = [unit for unit, reading in read_as.items() if low <= reading <= high]
    middle = math.sqrt(low * high)
    return min(fitting, key=lambda unit: abs(math.log(read_as[unit] / middle)), default=None)
