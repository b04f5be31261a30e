"""What sensorless control by injection sees of the motor, in words and as a table. Computes nothing but extremes."""

from __future__ import annotations

import math

import numpy as np

from orchestrator.flux_maps.exporting import saliency
from orchestrator.formatting.names import map_source
from orchestrator.formatting.quantities import fixed, number, quantity, vector
from plugins.streams.report._collect import Material
from plugins.streams.report._content import motor_of
from protocols import SeenByInjection

HEAD = (
    "injected",
    "points",
    "L_dd, beside the map",
    "L_qq, beside the map",
    "saliency",
    "the map’s",
    "error of the axis, up to",
    "after correction by the map",
)
AGREEMENT_PERCENT = 1.0
"""Ripple and map agree where neither inductance differs by more: what a drive's control does not feel."""


def rows(material: Material) -> list[tuple[str, ...]]:
    """One row for each frequency and size of the ripple."""
    return [_row(ripple) for ripple in _ripples(material)]


def note(material: Material) -> str:
    """What it means for a control, in a few sentences; empty where there is nothing to say."""
    ripples = _ripples(material)
    if not ripples:
        return ""
    most = max(abs(value or 0.0) for one in ripples for value in (one.l_dd_percent, one.l_qq_percent))
    worst = max(ripples, key=lambda one: one.angle_error_rad or 0.0)
    left = max(one.left_by_map_rad or 0.0 for one in ripples)
    map_ = f"the large-signal map {map_source(ripples[0].method)}"
    if most <= AGREEMENT_PERCENT:
        first = f"A small ripple sees the slopes of {map_}, within {number(most, 1)} %: one map serves both."
    else:
        first = (
            f"A small ripple sees inductances that are on average up to {fixed(most, 1)} % off the slopes "
            f"of {map_}. Current control, flux observers and MTPA follow the map; gain and compensation of a tracking "
            "by injection belong to the row of its own frequency."
        )
    second = (
        "Cross-saturation turns the axis of least inductance, which the tracking takes for the d axis, by up to "
        f"{_degrees(worst.angle_error_rad or 0.0)}{_place(worst)}{_within_rated(material, worst)}; with that turn "
        f"taken from the map, up to {_degrees(left)} is left."
    )
    return " ".join(filter(None, (first, second, _beside_tuning(material))))


def _beside_tuning(material: Material) -> str:
    """Why the tuning has other figures for the same two errors; empty where there is none."""
    tuning = material.tuning
    if tuning is None or tuning.injection_error_deg is None:
        return ""
    left = tuning.injection_left_by_map_deg
    corrected = "" if left is None else f", {number(left, 3)}° corrected by the map"
    figures, limit = f"{number(tuning.injection_error_deg, 3)}°{corrected}", quantity(tuning.current_limit_a, "A")
    return (
        f"The section on the drive has other figures ({figures}): they are at its references of least current (MTPA) "
        f"up to {limit}, with the inductances of its C code’s table."
    )


def _ripples(material: Material) -> tuple[SeenByInjection, ...]:
    return material.estimates.seen_by_injection if material.estimates is not None else ()


def _row(ripple: SeenByInjection) -> tuple[str, ...]:
    return (
        f"{number(ripple.frequency_hz, 4)} Hz, {number(ripple.amplitude_v, 3)} V rms",
        str(ripple.points),
        _percent(ripple.l_dd_percent),
        _percent(ripple.l_qq_percent),
        _between(ripple.saliency_low, ripple.saliency_high),
        _between(ripple.map_saliency_low, ripple.map_saliency_high),
        _degrees(ripple.angle_error_rad),
        _degrees(ripple.left_by_map_rad),
    )


def _place(ripple: SeenByInjection) -> str:
    """The current of the largest turn; files of older versions do not have it."""
    i_d, i_q = ripple.angle_error_i_d_a, ripple.angle_error_i_q_a
    return "" if i_d is None or i_q is None else f" at {vector(i_d, i_q)}"


def _within_rated(material: Material, ripple: SeenByInjection) -> str:
    """The largest turn up to the rated current, by the map; empty where the largest of all is not beyond it."""
    motor, grid = motor_of(material), material.maps.get(ripple.method)
    i_d, i_q, rated_a = ripple.angle_error_i_d_a, ripple.angle_error_i_q_a, motor.rated_current_a if motor else None
    if grid is None or i_d is None or i_q is None or rated_a is None or math.hypot(i_d, i_q) <= rated_a:
        return ""
    size_a = np.hypot(grid.i_d[:, None], grid.i_q[None, :])
    turn = np.where(size_a <= rated_a, np.abs(saliency(grid).angle_rad), np.nan)
    if not np.isfinite(turn).any():
        return ""
    rated = quantity(rated_a, "A")
    return f", beyond the rated current of {rated}, and by up to {_degrees(float(np.nanmax(turn)))} within it"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{'+' if value > 0 else ''}{fixed(value, 2)} %"


def _between(low: float | None, high: float | None) -> str:
    return "" if low is None or high is None else f"{fixed(low, 2)} to {fixed(high, 2)}"


def _degrees(angle_rad: float | None) -> str:
    return "" if angle_rad is None else f"{fixed(math.degrees(angle_rad), 1)}°"
