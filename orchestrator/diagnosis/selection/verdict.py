"""The verdict on what is left after a search. Words nothing."""

from __future__ import annotations

import math

from orchestrator.diagnosis.fitting.model import Fit
from protocols import Verdict


def left_fraction(before_chi2: float, after: Fit) -> float:
    """u = sqrt((chi2_after - 1) / (chi2_before - 1)); 0 where the first model already fits."""
    if before_chi2 <= after.criteria.selection.detected_chi2:
        return 0.0
    return math.sqrt(max(after.chi2_per_dof - 1.0, 0.0) / (before_chi2 - 1.0))


def verdict_of(before: Fit, after: Fit, effects: int) -> Verdict:
    """The verdict on what is left: it has to be small beside what was found, and small in itself.

    The fraction alone would forgive a large second error beside a huge first one; so would the fitted part alone what
    only the held-out part shows.
    """
    limits = after.criteria.selection
    left = remainder(after)
    if after.chi2_per_dof <= limits.detected_chi2 and left <= limits.explained_left:
        return "explained" if effects else "clean"
    fraction = left_fraction(before.chi2_per_dof, after)
    if not effects or fraction > limits.mostly_explained or left > limits.mostly_left:
        return "unknown_remains"
    return "explained" if fraction <= limits.explained and left <= limits.explained_left else "mostly_explained"


def remainder(fit: Fit) -> float:
    """What is left of chi2 - 1, ripple included: of what was fitted or of what was held out, whichever is more."""
    held_out = fit.chi2_of(lambda piece: piece.held_out)
    return max(fit.chi2_per_dof, held_out or 0.0) - 1.0
