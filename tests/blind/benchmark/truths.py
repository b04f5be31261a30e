"""The form in which a truth is sealed, whatever plant it is from. The scorer's own checks are in its module."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.benchmark.definition import effect_sizes
from tests.blind.magnetics import Machine

GRID = (-0.9, -0.45, 0.0, 0.45, 0.9)
"""Of the currents at which the flux is asked, in units of the largest ones of the experiment."""

Record = Callable[[Path], Any]


@dataclass(frozen=True)
class Hidden:
    """One effect as it is sealed.

    Attributes
    ----------
    size : tuple of float or None
        Lowest and highest true value of the number that an answer may state; None where it has no single one.
    main : bool
        Whether it is right as the first name.
    material : bool or None
        Whether an engineer would want it named; None where the plant has not worked it out.
    """

    name: str
    relative: float
    size: tuple[float, float] | None = None
    main: bool = True
    material: bool | None = None


@dataclass(frozen=True)
class Made:
    """What a plant gives of a row: how to record it, and its truth."""

    record: Record
    plate: Machine
    resistance_ohm: float
    flux: Callable[[float, float], tuple[float, float]]
    span_d: tuple[float, float] = (-1.0, 1.0)
    hidden: Sequence[Hidden] = ()
    foreign: str | None = None
    also: Sequence[str] = ()
    """Names that are true beside those hidden."""
    twins: Sequence[Sequence[str]] = field(default=())
    """Effects that this experiment cannot tell apart."""

    def points(self) -> list[tuple[float, float]]:
        """Currents (i_d, i_q) [A] at which the flux is asked."""
        top = self.plate.top_a
        low, high = (top * end for end in self.span_d)
        along_d = [-g * low if g < 0 else g * high for g in GRID]
        return [(float(f"{d:.4g}"), float(f"{g * top:.4g}")) for d in along_d for g in GRID]


def truth_of(id: str, kind: str, origin: str, motor: str, without: str, made: Made) -> dict[str, Any]:
    """The object that is sealed."""
    unknown = made.foreign is not None or any(hidden.name == without for hidden in made.hidden)
    rest = made.flux(0.0, 0.0)
    flux = [made.flux(*point) for point in made.points()]
    return {
        "id": id,
        "class": kind,
        "origin": origin,
        "motor": motor,
        "verdict": "unknown" if unknown else "explained" if made.hidden else "clean",
        "foreign": made.foreign,
        "effects": [_effect(hidden, made.twins) for hidden in made.hidden],
        "also": sorted({*made.also, *(name for group in _met(made.also, made.twins) for name in group)}),
        "resistance_ohm": made.resistance_ohm,
        "flux_wb": [[psi_d - rest[0], psi_q - rest[1]] for psi_d, psi_q in flux],
    }


def _effect(hidden: Hidden, twins: Sequence[Sequence[str]]) -> dict[str, Any]:
    names = {hidden.name, *(name for group in _met([hidden.name], twins) for name in group)}
    return {
        "name": hidden.name,
        "accepted": sorted(names),
        "relative": hidden.relative,
        "main": hidden.main,
        "material": hidden.material,
        "size": None if hidden.size is None else list(np.sort(hidden.size)),
        "unit": effect_sizes()[hidden.name].unit,
    }


def _met(names: Iterable[str], twins: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    return [group for group in twins if set(group) & set(names)]
