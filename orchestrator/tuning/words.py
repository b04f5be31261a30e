"""The figures of a tuning in words, for the command line and the report."""

from __future__ import annotations

import math

from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number, quantity, vector
from orchestrator.formatting.sentences import listed
from orchestrator.tuning.tuning_report import TuningReport

LEAST_HARMONICS_PERCENT = 0.01
"""Harmonics over the fundamental that are worth a line."""

FILE_CONTENTS = (
    ("_int32.h", None),
    ("_int32.c", "C code in int32, for parts without an FPU, and its .h"),
    (".h", None),
    (".c", "C code in float: references, gains, compensation, angle; and its .h"),
    ("references.csv", "i_d and i_q [A] over torque and flux limit"),
    ("torque.csv", "largest torque [Nm] and power [W] over speed"),
    ("compensation.csv", "voltage that a leg loses [V] over its current [A]"),
    ("tuning.svg", "all of it in one picture"),
    (".txt", "the current control's settings in this firmware's own words"),
    ("tuning.json", "the figures above, for programs"),
)
"""Endings of the written files and what these hold; a header is named with its source file."""

MIN_USEFUL_SHARE_PERCENT = 10.0
"""Part of the currents below which a tracking by injection is of no use."""
MIN_OBSERVER_SPEED_RATIO = 0.01
"""Speed over the largest one below which no back-EMF observer works, whatever R_s is: readings drift."""


def headline(report: TuningReport) -> str:
    """The motor and the limits."""
    limits = f"{quantity(report.current_limit_a, 'A')} peak, {quantity(report.bus_v, 'V')} bus"
    pwm = f", PWM at {number(report.pwm_hz)} Hz" if report.pwm_hz not in (None, report.sampling_hz) else ""
    return f"{report.motor}: {limits}, control at {number(report.sampling_hz)} Hz{pwm}"


def figure_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The main figures, each with its name."""
    return [
        *_torque_rows(report),
        (
            "current control",
            f"bandwidth {number(report.bandwidth_hz, 3)} Hz, phase margin {report.phase_margin_deg:.0f}° at standstill",
        ),
        ("... over the map's errors", f"phase margin at least {report.least_phase_margin_deg:.0f}° at standstill"),
        (
            "... at the largest speed",
            f"phase margin at least {report.margins_deg[-1]:.0f}° at {report.largest_speed_rpm:.0f} rpm",
        ),
        (
            "... its integral part",
            f"bandwidth {number(report.integral_hz, 3)} Hz; its output is limited to "
            f"{quantity(report.integral_limit_v, 'V')}, the bus over √3",
        ),
        *_gain_rows(report),
        ("compensated effects", listed([plain(name) for name in report.compensated]) or "none"),
        *([("inverter's loss", _loss(report))] if report.lost_v else []),
        *_harmonics_rows(report),
        (
            "with constant inductances instead",
            f"torque error {number(report.constant_inductance_error_percent, 2)} % rms, of the largest torque",
        ),
        *_sensorless_rows(report),
    ]


def _gain_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The gains of plain PI controllers."""
    if report.k_p_v_per_a is None or report.k_i_v_per_as is None:
        return []
    d, q = (number(k_p, 3) for k_p in report.k_p_v_per_a)
    k_p = f"{d} V/A" if d == q else f"{d} V/A for i_d, {q} V/A for i_q"
    return [("... as plain PI controllers", f"k_p {k_p}; k_i {number(report.k_i_v_per_as, 3)} V/(A s)")]


def _loss(report: TuningReport) -> str:
    text = f"up to {quantity(report.lost_v, 'V')} a leg"
    if not report.lost_time_s:
        return text
    pwm = "" if report.pwm_hz is None else f" at {quantity(report.pwm_hz, 'Hz')} PWM"
    return f"{text}; as a dead time {quantity(report.lost_time_s, 's')}{pwm}"


def notes(report: TuningReport) -> list[str]:
    """The remarks, and the effects that are not compensated, or in part, with their reasons."""
    left_out = [
        f"{plain(name)}: {reason}" if name in report.compensated else f"not compensated: {plain(name)}, {reason}"
        for name, reason in report.left_out.items()
    ]
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


def file_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The written files, each with what it holds."""
    known = [(name, next((text for end, text in FILE_CONTENTS if name.endswith(end)), "")) for name in report.files]
    return [(name, text) for name, text in known if text is not None]


def _sensorless_rows(report: TuningReport) -> list[tuple[str, str]]:
    share, error, place = report.injection_works_percent, report.injection_error_deg, report.injection_error_at_a
    rows = []
    if share is not None and share < MIN_USEFUL_SHARE_PERCENT:
        where = f"{number(share, 2)} % of the currents within the limit of {quantity(report.current_limit_a, 'A')}"
        text = f"does not work on this motor: the saliency suffices at {where}"
        return [("tracking by injection", f"{text}; use a sensor"), *_observer_rows(report)]
    if share is not None:
        currents = "every current" if share == 100.0 else f"{number(share, 2)} % of the currents"
        limit = quantity(report.current_limit_a, "A")
        rows.append(("tracking by injection", f"works at {currents} within the limit of {limit}"))
        if (fails := report.injection_fails_at_a) is not None:
            reach = f"works below (i_d, i_q) = {vector(*fails)}, {quantity(math.hypot(*fails), 'A')}"
            rows.append(("... along the references", f"{reach}: beyond, the saliency is too small"))
            rows.append(("", "limit the current there, or use a sensor"))
        elif share < 100.0:
            rows.append(("... along the references", "works at all of them: the others are not used"))
    if share is not None and error is not None:
        at = "" if place is None else f", at (i_d, i_q) = {vector(*place)}"
        rows.append(("... position error", f"at standstill up to {number(error, 3)}° electrical{at}"))
    if report.injection_left_by_map_deg is not None:
        left = number(report.injection_left_by_map_deg, 3)
        rows.append(("... corrected by the map", f"at standstill up to {left}° electrical"))
    return [*rows, *_observer_rows(report)]


def _observer_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The speeds from which an observer works, with R_s as it is and with R_s of a winding that is 50 K warmer."""
    warm, cold = report.observer_speed_warm_rpm, report.observer_speed_rpm
    if warm is None or cold is None:
        return [("back-EMF observer", "position error above 5° electrical at every speed")]
    floor = MIN_OBSERVER_SPEED_RATIO * report.largest_speed_rpm
    right = f"from {cold:.0f} rpm on"
    if cold < floor:
        right = f"from less than {floor:.0f} rpm on, where drift and offsets decide; these are not counted"
    return [
        (
            "back-EMF observer",
            f"position error below 5° electrical from {warm:.0f} rpm on, with the winding 50 K warmer",
        ),
        ("... with R_s of the warm winding", right),
    ]
