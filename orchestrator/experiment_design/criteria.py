"""Thresholds of the experiments that are proposed or designed, with their units and sources."""

from __future__ import annotations

from orchestrator.thresholds import threshold
from protocols import Strict


class DesignCriteria(Strict):
    """The stages that are proposed, and how what they would tell is predicted."""

    least_separation: float = threshold(25.0, "1", "theory")
    """chi2 that a stage has to be predicted to separate before it is worth an operator's time: five sigma."""


class RehearsalCriteria(Strict):
    """How a plan is rehearsed before it is measured, and a shortest one found."""

    rehearsed_samples: int = threshold(300_000, "1", "budget")
    """Of injection that are rehearsed; longer plans are thinned as long recordings are."""
    parted_size: float = threshold(1.0, "1", "practice")
    """Part of its typical size at which an effect has to be found, and told from another."""
