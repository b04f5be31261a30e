"""Quantities as people write them, ``60 uH``, ``5 ms``, ``90 deg``: numbers in the unit that a field's name ends with.

Prefixes go from nano to mega. What was read is kept as a sentence, so that it can be said.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
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
    **{"deg": ("rad", math.pi / 180.0), "°": ("rad", math.pi / 180.0)},
    **{"min": ("s", 60.0), "Vs": ("Wb", 1.0), "mVs": ("Wb", 1e-3), "Ω": ("ohm", 1.0), "mΩ": ("ohm", 1e-3)},
    **{"rad/s": ("rpm", 30.0 / math.pi)},
}
"""Unit, and how many of it."""
_QUANTITY = re.compile(r"([-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?)\s*([^\s\d.,;]\S{0,5})")


def read_quantities(document: Document) -> list[str]:
    """Put numbers in the place of a document's quantities; returns what was read, a sentence each.

    Raises
    ------
    ProcedureError
        A unit that is not one of the field's: file and line, key, what was expected.
    """
    said = []
    for path, text in list(_texts(document.data, ())):
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
    return PREFIXES.get(written.removesuffix(unit)) if written.endswith(unit) else None
