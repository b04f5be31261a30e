"""Results of a search for a law, as written to ``results/discovery.json``."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

Outcome = Literal["law", "nothing_to_learn", "no_law"]


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)


class RankedHypothesis(_Frozen):
    """A place and a quantity, with how much of the error a flexible law of it removes."""

    place: str
    quantity: str
    phase: str
    """a, b or c; empty for all."""
    kind: str
    """odd, even or none (a curve's part), lag or play."""
    log_evidence: float
    """Gain of the restricted log likelihood [nat]."""
    share: float
    """Part of the excess chi2 that it removes."""


class CurvePoint(_Frozen):
    """A point of the flexible law."""

    x: float
    y: float
    std: float


class Constant(_Frozen):
    """A constant of a form, with its 95 % interval."""

    name: str
    value: float
    low: float
    high: float
    unit: str


class FoundForm(_Frozen):
    """A formula for the law, refitted beside R_s, map and effects."""

    name: str
    formula: str
    constants: tuple[Constant, ...]
    chi2: float
    """Per degree of freedom, of the fitted stages."""
    heldout: float
    """rms of the held-out residual, in units of its noise."""
    heldout_rms_v: float | None
    log_evidence: float
    """Relative to the best form [nat]."""


class FoundLaw(_Frozen):
    """A law that a recording requires."""

    name: str
    sentence: str
    place: str
    quantity: str
    phase: str
    unit: str
    """Of the curve's values; `symbol` and `quantity_unit` are of its other axis."""
    quantity_unit: str
    symbol: str
    forms: tuple[FoundForm, ...]
    """The one that is written first, then those that do as well."""
    curve: tuple[CurvePoint, ...]
    """The flexible law with its standard deviation; of a law with memory, a play's first rise or what a step leaves."""
    as_well: tuple[str, ...]
    """Other places and quantities that do as well, and effects of the library, bent, that span it."""
    library: tuple[str, ...] = ()
    """Effects of the library that fit as well in its place, or nearly."""
    gauge: str
    """What no measurement of this kind can tell of it; empty where there is nothing."""
    to_decide: str
    """The experiment that parts the forms; empty where there is one form."""


class Discovery(_Frozen):
    """What was found beyond the library.

    Where `outcome` is not ``law``, no law is written.
    """

    recording: str
    outcome: Outcome
    reason: str
    """Why, in one sentence."""
    verdict: str
    """The diagnosis'."""
    before: float
    """rms of the held-out residual in units of its noise, by the diagnosis' model."""
    after: float
    before_rms_v: float | None
    after_rms_v: float | None
    floor_rms_v: float | None
    chi2_before: float
    chi2_after: float
    laws: tuple[FoundLaw, ...]
    ranking: tuple[RankedHypothesis, ...]
    kept_effects: tuple[str, ...]
    """Effects of the library that stay in the model beside the law."""
    stood_in: tuple[str, ...] = ()
    """Effects of the diagnosis' model that the law replaces, or beside which zero fits: `remove` takes them out."""
    seconds: float
