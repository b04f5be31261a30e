"""Settings of the experiments that are proposed or designed, with their units and sources."""

from __future__ import annotations

from orchestrator.validation.thresholds import threshold
from protocols import Strict


class DesignCriteria(Strict):
    """Thresholds for proposing a stage."""

    least_separation: float = threshold(25.0, "1", "theory")
    """chi2 that a stage has to be predicted to separate before it is worth an operator's time: five sigma."""


class RehearsalCriteria(Strict):
    """Thresholds for a plan, and the part of it that is rehearsed before it is measured."""

    rehearsed_samples: int = threshold(300_000, "1", "budget")
    """Samples of injection that are rehearsed; longer plans are thinned as long recordings are."""
    parted_size: float = threshold(1.0, "1", "practice")
    """Part of its typical size at which a plan has to detect an effect and separate it from another."""
