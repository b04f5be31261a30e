"""Quantities like ``60 uH``, ``5 ms``, ``90 deg``, converted to numbers in the unit that a field's name ends with.

Prefixes go from nano to mega. Each conversion of a number is returned as a sentence for the user.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from typing import Any

from orchestrator.validation.messages import KeyPath
from orchestrator.validation.strict_yaml import Document
from protocols import ProcedureError

SYMBOLS = {
    **{"a": "A", "v": "V", "s": "s", "h": "H", "wb": "Wb", "ohm": "ohm", "hz": "Hz", "w": "W", "j": "J"},
    **{"nm": "Nm", "rpm": "rpm", "rad": "rad", "f": "F"},
}
"""Symbols of the units that names end with."""
PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
OTHERS: dict[str, tuple[str, float]] = {
    **{"deg": ("rad", math.pi / 180.0), "°": ("rad", math.pi / 180.0), "min": ("s", 60.0)},
    **{"rad/s": ("rpm", 30.0 / math.pi), "1/min": ("rpm", 1.0), "r/min": ("rpm", 1.0)},
}
"""Other units: the base unit, and its number in one of them."""
SPELLINGS = {"Ohm": "ohm", "OHM": "ohm", "ohms": "ohm", "Ohms": "ohm", "Ω": "ohm", "\u2126": "ohm", "Vs": "Wb"}
"""Other ways to write a unit, behind any prefix: Ohm with a capital, the Greek letter, the ohm sign, Vs of a flux."""
_QUANTITY = re.compile(r"([-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?)\s*([^\s\d.,;]\S{0,5})")


def read_quantities(document: Document, sections: Collection[str] | None = None) -> list[str]:
    """Replace a document's quantities by numbers; returns a sentence for each that changes.

    Parameters
    ----------
    document : Document
    sections : collection of str, optional
        The outermost keys below which quantities are converted; None: all.

    Raises
    ------
    ProcedureError
        Where a unit is not one of the field's: file and line, key, expected unit.
    """
    sentences = []
    for path, text in list(_texts(document.data, ())):
        if sections is not None and path[0] not in sections:
            continue
        field = next((key for key in reversed(path) if isinstance(key, str)), "")
        unit = SYMBOLS.get(field.rpartition("_")[2]) if "_" in field else None
        match = _QUANTITY.fullmatch(text.strip())
        if unit is None or match is None:
            continue
        dotted = ".".join(map(str, path))
        factor = _factor(match[2], unit)
        if factor is None:
            problem = f"expected a number in {unit}, or a quantity such as '5 {unit}' or '5 m{unit}'"
            raise ProcedureError(document.place(path), dotted, f"{problem}, got {text!r}")
        value = float(f"{float(match[1]) * factor:.15g}")
        parent: Any = document.data
        for key in path[:-1]:
            parent = parent[key]
        parent[path[-1]] = value
        if factor != 1.0:
            sentences.append(f"{dotted}: {text.strip()} is read as {value:.6g} {unit}")
    return sentences


def value_in(text: str, unit: str) -> float:
    """A number, or a quantity such as ``385 mV``, in the unit; NaN where it is neither.

    Per cent are read where the unit is a ratio, ``1`` or ``1/...``.
    """
    try:
        return float(text)
    except ValueError:
        match = _QUANTITY.fullmatch(text.strip())
    if match is None:
        return math.nan
    is_percent = match[2] == "%" and (unit == "1" or unit.startswith("1/"))
    factor = 0.01 if is_percent else _factor(match[2], unit)
    return math.nan if factor is None else float(match[1]) * factor


def _texts(value: Any, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, dict | list):
        for key, below in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _texts(below, (*path, key))


def _factor(written: str, unit: str) -> float | None:
    """Factor from the written unit to the field's; None where they are of different kinds."""
    other, factor = OTHERS.get(written, ("", 0.0))
    if other == unit:
        return factor
    spellings = (unit, *(spelling for spelling, meant in SPELLINGS.items() if meant == unit))
    prefixes = [written.removesuffix(spelling) for spelling in spellings if written.endswith(spelling)]
    return next((PREFIXES[prefix] for prefix in prefixes if prefix in PREFIXES), None)
