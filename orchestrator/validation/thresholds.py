"""A threshold as a field of a model: its default, its unit, and the source of the value.

Sources: ``theory`` follows from the statement beside it; ``simulated`` was chosen by trial on simulated plants (the
simulated drive and the blind suite's plant) and has no measured motor behind it; ``budget`` bounds computing time,
memory or the size of a file; ``practice`` is what is usual at a bench.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

Source = Literal["theory", "simulated", "budget", "practice"]


def threshold(default: object, unit: str, source: Source) -> Any:
    """A field of a model of thresholds; its docstring gives the reason."""
    return Field(default, json_schema_extra={"unit": unit, "source": source})
