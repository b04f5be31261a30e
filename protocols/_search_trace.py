"""Moves that the search of a diagnosis tried, in order."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from protocols._base import Lenient
from protocols._remarks import Number

SearchMove = Literal[
    "baseline",
    "screen",
    "refit",
    "full_model",
    "add",
    "remove",
    "swap",
    "merge",
    "free_shape",
    "fix_shape",
    "switch_form",
    "finer_map",
    "coarser_map",
    "noise",
    "quantiser",
    "switching_ripple",
    "name",
]
"""Kinds of move.

``screen`` predicts every absent effect's gain on one linearisation; ``refit`` fits a few of them; ``full_model`` fits
all effects at once; ``free_shape`` and ``fix_shape`` concern a shape or refinement; ``noise`` adds variance components;
``quantiser`` the PWM timer's rounding; ``switching_ripple`` the current within a carrier period; ``name`` reports an
effect of the model as a cause.
"""
SearchMeasure = Literal["log_evidence", "chi2", "chi2_per_dof", "objective", "block_scatter", "share"]
"""What a move's score is.

``log_evidence``: its gain [nat]. ``chi2``: its predicted fall. ``objective``: the fall of chi2 with priors.
``chi2_per_dof``: its value after the move. ``block_scatter``: relative scatter of an effect's size between blocks of
the recording. ``share``: an effect's part of the first error.
"""
SearchDecision = Literal["accepted", "rejected", "tested"]
_EARLIER_DECISIONS = {"taken": "accepted", "refused": "rejected", "tried": "tested"}
"""Names of decisions in files of earlier versions."""


class SearchEvent(Lenient):
    """One move of the search."""

    step: int
    """Number of the move, from 1."""
    move: SearchMove
    effects: tuple[str, ...]
    """The effects that it concerns, the first one first; empty where it concerns the map or the noise."""
    data: Literal["part", "whole"]
    """Whether it was fitted to a part of the recording or to all of it."""
    measure: SearchMeasure | None = None
    score: Number = None
    threshold: Number = None
    """Threshold of the score, in the same measure."""
    chi2_before: Number = None
    """Per degree of freedom."""
    chi2_after: Number = None
    """Per degree of freedom of the trial, accepted or not."""
    decision: SearchDecision
    """``tested``: nothing was decided yet."""
    note: str = ""
    """What the comparison alone does not say."""
    evaluations: float
    """Computing so far, in columns of equations of the whole recording: three for a residual, one for a derivative."""
    seconds: float
    """Since the recording was read."""

    @field_validator("decision", mode="before")
    @classmethod
    def _read_earlier_decision(cls, given: object) -> object:
        return _EARLIER_DECISIONS.get(given, given) if isinstance(given, str) else given
