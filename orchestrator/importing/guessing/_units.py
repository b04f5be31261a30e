"""Convert common spellings of units to the mapping's units."""

from __future__ import annotations

import re

RMS = " rms"
"""Suffix of units of rms values, which the mapping expresses as a scaling."""
_UNITS = {
    **dict.fromkeys(("a", "amp", "amps", "ampere", "amperes", "amp."), "A"),
    **dict.fromkeys(("v", "volt", "volts"), "V"),
    **dict.fromkeys(("arms", "a rms", "a_rms", "aeff", "a eff"), f"A{RMS}"),
    **dict.fromkeys(("vrms", "v rms", "v_rms", "veff", "v eff"), f"V{RMS}"),
    **dict.fromkeys(("s", "sec", "second", "seconds", "sekunden"), "s"),
    **dict.fromkeys(("ms", "msec", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "µs", "μs", "usec", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nanoseconds"), "ns"),
    **dict.fromkeys(("min", "minutes"), "min"),
    **dict.fromkeys(("deg", "°", "degree", "degrees", "grad"), "deg"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("rev", "turn", "turns"), "turn"),
    **dict.fromkeys(("°c", "degc", "celsius"), "degC"),
    **dict.fromkeys(("k", "kelvin"), "K"),
    **dict.fromkeys(("%", "percent"), "duty_percent"),
}
_PREFIXED = {"mA", "uA", "kA", "mV", "uV", "kV"}
_AFTER = re.compile(r"(.*?)[ _]*[\[(/]\s*([^\[\]()/]+?)\s*[\])]?$")
_SUFFIX = re.compile(r"(.+)_(A|mA|V|mV|kV|s|ms|us|ns|deg|rad)$")


def unit_of(text: str) -> str | None:
    """The mapping's unit for a text such as ``[mA]``, ``Volts`` or ``µs``; None for any other text."""
    plain = text.strip().strip("[]()").strip().replace("µ", "u").replace("μ", "u")
    return plain if plain in _PREFIXED else _UNITS.get(plain.lower())


def name_and_unit(name: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit: ``ia [mA]``, ``Time(s)``, ``Current/A``, ``u_dc_V``."""
    for pattern in (_AFTER, _SUFFIX):
        found = pattern.fullmatch(name.strip())
        if found is not None and found[1] and unit_of(found[2]) is not None:
            return found[1], unit_of(found[2])
    return name, None
