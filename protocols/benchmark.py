"""The answer that a tool gives about one recording of the benchmark: a line of JSON. Any tool can write it."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from protocols._base import Strict

BenchmarkVerdict = Literal["clean", "explained", "unknown"]
"""Nothing is missing from the model; the named effects are what is missing; something else is."""

Point = Annotated[tuple[float, float] | None, Field(description="psi_d, psi_q [Wb]; null where not known")]


class NamedEffect(Strict):
    """An effect that is missing from the model, with the one number that the set's manifest asks of it."""

    name: str
    size: float | None = None
    unit: str | None = None
    """As in the manifest."""
    low: float | None = None
    high: float | None = None
    """95 % interval of the size."""

    @model_validator(mode="after")
    def _interval_holds_the_size(self) -> Self:
        if self.size is not None and self.unit is None:
            raise ValueError("a size needs its unit")
        if (self.low is None) != (self.high is None):
            raise ValueError("low and high belong together")
        if self.low is not None and self.high is not None and self.low > self.high:
            raise ValueError("low is above high")
        return self


class BenchmarkResistance(Strict):
    """R_s at the start of the experiment [ohm], with its 95 % interval."""

    value: float
    low: float | None = None
    high: float | None = None


class BenchmarkAnswer(Strict):
    """What a tool states about one recording."""

    id: str
    verdict: BenchmarkVerdict
    names: tuple[NamedEffect, ...] = ()
    """The effect that matters most comes first."""
    resistance_ohm: BenchmarkResistance | None = None
    flux_wb: tuple[Point, ...] = ()
    """psi(i) - psi(0) without the named effects, at the manifest's `points_a`, in their order."""
    flux_std_wb: tuple[Point, ...] = ()
    """Standard deviations of `flux_wb`."""
    usable: bool = False
    """Whether the tool tells its user to use this map: true to 1 % of the rated flux (rms)."""
    seconds: Annotated[float, Field(ge=0.0)] | None = None
    """Of wall time."""
