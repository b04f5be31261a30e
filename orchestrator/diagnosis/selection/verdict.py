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

    The fraction alone would forgive a large second error beside a huge first one. A wrong shape of the right effect
    leaves some of it, the more the stronger it shows; what is beyond that is another effect's.
    """
    limits = after.criteria.selection
    if after.chi2_per_dof <= limits.detected_chi2:
        return "explained" if effects else "clean"
    fraction = left_fraction(before.chi2_per_dof, after)
    if not effects or fraction > limits.mostly_explained or not small_remainder(before, after):
        return "unknown_remains"
    return "explained" if fraction <= limits.explained else "mostly_explained"


def small_remainder(before: Fit, after: Fit) -> bool:
    """Whether what is left may be due to the found effects' shape."""
    limits, first = after.criteria.selection, math.sqrt(max(before.chi2_per_dof - 1.0, 0.0))
    return after.chi2_per_dof - 1.0 <= max(limits.least_left, limits.shape_error * first)
