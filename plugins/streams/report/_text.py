"""Numbers and borrowed sentences as a printed page has them: true minus signs, ±, units. Interprets nothing."""

from __future__ import annotations

import math
import re

from protocols import AxisPercent

NOT_MEASURED = "not measured"

_POWER = re.compile(r"(?<![\w.])(\d(?:\.\d+)?)e([+-]?)0*(\d+)\b")
_REPLACED = (
    (re.compile(r"\+-|\+/-"), "±"),
    (re.compile(r"\s->\s"), " → "),
    (re.compile(r"(?<=[\d.])\s?\.\.\s?(?=[-−\d])"), " to "),
    (re.compile(r"(?<![\w.\-−)])-(?=\.?\d)"), "−"),
    (re.compile(r"(?<=\d )ohm\b"), "Ω"),
    (re.compile(r"(?<=\d) 1(?=[,;)]|$)"), ""),
)


def typographic(text: str) -> str:
    """A sentence that was written for a terminal: ±, →, true minus signs before numbers, Ω."""
    text = _POWER.sub(_spelt_out, text)
    for pattern, by in _REPLACED:
        text = pattern.sub(by, text)
    return text


def number(value: float | None, digits: int = 4) -> str:
    """So many significant digits, a true minus sign, powers of ten spelt out."""
    return NOT_MEASURED if value is None else typographic(f"{value + 0.0:.{digits}g}")


def fixed(value: float, digits: int) -> str:
    """So many digits after the point, a true minus sign, and no minus before a zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")


def borne(error: float) -> int:
    """Digits after the point that a number with this uncertainty bears: two of the uncertainty's own."""
    return max(0, min(6, 1 - math.floor(math.log10(error)))) if error > 0.0 else 4


def percent(value: float | None) -> str:
    """Two digits; what is below a hundred-thousandth is nothing."""
    if value is None:
        return NOT_MEASURED
    return "0 %" if abs(value) < 1e-5 else f"{number(value, 2)} %"


def pair(value: AxisPercent | None) -> str:
    """Both axes of a check."""
    if value is None:
        return NOT_MEASURED
    return f"d {percent(value.d_percent)}, q {percent(value.q_percent)}"


def plain(name: str) -> str:
    """A name of the code's as words."""
    return name.replace("_", " ")


def scaled(value: float | None, unit: str) -> str:
    """A quantity of a hundredth to a thousand with m, µ or nothing before its unit: 3.07 mV, 1.48 V."""
    if value is None:
        return NOT_MEASURED
    size = abs(value)
    for factor, prefix in ((1.0, ""), (1e3, "m"), (1e6, "µ")):
        if size * factor >= 1.0 or size == 0.0 or factor == 1e6:
            return f"{number(value * factor, 3)} {prefix}{unit}"
    raise AssertionError("the last factor takes all")


def _spelt_out(found: re.Match[str]) -> str:
    """1.48e+03 as 1480, 5.49e+07 as 5.49·10⁷."""
    power = int(found[2] + found[3])
    return f"{float(found[0]):.0f}" if 0 < power < 5 else f"{found[1]}·10{_raised(found[2], found[3])}"


def _raised(sign: str, digits: str) -> str:
    up = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
    return (sign.replace("+", "") + digits).translate(up)
