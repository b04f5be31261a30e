"""The JSON that `fluxbench estimate --json` prints; holds numbers and words, computes nothing."""

from __future__ import annotations

from pydantic import Field

from protocols import AxisPercent, Interval, ResistanceReading, Strict


class ResistanceReport(Strict):
    """Stator resistance over the recording."""

    value_ohm: float
    low: float
    high: float
    """95 % interval of `value_ohm`."""
    first_ohm: float
    last_ohm: float
    temperature_rise_k: Interval | None = None
    """Of a copper winding that started at 20 C, from the first reading to the last."""
    readings: tuple[ResistanceReading, ...] = ()
    """In order of time."""


class EstimationReport(Strict):
    """What the estimators found; every number finite, or null where the recording does not allow it.

    The checks are the recommended map's.
    """

    resistance: ResistanceReport | None
    method: str | None
    """Of the recommended map."""
    crossings: AxisPercent | None
    parity: AxisPercent | None
    reciprocity_percent: float | None
    classical_against_injection_percent: float | None
    """rms of the flux difference over the injection map's grid, in per cent of the rated flux."""
    usable: bool
    """Whether the recommended map can be relied on."""
    reasons: list[str]
    """What speaks against it, and what could not be estimated and why."""
    files: dict[str, str] = Field(default_factory=dict)
    """Path of each file written, by name."""
