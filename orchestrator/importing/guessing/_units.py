"""Convert common spellings of units to the mapping's units."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

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
_SUFFIX = re.compile(r"(.+)_(A|mA|V|mV|kV|s|ms|us|ns|deg|rad|degC)$")
_LOWER_CASE = re.compile(r"((?:i|cur|strom)\w+)_a|((?:v|u|volt)\w+)_v")
"""SI suffixes in lower case, of currents and voltages whose name goes on before them: ``i_d_a``, ``v_u_v``."""
_PHASES = ("abc", "uvw", "rst")
_CHANNEL = re.compile(r"^(?:ch|channel|c)\s*\d+[\s:_-]+(?=\S)")


def unit_of(text: str) -> str | None:
    """The mapping's unit for a text such as ``[mA]``, ``Volts`` or ``µs``; None for any other text."""
    plain = text.strip().strip("[]()").strip().replace("µ", "u").replace("μ", "u")
    return plain if plain in _PREFIXED else _UNITS.get(plain.lower())


def names_and_units(names: Sequence[str]) -> dict[str, tuple[str, str | None]]:
    """Each column's name without its unit, and the unit; beside ``I_U``, ``I_V`` is a phase and not in volts."""
    lower = {name: without_channel(name) for name in names}
    known = set(lower.values())
    return {name: (name, None) if _is_phase(lower[name], known) else name_and_unit(name) for name in names}


def without_channel(name: str) -> str:
    """A name in lower case without a scope's channel: ``CH2 Ia`` is ``ia``."""
    return _CHANNEL.sub("", name.strip().lower())


def _is_phase(name: str, names: Collection[str]) -> bool:
    """Whether a name ends in a phase that others beside it end in, or in two, line to line: ``u_u_v``, ``u_v_w``."""
    start, _, end = name.rpartition("_")
    phases = next((phases for phases in _PHASES if end and end in phases), "")
    if any(f"{start}_{other}" in names for other in phases if other != end):
        return True
    of, _, first = start.rpartition("_")
    third = phases.replace(end, "").replace(first, "") if first and first in phases else ""
    return len(third) == 1 and not {f"{of}_{end}_{third}", f"{of}_{third}_{first}"}.isdisjoint(names)


def name_and_unit(name: str) -> tuple[str, str | None]:
    """A column's name without its unit, and the unit: ``ia [mA]``, ``Current/A``, ``u_dc_V``, ``i_d_a``."""
    for pattern in (_AFTER, _SUFFIX):
        found = pattern.fullmatch(name.strip())
        if found is not None and found[1] and unit_of(found[2]) is not None:
            return found[1], unit_of(found[2])
    found = _LOWER_CASE.fullmatch(name.strip())
    return (name, None) if found is None else (found[1] or found[2], "A" if found[1] else "V")
