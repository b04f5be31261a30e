"""Numbers as an engineer reads them: SI prefixes, as many digits as the uncertainty bears, no exponent's letter.

An interval and what stands beside it have one prefix and one number of digits, so that they are compared at a glance:
``20.00 mΩ (95 %: 19.98 to 20.02)``. What is not known is a dash.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command line's help has no time for it
    from protocols import AxisPercent

UNKNOWN = "–"
_SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
_NEXT_TO = 1e-6
_GREATEST = {"V": 3, "A": 3, "Ω": 6, "H": 0, "Wb": 0, "s": 0, "W": 6, "J": 6, "Hz": 6, "rad": 0, "Nm": 3, "C": 0}
"""Units that take a prefix, each with the power of ten of the greatest that is in use."""


def unit_words(unit: str) -> str:
    """A unit as it is printed: ohm as Ω, 1/A^2 as per A², 1 as nothing."""
    base, power, exponent = unit.replace("ohm", "Ω").partition("^")
    printed = base + (exponent.translate(_SUPERSCRIPT) if power else "")
    if printed == "1":
        return ""
    return f"per {printed[2:]}" if printed.startswith("1/") else printed


@dataclass(frozen=True)
class Scale:
    """A prefix and a number of decimals, for values of one quantity that stand beside each other.

    Attributes
    ----------
    power : int
        Values are printed in 10**power of the SI unit.
    decimals : int
        Digits after the point.
    unit : str
        As printed, its prefix or power of ten included; empty where there is none.
    """

    power: int
    decimals: int
    unit: str

    @classmethod
    def of(cls, value: float, low: float, high: float, unit: str) -> Scale:
        """The scale for a value and its interval: decimals down to the smaller distance of an end from the value.

        What is next to nothing beside its interval, or next to an end of it, is there.
        """
        largest = max(abs(low), abs(high))
        power, printed = _prefixed(value if abs(value) > _NEXT_TO * largest else largest, unit)
        least = min(value - low, high - value)
        least = least if least > _NEXT_TO * (high - low) else high - low
        # Beyond a thousandth of a thousandth, digits tell nothing to anybody.
        least = max(least, 1e-6 * max(abs(value), largest))
        digits = borne(least / 10.0**power) if least > 0.0 else 0
        return cls(power, digits, printed)

    def number(self, value: float | None) -> str:
        """The number alone."""
        return UNKNOWN if value is None else fixed(value / 10.0**self.power, self.decimals)

    def quantity(self, value: float | None) -> str:
        """The number with its unit."""
        return _with_unit(self.number(value), self.unit)


def value_and_interval(value: float | None, low: float | None, high: float | None, unit: str) -> tuple[str, str]:
    """A value with its unit and, on the same scale, its interval; that is empty where an end is missing."""
    if value is None or low is None or high is None:
        return quantity(value, unit, 4), ""
    scale = Scale.of(value, low, high, unit)
    return scale.quantity(value), f"{scale.number(low)} to {scale.number(high)}"


def measured(value: float | None, low: float | None, high: float | None, unit: str) -> str:
    """A value with its 95 % interval: ``20.00 mΩ (95 %: 19.98 to 20.02)``."""
    told, interval = value_and_interval(value, low, high, unit)
    return f"{told} (95 %: {interval})" if interval else told


def value_and_error(value: float, error: float, unit: str) -> tuple[str, str]:
    """A value with its unit and, on the same scale, its standard deviation."""
    if not error > 0.0:
        return quantity(value, unit, 5), UNKNOWN
    scale = Scale.of(value, value - error, value + error, unit)
    return scale.quantity(value), scale.number(error)


def with_error(value: float, error: float, power: int, most_decimals: int = 3) -> str:
    """A value and its 95 % uncertainty in 10**power of the unit, which stands at the head of the column."""
    scaled, beside = value / 10.0**power, error / 10.0**power
    if not 0.0 < beside < math.inf:
        return number(scaled)
    decimals = min(most_decimals, borne(beside))
    told = fixed(beside, decimals)
    return fixed(scaled, decimals) + (f" ± {told}" if float(told) else "")


def quantity(value: float | None, unit: str, digits: int = 3) -> str:
    """So many significant digits with the prefix that fits: 3.07 mV, 1.48 kV, 25 µs."""
    if value is None:
        return UNKNOWN
    power, printed = _prefixed(value, unit, digits)
    return _with_unit(number(value / 10.0**power, digits), printed)


def number(value: float | None, digits: int = 4) -> str:
    """So many significant digits, more where they stand before the point; a power of ten where it takes one."""
    if value is None:
        return UNKNOWN
    size = abs(value)
    if size and not 1e-4 <= size < 1e7:
        mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
        return f"{_minus(_trimmed(mantissa))}·10{str(int(power)).translate(_SUPERSCRIPT)}"
    return _minus(_trimmed(f"{value + 0.0:.{decimals_of(value, digits)}f}"))


def fixed(value: float, decimals: int) -> str:
    """So many digits after the point, and no minus before a zero."""
    return _minus(f"{round(value, decimals) + 0.0:.{decimals}f}")


def borne(error: float) -> int:
    """Digits after the point that a number with this uncertainty bears: one of the uncertainty's own, two after a 1."""
    leading, _, power = f"{error:.1e}".partition("e")
    return max(0, -int(power) + leading.startswith("1"))


