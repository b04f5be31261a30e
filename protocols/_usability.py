"""Whether a flux map can be relied on: its checks, what each requires and what each found."""

from __future__ import annotations

from enum import StrEnum

from protocols._base import Lenient
from protocols._remarks import Number, Remark


class CheckOutcome(StrEnum):
    """Outcome of a map's check."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_POSSIBLE = "not_possible"
    """The recording does not allow it."""


class UsabilityCheck(Lenient):
    """One of the checks that decide whether a map can be relied on."""

    name: str
    """Name in snake_case: ``parity``."""
    outcome: CheckOutcome
    required: bool
    """Whether the map is not usable without it; one that is not required may be missing, but must not fail."""
    value: Number = None
    """None: not measured, or no number."""
    limit: Number = None
    """Largest `value` that passes."""
    unit: str = ""
    remark: Remark
    """Finding, or missing data."""

    @property
    def is_met(self) -> bool:
        """Whether it does not stand in the way of using the map."""
        missing = self.outcome is CheckOutcome.NOT_POSSIBLE and not self.required
        return missing or self.outcome is CheckOutcome.PASSED


class Usability(StrEnum):
    """Whether a map can be relied on."""

    USABLE = "usable"
    NOT_USABLE = "not_usable"
    """A check failed."""
    NOT_JUDGED = "not_judged"
    """No check failed, but one that is required was not possible: a diagnosis decides."""


class MapCriteria(Lenient):
    """Requirements on a usable flux map; per cent of the rated flux unless stated otherwise."""

    accuracy_percent: float = 1.0
    """What a usable map promises of its flux, rms; independent maps that differ by more cannot show it."""
    crossings_percent: float = 5.0
    """Largest difference where current paths cross. Each of two paths errs by half of it, and the largest of some ten
    crossings is 2 to 3 times their rms: more belongs to a map that errs by more than 1 % rms."""
    parity_percent: float = 5.0
    """Largest break of the symmetry in i_q, which a wrong rotor angle makes; as large as what crossings may be."""
    reciprocity_percent: float = 10.0
    """By which the slopes of a map that is not symmetric by construction may differ, of its inductance; with too few
    points it was a third and more."""
    energy_percent: float = 2.0
    """rms by which an energy may be off the map by a method that errs; one that is off all of them is wrong itself."""
    least_flux_ratio: float = 0.01
    """Injection's flux is so much larger or smaller than integration's, as a ratio less 1, where that is worth one."""
    flux_ratio_stds: float = 2.0
    """Minimum deviation in standard deviations of the ratio."""
    frequency_ratio: float = 1.5
    """Two injections are independent where their frequencies are so many times apart: delay, filter and eddy currents
    act with the frequency."""
    resistance_percent: float = 19.6
    """Half width of the 95 % interval of R_s: a nameplate without a stated error is believed as closely."""
    scatter_ratio: float = 2.0
    """Scatter of successive readings of R_s, in their own errors, beyond which it is no chance."""
    nameplate_apart: float = 0.2
    """Relative deviation of R_s and the unsaturated inductances from the nameplate that gives a remark."""
    nameplate_factor: float = 1.35
    """Ratio of theirs that no tolerance makes; all of them off the same way are a scale of the readings."""
    resistance_factor: float = 4.0
    """Ratio of R_s that nothing explains: a delta's phase has 3 times its star's R, times a tolerance of 1.35."""
