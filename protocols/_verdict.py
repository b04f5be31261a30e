"""A diagnosis' verdict, the numbers that it follows from, and the reasons for it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from protocols._base import Lenient
from protocols._remarks import Number

Verdict = Literal[
    "clean",
    "explained",
    "explained_in_another_form",
    "mostly_explained",
    "unknown_remains",
    "convention",
    "cannot_tell",
]


class VerdictLimits(Lenient):
    """The limits that a verdict compares with.

    Excess chi2 is chi2 per degree of freedom less one. Widths are standard deviations of an effect's prior.
    """

    noise_chi2: float
    """Largest chi2 per degree of freedom that noise alone makes."""
    least_chi2: float = 0.0
    """Smallest chi2 per degree of freedom of a known noise: less means that it was overestimated."""
    chance_sigmas: float
    """Standard deviations sqrt(2 / degrees of freedom) by which chance may raise chi2."""
    explained_fraction: float
    """Largest part of the first error (an amplitude) that ``explained`` leaves."""
    mostly_explained_fraction: float
    """Largest part of the first error that ``mostly_explained`` leaves."""
    explained_excess_chi2: float
    """Largest excess chi2 for ``explained``, and for ``clean`` where the remaining error is immaterial."""
    mostly_explained_excess_chi2: float
    """Largest excess chi2 for ``mostly_explained``."""
    immaterial_excess_chi2: float
    """Largest excess chi2 for ``mostly_explained`` where the remaining error is immaterial."""
    clean_excess_chi2: float
    """Largest excess chi2 for ``clean`` where the remaining error is negligible."""
    material_voltage: float
    """Part of the excitation's rms voltage from which on an error is material."""
    negligible_voltage: float
    """Part of the excitation's rms voltage below which an error is negligible."""
    other_form_share: float = 1.0
    """Part of the excess chi2 that other forms of the effects have to take up for ``explained_in_another_form``."""
    shape_widths: float
    """Largest distance of a shape parameter from its usual value [widths]."""
    large_effect_widths: float
    """Amplitude from which on an effect is larger than in most drives [widths]."""
    large_effects: int
    """Number of such effects that is implausible."""
    noise_of_excitation: float
    """Largest noise voltage, as a part of the excitation's."""
    current_error: float
    """Largest rms error of the simulated current, as a part of the current's range."""
    material_flux: float = 0.002
    """Part of the rated flux by which an error of the map is material."""
    chance_probability: float
    """Probability below which a reading is not attributed to chance."""


class VerdictRecord(Lenient):
    """Every number that a verdict follows from; `orchestrator.diagnosis.judge` needs nothing else."""

    chi2_before: Number
    """Per degree of freedom, of the model without any effect."""
    chi2_after: Number
    """Per degree of freedom, of the model with all its effects."""
    degrees_of_freedom: float
    held_out_chi2: Number = None
    """Mean square of the held-out stages' error over noise and map uncertainty; null where nothing is held out."""
    held_out_equations: int = 0
    """Number of equations that it is the mean of; few scatter by chance."""
    effects: int
    """Number of effects that are named as causes."""
    left_of_excitation: Number
    """Error beyond noise over the excitation's rms voltage, the largest over the kinds of stage."""
    chi2_in_other_forms: Number = None
    """Per degree of freedom, with a mixture of other forms of the named effects; null where none was tried."""
    other_forms: tuple[str, ...] = ()
    """The effects whose forms were mixed."""
    gates_off_v: Number = None
    """rms error of the readings with the gates off [V]; null where there are none."""
    gates_off_probability: Number = None
    """Probability that chance makes so large an error there."""
    least_excitation_v: Number = None
    """rms voltage of the kind of stage that has the least [V]; null where nothing is excited."""
    shape_widths: Number = 0.0
    """Largest distance of a free shape parameter (2nd order) from its usual value [widths]."""
    shape_effect: str | None = None
    """The effect that it belongs to."""
    effect_widths: dict[str, Number] = Field(default_factory=dict)
    """Amplitude of each effect [widths of its prior]."""
    periodic_lines: int = 0
    """Number of periodic disturbances in the holds that are no switching ripple."""
    noise_v: Number = None
    """rms that noise alone would make [V]."""
    excitation_v: Number = None
    """rms of the applied voltage [V]."""
    map_error: Number = None
    """Half width of the map's 95 % band, as a part of the rated flux; null where none was computed."""
    hidden_map_error: Number = None
    """The part of it by absent effects that the recording may hide; null where none was computed."""
    current_error: Number = None
    """rms error of the simulated current over the current's range; null where none was simulated."""
    limits: VerdictLimits


class Reason(Lenient):
    """One comparison that a verdict rests on."""

    quantity: str
    """Name of the number, with its unit: ``left_of_first_error_percent``."""
    value: Number
    limit: Number
    sentence: str
    """The comparison in plain English."""


class Judgement(Lenient):
    """A verdict with its reasons, the deciding ones first."""

    verdict: Verdict
    reasons: tuple[Reason, ...]
