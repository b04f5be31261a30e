"""The figures of a tuning in words, for the command line and the report."""

from __future__ import annotations

import math

from orchestrator.flux_maps import magnet_basis, resistance_basis
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number, quantity, vector
from orchestrator.formatting.sentences import listed
from orchestrator.tuning.losses import loss_basis
from orchestrator.tuning.sensorless import MAX_POSITION_ERROR_RAD, WARMING_K
from orchestrator.tuning.tuning_report import TuningReport

FILE_CONTENTS = (
    ("_int32.h", None),
    ("_int32.c", "C code in int32, for parts without an FPU, and its .h"),
    (".h", None),
    (".c", "C code in float: references, gains, compensation, angle; and its .h"),
    ("references.csv", "i_d and i_q [A] over torque [Nm] and flux limit [Wb]: MTPA, field weakening, MTPV"),
    ("torque.csv", "largest torque [Nm] and power [W] over speed"),
    ("compensation.csv", "voltage that a leg loses [V] over its current [A]"),
    ("tuning.svg", "torque, references, loss and injection's error in pictures; what the tuning changes"),
    ("odrive.txt", "PI current control alone: no compensation, no MTPA, no saturation"),
    ("simplefoc.txt", "PI current control alone: no compensation, no MTPA, no saturation"),
    ("vesc.txt", "PI current control, motor model, dead time; no MTPA table, no saturation"),
    ("tuning.json", "the figures above, for programs"),
)
"""Endings of the written files and what these hold; a header is named with its source file."""

MIN_SATURATION_RATIO = 1.01
"""Inductance without current over the least one from which the bandwidth without current has its figure."""
AXIS_ANGLE = "θ = θ_tracked + ½ atan2(2 L_dq, L_qq − L_dd)"
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
        ("R_s", resistance_basis(report.r_s_ohm, None if report.r_s_temperature_is_assumed else report.r_s_at_c)),
        *_control_rows(report),
        *_compensation_rows(report),
        *_injection_rows(report),
        *_observer_rows(report),
    ]


def _control_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The C code's control of flux, then the gains of plain PI controllers of currents."""
    margins = f"{report.least_phase_margin_deg:.0f}° at standstill, {report.margins_deg[-1]:.0f}° at "
    margins = f"phase margin at least {margins}{report.largest_speed_rpm:.0f} rpm"
    bandwidth = f"{number(report.bandwidth_hz, 3)} Hz"
    return [
        ("flux control in the C code", f"bandwidth {bandwidth} at every current; {margins}"),
        *_gain_rows(report, bandwidth),
    ]


def _gain_rows(report: TuningReport, bandwidth: str) -> list[tuple[str, str]]:
    """The gains of plain PI controllers of currents, with the inductances that they are of."""
    if report.k_p_v_per_a is None or report.k_i_v_per_as is None:
        return []
    rows = [
        (
            "PI current control instead",
            f"k_p = 2π {bandwidth} · L and k_i = 2π {bandwidth} · R_s, constant, as in the .txt files",
        ),
        ("... k_i of i_d and i_q", f"{number(report.k_i_v_per_as, 3)} V/(A s)"),
    ]
    least, at, rest = report.least_inductance_h, report.least_inductance_at_a, report.rest_inductance_h
    if least is None or at is None or rest is None:
        return rows
    for axis, k_p, l_h, place, rest_h in zip("dq", report.k_p_v_per_a, least, at, rest, strict=True):
        text = f"{number(k_p, 3)} V/A by L_{axis} = {quantity(l_h, 'H')}"
        if rest_h > MIN_SATURATION_RATIO * l_h:
            slow = f"{number(report.bandwidth_hz * l_h / rest_h, 3)} Hz"
            text += f", the least, at {vector(*place)}; without current {quantity(rest_h, 'H')}, so {slow}"
        rows.append((f"... k_p of i_{axis}", text))
    return rows


def _compensation_rows(report: TuningReport) -> list[tuple[str, str]]:
    """What the code compensates, and which part of the inverter's loss is a time."""
    rows = [("compensated by the C code", listed([plain(name) for name in report.compensated]) or "nothing")]
    if not report.lost_v:
        return rows
    at = f"at {quantity(report.current_limit_a, 'A')} and {quantity(report.bus_v, 'V')} bus"
    rows.append(("inverter's loss", f"{quantity(report.lost_v, 'V')} a leg {at}"))
    of_time_v = report.lost_v if report.lost_in_proportion_to_bus_v is None else report.lost_in_proportion_to_bus_v
    parts = loss_basis(report.lost_v, of_time_v, report.lost_time_s, report.pwm_hz)
    return [*rows, *((f"... {name}", text) for name, text in parts)]


