"""Limits that a motor has to keep to be accepted, and what came of the comparison."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from protocols._base import Strict
from protocols._estimates import Interval
from protocols._verdict import Verdict

Bound = Annotated[float, Field(ge=0)] | None


class Acceptance(Strict):
    """Limits of measured quantities: the section ``accept`` of a procedure.

    A quantity passes where its whole 95 % interval is within the limits (guarded acceptance, JCGM 106:2012, 8.3.3). One
    that was not measured does not pass, nor one of a map that is not usable.
    """

    min_resistance_ohm: Bound = None
    """R_s of a phase of the equivalent star."""
    max_resistance_ohm: Bound = None
    min_l_dd_h: Bound = None
    """Incremental inductance along the magnet at zero current; likewise L_qq across it."""
    max_l_dd_h: Bound = None
    min_l_qq_h: Bound = None
    max_l_qq_h: Bound = None
    min_rated_flux_wb: Bound = None
    """Change of the flux linkage from zero current to the rated one along q."""
    max_rated_flux_wb: Bound = None
    max_map_error_percent: Bound = None
    """Half width of the map's 95 % band, in percent of the rated flux."""
    verdicts: tuple[Verdict, ...] = ()
    """The diagnoses that pass; empty: any, also none."""

    @model_validator(mode="after")
    def _limits_something(self) -> Self:
        if not self.model_dump(exclude_defaults=True):
            raise ValueError("limits nothing: give a quantity, or leave the section out")
        for name in type(self).model_fields:
            low, high = self.bounds(name.removeprefix("max_"))
            if low is not None and high is not None and low > high:
                raise ValueError(f"min_{name.removeprefix('max_')} is above {name}")
        return self

    def bounds(self, quantity: str) -> tuple[float | None, float | None]:
        """Lower and upper limit of a quantity: ``resistance_ohm``; None where there is none."""
        return getattr(self, f"min_{quantity}", None), getattr(self, f"max_{quantity}", None)


class AcceptanceReason(Strict):
    """The comparison of one quantity with its limits."""

    quantity: str
    """Name with the unit: ``resistance_ohm``; or ``verdict``."""
    passed: bool
    value: Interval | None
    """With its 95 % interval; null where there is none."""
    min: float | None = None
    max: float | None = None
    sentence: str


class AcceptanceResult(Strict):
    """Whether a motor is accepted, with a reason for each quantity that has a limit."""

    passed: bool
    reasons: tuple[AcceptanceReason, ...]

    @property
    def objections(self) -> tuple[str, ...]:
        """Sentences of the reasons that do not pass."""
        return tuple(reason.sentence for reason in self.reasons if not reason.passed)
