"""Quantities as people write them, ``60 uH``, ``5 ms``, ``90 deg``: numbers in the unit that a field's name ends with.

Prefixes go from nano to mega. What was read is kept as a sentence, so that it can be said.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from typing import Any

from orchestrator._document import Document
from orchestrator._validation import KeyPath
from protocols import ProcedureError

SYMBOLS = {
    **{"a": "A", "v": "V", "s": "s", "h": "H", "wb": "Wb", "ohm": "ohm", "hz": "Hz", "w": "W", "j": "J"},
    **{"nm": "Nm", "rpm": "rpm", "rad": "rad", "f": "F"},
}
"""Of the units that names end with."""
PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}
OTHERS: dict[str, tuple[str, float]] = {
    **{"deg": ("rad", math.pi / 180.0), "°": ("rad", math.pi / 180.0), "min": ("s", 60.0)},
    **{"rad/s": ("rpm", 30.0 / math.pi), "1/min": ("rpm", 1.0), "r/min": ("rpm", 1.0)},
}
"""Unit, and how many of it."""
SPELLINGS = {"Ohm": "ohm", "OHM": "ohm", "ohms": "ohm", "Ohms": "ohm", "Ω": "ohm", "\u2126": "ohm", "Vs": "Wb"}
"""Other ways to write a unit, behind any prefix: Ohm with a capital, the Greek letter, the ohm sign, Vs of a flux."""
_QUANTITY = re.compile(r"([-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?)\s*([^\s\d.,;]\S{0,5})")


def read_quantities(document: Document, sections: Collection[str] | None = None) -> list[str]:
    """Put numbers in the place of a document's quantities; returns what was read, a sentence each.

    Parameters
    ----------
    document : Document
    sections : collection of str, optional
        The outermost keys below which quantities are read; None: all.

    Raises
    ------
    ProcedureError
        A unit that is not one of the field's: file and line, key, what was expected.
    """
    said = []
    for path, text in list(_texts(document.data, ())):
        if sections is not None and path[0] not in sections:
            continue
        field = next((key for key in reversed(path) if isinstance(key, str)), "")
        unit = SYMBOLS.get(field.rpartition("_")[2]) if "_" in field else None
        found = _QUANTITY.fullmatch(text.strip())
        if unit is None or found is None:
            continue
        dotted = ".".join(map(str, path))
        factor = _factor(found[2], unit)
        if factor is None:
            wanted = f"expected a number in {unit}, or a quantity such as '5 {unit}' or '5 m{unit}'"
            raise ProcedureError(document.place(path), dotted, f"{wanted}, got {text!r}")
        value = float(f"{float(found[1]) * factor:.15g}")
        parent: Any = document.data
        for key in path[:-1]:
            parent = parent[key]
        parent[path[-1]] = value
        said.append(f"{dotted}: {text.strip()} is read as {value:.6g} {unit}")
    return said


def _texts(value: Any, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    if isinstance(value, str):
        yield path, value
    elif isinstance(value, dict | list):
        for key, below in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _texts(below, (*path, key))


def _factor(written: str, unit: str) -> float | None:
    """How many of the field's unit are one of the written one; None where it is no unit of that kind."""
    other, factor = OTHERS.get(written, ("", 0.0))
    if other == unit:
        return factor
    spellings = (unit, *(spelling for spelling, meant in SPELLINGS.items() if meant == unit))
    prefixes = [written.removesuffix(spelling) for spelling in spellings if written.endswith(spelling)]
    return next((PREFIXES[prefix] for prefix in prefixes if prefix in PREFIXES), None)