def notes(report: TuningReport) -> list[str]:
    """The remarks, and the effects that are not compensated, or in part, with their reasons."""
    left_out = [
        f"{plain(name)}: {reason}" if name in report.compensated else f"not compensated: {plain(name)} ({reason})"
        for name, reason in report.left_out.items()
    ]
    return [*(remark.text for remark in report.remarks), *left_out]


def _torque_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The largest torque, the speeds at which it is available and what is left beyond, and what it rests on."""
    torque, base = quantity(report.largest_torque_nm, "Nm"), f"{report.base_speed_rpm:.0f} rpm"
    largest = f"{report.largest_speed_rpm:.0f} rpm"
    if report.base_speed_rpm >= report.largest_speed_rpm:
        text = f"{torque} at every speed up to the limit of {largest}; the voltage would suffice up to {base}"
        rows = [("largest torque", text)]
    else:
        left = quantity(report.torque_at_largest_speed_nm, "Nm")
        rows = [
            ("largest torque", f"{torque} up to {base}; beyond, the voltage limits it"),
            ("... left at the largest speed", f"{left} at {largest}"),
        ]
    magnet = report.nameplate_magnet_wb
    return rows if magnet is None else [*rows, ("... by the magnet's flux", magnet_basis(magnet))]


def file_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The written files, each with what it holds."""
    known = [(name, next((text for end, text in FILE_CONTENTS if name.endswith(end)), "")) for name in report.files]
    return [(name, text) for name, text in known if text is not None]


def _injection_rows(report: TuningReport) -> list[tuple[str, str]]:
    """At which of the references injection is usable, by `MAX_POSITION_ERROR_RAD`, and what is to be compensated."""
    share, error, place = report.injection_works_percent, report.injection_error_deg, report.injection_error_at_a
    name, limit = "sensorless by injection", f"{math.degrees(MAX_POSITION_ERROR_RAD):.0f}°"
    if share is None:
        return []
    if share < MIN_USEFUL_SHARE_PERCENT or error is None or place is None:
        where = f"{number(share, 2)} % of the currents within {quantity(report.current_limit_a, 'A')}"
        return [(name, f"not usable on this motor: the saliency suffices at {where}; use a sensor")]
    fails = report.injection_fails_at_a
    reach = f"up to {quantity(report.current_limit_a, 'A')}" if fails is None else f"below {_length(fails)}"
    beyond = [] if fails is None else [("... beyond", "the saliency is too small: limit the current, or use a sensor")]
    if error <= math.degrees(MAX_POSITION_ERROR_RAD):
        text = f"usable {reach} as it is: angle error {number(error, 2)}° at most, within the limit of {limit}"
        return [(name, text), *beyond]
    within = report.injection_within_limit_a
    as_it_is = "at no current" if within is None else f"up to {quantity(within, 'A')}"
    left = report.injection_left_by_map_deg
    is_enough = left is not None and left <= math.degrees(MAX_POSITION_ERROR_RAD)
    usable = f"usable {reach} along MTPA if its angle error is compensated" if is_enough else f"usable {as_it_is}"
    rows = [
        (name, usable),
        *beyond,
        ("... as it is", f"{as_it_is} along MTPA the angle error stays within the limit of {limit} electrical"),
        ("... error to compensate", f"up to {number(error, 3)}° electrical, at {vector(*place)}: {AXIS_ANGLE}"),
    ]
    if left is not None:
        rows.append(("", f"with L of the C code's table at i_ref; up to {number(left, 2)}° is left"))
    rows.append(("", "electrical angles from phase a's axis to the d axis [rad], positive towards phase b's"))
    return rows


def _length(i_dq: tuple[float, float]) -> str:
    return quantity(math.hypot(*i_dq), "A")


def _observer_rows(report: TuningReport) -> list[tuple[str, str]]:
    """The speeds from which an observer works, with R_s of a winding that is 50 K warmer, and with R_s as it is."""
    warm, cold = report.observer_speed_warm_rpm, report.observer_speed_rpm
    name = "sensorless by back-EMF"
    limit = f"{math.degrees(MAX_POSITION_ERROR_RAD):.0f}°"
    if warm is None or cold is None:
        return [(name, f"not usable: the angle error exceeds the limit of {limit} electrical at every speed")]
    floor = MIN_OBSERVER_SPEED_RATIO * report.largest_speed_rpm
    right = f"from {cold:.0f} rpm on"
    if cold < floor:
        right = f"from less than {floor:.0f} rpm on, where drift and offsets decide; these are not counted"
    return [
        (
            name,
            f"usable from {warm:.0f} rpm on: angle error within {limit} though the winding is {WARMING_K:.0f} K warmer",
        ),
        ("... if R_s follows the winding", right),
    ]
