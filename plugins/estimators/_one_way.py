"""Segments that inject along one axis only, brought together by the point that they share: first d, then q."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from orchestrator.analysis import axis_difference_rad
from orchestrator.numerics.types import Array
from protocols import Segment

CURRENT_TOLERANCE_RATIO = 0.03
"""Difference of two points over the largest current, within which they count as one."""


@dataclass(frozen=True)
class OneWay:
    """A segment whose voltage ripples along one axis.

    Attributes
    ----------
    segment : Segment
    frequency_hz : float
    current : array, shape (2,)
        Mean current in the stator's frame [A].
    axis_rad : float
        Along which it ripples there.
    """

    segment: Segment
    frequency_hz: float
    current: Array
    axis_rad: float


def by_point(some: Sequence[OneWay], same_frequency: float) -> list[list[OneWay]]:
    """Those of one point, frequency and rotor angle together, in order of time; alone where there is no other.

    Parameters
    ----------
    same_frequency : float
        Relative difference within which two injected frequencies are one.
    """
    reach = max((math.hypot(*one.current) for one in some), default=0.0)
    points: list[list[OneWay]] = []

    def are_one(first: OneWay, other: OneWay) -> bool:
        return (
            math.isclose(first.frequency_hz, other.frequency_hz, rel_tol=same_frequency)
            and math.hypot(*(first.current - other.current)) <= CURRENT_TOLERANCE_RATIO * reach
            and math.isclose(first.segment.rotor_angle_rad, other.segment.rotor_angle_rad, abs_tol=1e-6)
        )

    for one in some:
        point = next((p for p in points if are_one(p[0], one)), None)
        if point is None:
            points.append(point := [])
        point.append(one)
    return points


def shows_both_axes(point: Sequence[OneWay], apart_rad: float = 0.3) -> bool:
    """Whether the waves at a point go along axes that are apart."""
    return max(axis_difference_rad(one.axis_rad, point[0].axis_rad) for one in point) > apart_rad
