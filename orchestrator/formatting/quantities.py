"""Numbers as an engineer reads them: SI prefixes, as many digits as the uncertainty supports, no exponent's letter.

A value and its interval have the same prefix and number of digits, so that they compare at a glance:
``20.00 mΩ (95 %: 19.98 to 20.02)``. An unknown value is a dash.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command line's help must start fast
    from protocols import AxisPercent, DriveRecord, NextExperiment

UNKNOWN = "–"
_SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}
_RELATIVE_ZERO = 1e-6
"""Ratio below which a number counts as zero beside another."""
_MAX_WIDTH_IN_PREFIX = 1000.0
"""Ratio of an interval's farther end to the value from which the end chooses the prefix."""
_RELATIVE_UNITS = ("1/W", "1/K", "1/A^2")
"""Units of relative changes, which are printed in per cent."""
_MIN_IN_PERCENT = 1e-6
"""Relative change below which per cent have too many zeros."""
_MAX_POWER_OF_TEN = {
    "V": 3,
    "A": 3,
    "Ω": 6,
    "H": 0,
    "Wb": 0,
    "s": 0,
    "W": 6,
    "J": 6,
    "Hz": 6,
    "rad": 0,
    "Nm": 3,
    "C": 0,
}
"""Units that take a prefix, each with the power of ten of its largest usual prefix."""


def unit_words(unit: str) -> str:
    """A unit in print: ohm as Ω, 1/A^2 as per A², 1 as an empty text."""
    base, power, exponent = unit.replace("ohm", "Ω").partition("^")
    printed = base + (exponent.translate(_SUPERSCRIPT) if power else "")
    if printed == "1":
        return ""
    return f"per {printed[2:]}" if printed.startswith("1/") else printed


@dataclass(frozen=True)
class Scale:
    """A prefix and a number of decimals, shared by values of one quantity.

    Attributes
    ----------
    power : int
        Values are printed in 10**power of the SI unit.
    decimals : int
        Digits after the point.
    unit : str
        In print, its prefix or power of ten included; empty where there is none.
    """

    power: int
    decimals: int
    unit: str

    @classmethod
    def of(cls, value: float, low: float, high: float, unit: str) -> Scale:
        """The scale for a value and its interval: decimals down to the smaller distance of an end from the value.

        A value that is far smaller than its interval has the interval's prefix, and one very near an end counts as
        that end.
        """
        largest = max(abs(low), abs(high))
        power, printed = _prefixed(value if abs(value) * _MAX_WIDTH_IN_PREFIX > largest else largest, unit)
        least = min(value - low, high - value)
        least = least if least > _RELATIVE_ZERO * (high - low) else high - low
        # Digits below a millionth of the value carry no information.
        least = max(least, 1e-6 * max(abs(value), largest))
        digits = significant_decimals(least / 10.0**power) if least > 0.0 else 0
        return cls(power, digits, printed)

    def number(self, value: float | None) -> str:
        """The number without its unit."""
        return UNKNOWN if value is None else fixed(value / 10.0**self.power, self.decimals)

    def quantity(self, value: float | None) -> str:
        """The number with its unit."""
        return _with_unit(self.number(value), self.unit)


def value_and_interval(value: float | None, low: float | None, high: float | None, unit: str) -> tuple[str, str]:
    """A value with its unit and, on the same scale, its interval, which is empty where an end is missing.

    The interval leaves out the unit and its prefix, but not a power of ten: ``(−24 to −2)·10⁻⁶``.
    """
    if value is None or low is None or high is None:
        return quantity(value, unit, 4), ""
    scale = Scale.of(value, low, high, unit)
    interval = f"{scale.number(low)} to {scale.number(high)}"
    factor = scale.unit.partition(" ")[0]
    return scale.quantity(value), f"({interval}){factor}" if factor.startswith("·") else interval


def measured(value: float | None, low: float | None, high: float | None, unit: str) -> str:
    """A value with its 95 % interval: ``20.00 mΩ (95 %: 19.98 to 20.02)``."""
    text, interval = value_and_interval(value, low, high, unit)
    return f"{text} (95 %: {interval})" if interval else text


def value_and_error(value: float, error: float, unit: str) -> tuple[str, str]:
    """A value and its standard deviation, on one scale, each with the unit."""
    if not error > 0.0:
        return quantity(value, unit, 5), UNKNOWN
    scale = Scale.of(value, value - error, value + error, unit)
    return scale.quantity(value), scale.quantity(error)


def with_error(value: float, error: float, power: int, max_decimals: int = 3) -> str:
    """A value and its 95 % uncertainty in 10**power of the unit, which the column's head shows."""
    scaled, scaled_error = value / 10.0**power, error / 10.0**power
    if not 0.0 < scaled_error < math.inf:
        return number(scaled)
    decimals = min(max_decimals, significant_decimals(scaled_error))
    error_text = fixed(scaled_error, decimals)
    return fixed(scaled, decimals) + (f" ± {error_text}" if float(error_text) else "")


