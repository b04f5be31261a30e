"""Segments that inject along one axis only, grouped by operating point: first d, then q."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from orchestrator.analysis import axis_difference_rad
from orchestrator.numerics.types import Array
from protocols import Segment

CURRENT_TOLERANCE_RATIO = 0.03
"""Distance of two points over the largest current, within which they count as one."""


@dataclass(frozen=True)
class OneWay:
    """A segment with an injection along one axis.

    Attributes
    ----------
    segment : Segment
    frequency_hz : float
    current : array, shape (2,)
        Mean current in the stator's frame [A].
    axis_rad : float
        Direction of the injection in the stator frame.
    """

    segment: Segment
    frequency_hz: float
    current: Array
    axis_rad: float


def group_by_point(segments: Sequence[OneWay], frequency_tolerance: float) -> list[list[OneWay]]:
    """Segments grouped by operating point, frequency and rotor angle, in order of time.

    Parameters
    ----------
    frequency_tolerance : float
        Relative difference within which two injected frequencies are one.
    """
    reach = max((math.hypot(*segment.current) for segment in segments), default=0.0)
    points: list[list[OneWay]] = []

    def same_point(first: OneWay, other: OneWay) -> bool:
        return (
            math.isclose(first.frequency_hz, other.frequency_hz, rel_tol=frequency_tolerance)
            and math.hypot(*(first.current - other.current)) <= CURRENT_TOLERANCE_RATIO * reach
            and math.isclose(first.segment.rotor_angle_rad, other.segment.rotor_angle_rad, abs_tol=1e-6)
        )

    for segment in segments:
        point = next((p for p in points if same_point(p[0], segment)), None)
        if point is None:
            points.append(point := [])
        point.append(segment)
    return points


def shows_both_axes(point: Sequence[OneWay], min_angle_rad: float = 0.3) -> bool:
    """Whether the injections at a point have directions that differ by more than `min_angle_rad`."""
    return max(axis_difference_rad(segment.axis_rad, point[0].axis_rad) for segment in point) > min_angle_rad
