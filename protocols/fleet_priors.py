"""Population priors of a fleet, as a file for the next motor's diagnosis."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from protocols._base import Strict


class NormalPrior(Strict):
    """Expected distribution of the next motor's value."""

    mean: float
    std: Annotated[float, Field(gt=0)]
    """Between motors, with what the mean itself is uncertain by; in `unit`, as the mean."""
    unit: str
    recordings: Annotated[int, Field(ge=1)]
    """That it was estimated from."""


class EffectPrior(Strict):
    """Frequency of an effect, and its size."""

    probability: Annotated[float, Field(gt=0, lt=1)]
    found: Annotated[int, Field(ge=0)]
    asked: Annotated[int, Field(ge=1)]
    """Diagnosed recordings."""
    sizes: dict[str, NormalPrior] = Field(default_factory=dict)
    """By the names of its amplitudes."""


class FleetPriors(Strict):
    """A file of priors, for motors of one kind."""

    format: Literal["fluxbench-priors"] = "fluxbench-priors"
    version: Literal[1] = 1
    motor: str | None
    """The nameplate's name; a recording of another one is refused."""
    table: str
    recordings: Annotated[int, Field(ge=1)]
    diagnosed: Annotated[int, Field(ge=1)]
    """Number of these with a diagnosis that is believed."""
    resistance: NormalPrior | None = None
    d_inductance: NormalPrior | None = None
    """At rest; likewise q_inductance."""
    q_inductance: NormalPrior | None = None
    effects: dict[str, EffectPrior] = Field(default_factory=dict)

    def without(self, names: frozenset[str]) -> FleetPriors:
        """The priors without those of some effects' sizes."""
        bare = {name: e.model_copy(update={"sizes": {}} if name in names else {}) for name, e in self.effects.items()}
        return self.model_copy(update={"effects": bare})