def in_degrees(value: float | None, unit: str) -> str:
    """An angle's value in degrees, to follow it: `` (2.61°)``; empty for other units."""
    return f" ({number(math.degrees(value), 3)}°)" if unit == "rad" and value is not None else ""


def quantity(value: float | None, unit: str, digits: int = 3) -> str:
    """A value with so many significant digits and a suitable prefix: 3.07 mV, 1.48 kV, 25 µs."""
    if value is None:
        return UNKNOWN
    power, printed = _prefixed(value, unit, digits)
    return _with_unit(number(value / 10.0**power, digits), printed)


def number(value: float | None, digits: int = 4, power_from: float = 1e7) -> str:
    """So many significant digits, and all before the point; a power of ten from `power_from` on, and below 1e-4."""
    if value is None:
        return UNKNOWN
    size = abs(value)
    if size and not 1e-4 <= size < power_from:
        mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
        return f"{_minus(_trimmed(mantissa))}·10{str(int(power)).translate(_SUPERSCRIPT)}"
    return _minus(_trimmed(f"{value + 0.0:.{decimals_of(value, digits)}f}"))


def fixed(value: float, decimals: int) -> str:
    """A number with so many digits after the point, without a minus before zero."""
    return _minus(f"{round(value, decimals) + 0.0:.{decimals}f}")


def significant_decimals(error: float) -> int:
    """Digits after the point for a number with this uncertainty: one digit of the uncertainty, two after a 1."""
    leading, _, power = f"{error:.1e}".partition("e")
    return max(0, -int(power) + leading.startswith("1"))


def decimals_of(value: float, digits: int) -> int:
    """Digits after the point of a number with so many significant ones."""
    if value == 0.0:
        return 0
    # Rounding comes first: 9.996 has as many digits as 10.
    return max(0, digits - 1 - int(f"{value:.{digits - 1}e}".partition("e")[2]))


def percent(value: float | None, digits: int = 2) -> str:
    """A figure in per cent; below a hundred-thousandth it counts as zero."""
    if value is None:
        return UNKNOWN
    return f"{number(value if abs(value) >= 1e-5 else 0.0, digits)} %"


def probability(value: float | None) -> str:
    """A probability in per cent, as a bound where it is nearly one or nothing."""
    if value is None:
        return UNKNOWN
    if value > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if value < 0.001 else f"{fixed(100.0 * value, 1)} %"


def axes_percent(value: AxisPercent | None) -> str:
    """A check's figures by axis: ``d 0.41 %, q 1.2 %``."""
    if value is None:
        return UNKNOWN
    figures = (("d", value.d_percent), ("q", value.q_percent))
    return ", ".join(f"{axis} {percent(figure)}" for axis, figure in figures if figure is not None) or UNKNOWN


def duration(seconds: float) -> str:
    """A duration for people: 0.25 s, 94 s, 3 min 07 s, 1 h 02 min."""
    if seconds < 9.95:
        return f"{number(seconds, 2)} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def vector(d: float, q: float) -> str:
    """(i_d, i_q) in amperes, to the milliampere, or four digits of the longer one."""
    longer = max(abs(d), abs(q))
    decimals = min(3, decimals_of(longer, 4)) if longer else 3
    return "({}, {}) A".format(*(_minus(f"{round(x, decimals) + 0.0:+.{decimals}f}") for x in (d, q)))


def operating_point(drive: DriveRecord) -> str:
    """PWM frequency and bus voltage of a drive: ``10 kHz and 540 V``."""
    frequency = "" if drive.pwm_frequency_hz is None else f"{quantity(drive.pwm_frequency_hz, 'Hz')} and "
    return f"{frequency}{quantity(drive.dc_bus_voltage_v, 'V')}"


def plural(count: int, noun: str) -> str:
    """1 point, 2 points."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _prefixed(value: float, unit: str, digits: int = 4) -> tuple[int, str]:
    """Power of ten and printed unit in which a value has one to three digits before the point."""
    printed = unit_words(unit)
    size = abs(float(f"{value:.{digits - 1}e}"))
    if unit in _RELATIVE_UNITS and size >= _MIN_IN_PERCENT:
        return -2, f"% {printed}"
    power = 0 if size == 0.0 else 3 * (math.floor(math.log10(size)) // 3)
    if printed in _MAX_POWER_OF_TEN:
        power = min(max(power, min(_PREFIXES)), _MAX_POWER_OF_TEN[printed])
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


def predicted_separation(proposal: NextExperiment) -> str:
    """How far a proposed stage separates two effects, as the rest of a sentence; empty where it is not predicted."""
    if proposal.sigmas is None:
        return ""
    value, low, high = (number(x, 2) for x in (proposal.sigmas.value, proposal.sigmas.low, proposal.sigmas.high))
    least = "" if proposal.least_sigmas is None else f"; {number(proposal.least_sigmas, 2)} are enough"
    return f": by {value} sigma at the size found (95 %: {low} to {high}{least})"
