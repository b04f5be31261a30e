"""The common step of quantised numbers, such as those of a log with few decimals."""

from __future__ import annotations

import numpy as np

from orchestrator.numerics.types import Array

MIN_GAPS = 30
"""Minimum number of gaps between different numbers: the two levels of a square wave establish no step."""


def step_of(numbers: Array) -> float | None:
    """The step of which numbers (n,) are multiples within single precision; None where they have none."""
    different = np.unique(numbers)
    rounding = 4.0 * float(np.finfo(np.float32).eps) * float(np.abs(different).max(initial=0.0))
    gaps = np.diff(different)
    gaps = gaps[gaps > 2.0 * rounding]
    if len(gaps) < MIN_GAPS:
        return None
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    # From the smallest numbers upwards, as the multiple of a large number needs an accurate step.
    for near in np.geomspace(16.0 * step, max(float(np.abs(different).max()), 16.0 * step), 12):
        multiples = different[np.abs(different) <= near]
        whole = np.round(multiples / step)
        step = float(multiples @ whole / (whole @ whole)) if whole.any() else step
    off = np.abs(different - step * np.round(different / step))
    return step if step > 50.0 * rounding and float(off.max()) <= 2.0 * rounding else None