def decimals_of(value: float, digits: int) -> int:
    """Digits after the point of a number with so many significant ones."""
    if value == 0.0:
        return 0
    # Rounding comes first: 9.996 has as many digits as 10.
    return max(0, digits - 1 - int(f"{value:.{digits - 1}e}".partition("e")[2]))


def percent(value: float | None, digits: int = 2) -> str:
    """A figure in per cent; what is below a hundred-thousandth is nothing."""
    if value is None:
        return UNKNOWN
    return f"{number(value if abs(value) >= 1e-5 else 0.0, digits)} %"


def axes_percent(value: AxisPercent | None) -> str:
    """A check's figures, of the axes that it was made on: ``d 0.41 %, q 1.2 %``."""
    if value is None:
        return UNKNOWN
    figures = (("d", value.d_percent), ("q", value.q_percent))
    return ", ".join(f"{axis} {percent(figure)}" for axis, figure in figures if figure is not None) or UNKNOWN


def duration(seconds: float) -> str:
    """A time as a person reads it: 0.25 s, 94 s, 3 min 07 s, 1 h 02 min."""
    if seconds < 9.95:
        return f"{number(seconds, 2)} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    minutes, left = divmod(whole, 60)
    return f"{minutes} min {left:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def vector(d: float, q: float) -> str:
    """(i_d, i_q) in amperes, to the milliampere, or four digits of the longer one."""
    longer = max(abs(d), abs(q))
    decimals = min(3, decimals_of(longer, 4)) if longer else 3
    return "({}, {}) A".format(*(_minus(f"{round(x, decimals) + 0.0:+.{decimals}f}") for x in (d, q)))


def plural(count: int, noun: str) -> str:
    """1 point, 2 points."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _prefixed(value: float, unit: str, digits: int = 4) -> tuple[int, str]:
    """Power of ten and printed unit in which a value has one to three digits before the point."""
    printed = unit_words(unit)
    size = abs(float(f"{value:.{digits - 1}e}"))
    power = 0 if size == 0.0 else 3 * (math.floor(math.log10(size)) // 3)
    if printed in _GREATEST:
        power = min(max(power, min(_PREFIXES)), _GREATEST[printed])
        return power, _PREFIXES[power] + printed
    if power == 0 or 1e-3 <= size < 1e7:
        return 0, printed
    return power, f"·10{str(power).translate(_SUPERSCRIPT)}" + (f" {printed}" if printed else "")


def _with_unit(text: str, unit: str) -> str:
    return text + ("" if not unit or unit.startswith("·") else " ") + unit


def _trimmed(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text


def _minus(text: str) -> str:
    return text.replace("-", "−")
