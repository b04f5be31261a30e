"""Incremental saliency of inductance matrices, as sensorless control by injection sees it; knows no controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.types import Array


@dataclass(frozen=True)
class Saliency:
    """Principal incremental inductances, each of the shape of the inductances; NaN where these are."""

    l_max: Array
    """[H]"""
    l_min: Array
    ratio: Array
    """l_max / l_min; NaN where l_min is not positive."""
    angle_rad: Array
    """Electrical angle from the d axis to the axis of least inductance, -pi/2 to pi/2."""


def principal(l_dd: Array, l_dq: Array, l_qq: Array) -> Saliency:
    """Eigenvalues of the incremental inductance matrix, and where its axis of least inductance points.

    With s = (l_dd + l_qq)/2 and h = (l_qq - l_dd)/2 the eigenvalues are s +- sqrt(h^2 + l_dq^2), and the axis of least
    inductance stands at -1/2 atan2(l_dq, h) from the d axis: the position error of a tracking by injection that
    takes this axis for the d axis. Cross-saturation makes it differ from zero; past +-45 degrees the saliency is
    inverted.
    """
    mean, half = 0.5 * (l_dd + l_qq), 0.5 * (l_qq - l_dd)
    radius = np.hypot(half, l_dq)
    l_max, l_min = mean + radius, mean - radius
    ratio = np.where(l_min > 0, l_max / np.where(l_min > 0, l_min, 1.0), np.nan)
    return Saliency(l_max, l_min, ratio, angle_rad=-0.5 * np.arctan2(l_dq, half))
