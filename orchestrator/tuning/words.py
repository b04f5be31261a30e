"""The figures of a tuning in words, for the command line and the report."""

from __future__ import annotations

import math

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number, quantity, vector
from orchestrator.formatting.sentences import listed
from orchestrator.tuning.tuning_report import TuningReport

LEAST_HARMONICS_PERCENT = 0.01
"""Harmonics over the fundamental that are worth a line."""

MIN_OBSERVER_SPEED_RATIO = 0.01
"""Speed over the largest one below which no back-EMF observer works, whatever R_s is: readings drift."""


def headline(report: TuningReport) -> str:
    """The motor and the limits."""
    limits = f"{quantity(report.current_limit_a, 'A')} peak, {quantity(report.bus_v, 'V')} bus"
    return f"{report.motor}: {limits}, control at {number(report.sampling_hz)} Hz"


def figure_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The main figures, each with its name."""
    return [
        *_torque_rows(report),
        (
            "current control",
            f"bandwidth {number(report.bandwidth_hz)} Hz, phase margin {report.phase_margin_deg:.0f}° at standstill",
        ),
        ("... over the map's errors", f"phase margin at least {report.least_phase_margin_deg:.0f}° at standstill"),
        (
            "... at the largest speed",
            f"phase margin at least {report.margins_deg[-1]:.0f}° at {report.largest_speed_rpm:.0f} rpm",
        ),
        (
            "... its integral part",
            f"bandwidth {number(report.integral_hz)} Hz; its output is limited to "
            f"{quantity(report.integral_limit_v, 'V')}, the bus over √3",
        ),
        ("compensated", listed([plain(name) for name in report.compensated]) or "nothing"),
        *([("inverter's loss", f"up to {quantity(report.lost_v, 'V')} a leg")] if report.lost_v else []),
        *_harmonics_rows(report),
        (
            "with constant inductances instead",
            f"torque off by {number(report.constant_inductance_error_percent, 2)} % rms of the largest one",
        ),
        *_sensorless_rows(report),
    ]


def notes(report: TuningReport) -> list[str]:
    """The remarks, and the effects that are not compensated with their reasons."""
    left_out = [f"not compensated: {plain(name)}, {reason}" for name, reason in report.left_out.items()]
    return [*(remark.text for remark in report.remarks), *left_out]


def _torque_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The largest torque with the speeds at which it is available, and what is left of it beyond them."""
    torque, base = quantity(report.largest_torque_nm, "Nm"), f"{report.base_speed_rpm:.0f} rpm"
    largest = f"{report.largest_speed_rpm:.0f} rpm"
    if report.base_speed_rpm >= report.largest_speed_rpm:
        text = f"{torque} at every speed up to the limit of {largest}; the voltage would suffice up to {base}"
        return [("largest torque", text)]
    left = quantity(report.torque_at_largest_speed_nm, "Nm")
    return [
        ("largest torque", f"{torque} up to {base}; beyond, the voltage limits it"),
        ("... left at the largest speed", f"{left} at {largest}"),
    ]


def _harmonics_rows(report: TuningReport) -> list[tuple[str, str]]:
    """None where there is nothing to compensate, and little where it is small."""
    without = report.harmonics_without_percent
    if without < LEAST_HARMONICS_PERCENT:
        return []
    name = f"... 5th and 7th harmonic at {report.low_speed_rpm:.0f} rpm"
    return [(name, f"{number(without, 2)} % of the current, with compensation {number(report.harmonics_percent, 2)} %")]


def _sensorless_rows(report: TuningReport) -> list[tuple[str, str]]:
    share, error, place = report.injection_works_percent, report.injection_error_deg, report.injection_error_at_a
    rows = []
    if share is not None:
        at = "" if place is None else f" at {vector(*place)}"
        worst = "" if error is None else f"; position error at standstill up to {number(error, 3)}°{at}"
        currents = "every current" if share == 100.0 else f"{number(share, 2)} % of the currents"
        limit = quantity(report.current_limit_a, "A")
        rows.append(("tracking by injection", f"works at {currents} within the limit of {limit}{worst}"))
        if (fails := report.injection_fails_at_a) is not None:
            rows.append(
                (
                    "... along the references",
                    f"works below {vector(*fails)}, {quantity(math.hypot(*fails), 'A')}; from there on too little "
                    "saliency is left: limit the current there, or use a sensor",
                )
            )
        elif share < 100.0:
            rows.append(("... along the references", "works at all of them: the others are not used"))
    if report.injection_left_by_map_deg is not None:
        rows.append(
            (
                "... corrected by the map",
                f"position error at standstill up to {number(report.injection_left_by_map_deg, 3)}°",
            )
        )
    warm, cold = report.observer_speed_warm_rpm, report.observer_speed_rpm
    if warm is None or cold is None:
        rows.append(("back-EMF observer", "position error above 5° at every speed"))
    else:
        floor = MIN_OBSERVER_SPEED_RATIO * report.largest_speed_rpm
        followed = (
            f"below 5° from {cold:.0f} rpm on where R_s is followed"
            if cold >= floor
            else "not limited by R_s where it is followed, but by drift and offsets, which are not counted"
        )
        rows.append(("back-EMF observer", f"position error {followed}; else below 5° from {warm:.0f} rpm on"))
    return rows
