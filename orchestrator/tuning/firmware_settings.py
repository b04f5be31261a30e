"""Current-control settings of open drives (ODrive, SimpleFOC, VESC), which know one inductance, from a tuning.

Their controllers have constant gains, kp = alpha L and ki = alpha R_s, so that the loop is faster by L / L(i) where
saturation has lowered the inductance. The least inductance within the current limit therefore keeps the bandwidth, and
the phase margin with it, at every current; elsewhere the control is slower. Each file says what it leaves out of the
tuning. Sources, read for the formulas:

========= =================================================================================================
ODrive    docs.odriverobotics.com; `Motor::update_current_controller_gains` (p = bandwidth L, i = p R / L)
SimpleFOC docs.simplefoc.com/tuning_current_loop (P = L 2 pi f, I = R 2 pi f)
VESC      vesc-project.com; `conf_general_calc_apply_foc_cc_kp_ki_gain` (kp = L bw, ki = R bw); `foc_dt_us` in
          `mcpwm_foc.c` (a time of a PWM period, by the sign of the current)
========= =================================================================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from orchestrator.flux_maps import ROOM_C, in_ascii
from orchestrator.formatting.names import plain
from orchestrator.formatting.quantities import number, quantity
from orchestrator.formatting.sentences import listed
from orchestrator.numerics.tables import value_at
from orchestrator.tuning.compensation import Compensation
from orchestrator.tuning.current_control import CurrentControl
from orchestrator.tuning.limits import DriveLimits
from orchestrator.tuning.losses import NEGLIGIBLE_RATIO
from orchestrator.tuning.machine import Machine
from protocols import FluxMap

TITLES = {"odrive": "ODrive", "simplefoc": "SimpleFOC", "vesc": "VESC"}


@dataclass(frozen=True)
class _Setting:
    name: str
    value: float
    formula: str


def settings_for_firmware(
    machine: Machine, limits: DriveLimits, control: CurrentControl, compensation: Compensation
) -> dict[str, bytes]:
    """One text of `name = value` lines for each firmware, by file name; comments begin with #.

    Parameters
    ----------
    machine : Machine
        For the inductances and the flux without current, and what R_s and the magnet rest on.
    limits : DriveLimits
        The settings hold within its current limit and at its sampling frequency.
    control : CurrentControl
    compensation : Compensation
        For the inverter's loss, of which VESC takes the part in proportion to the bus voltage.
    """
    d, q = (one.inductance_h for one in control.least)
    least = min(d, q)
    rest_d, rest_q = _at_rest(control, machine.flux_map)
    alpha, r_s = control.bandwidth_rad_s, control.r_s_ohm
    linkage = _linkage_wb(machine.flux_map)
    lost_us = 1e6 * float(compensation.lost_per_bus_v[-1]) / limits.pwm_hz
    texts = {
        "odrive": (
            _Setting("current_control_bandwidth", alpha, "alpha [rad/s]"),
            _Setting("phase_inductance", least, "L, the least of d and q [H]"),
            _Setting("phase_resistance", r_s, "R_s [ohm]"),
        ),
        "simplefoc": (
            _Setting("PID_current_d.P", alpha * d, "alpha L_d [V/A]"),
            _Setting("PID_current_d.I", alpha * r_s, "alpha R_s [V/(A s)]"),
            _Setting("PID_current_q.P", alpha * q, "alpha L_q [V/A]"),
            _Setting("PID_current_q.I", alpha * r_s, "alpha R_s [V/(A s)]"),
            _Setting("PID_current_d.limit", limits.voltage_v, "bus / sqrt 3 [V]"),
            _Setting("PID_current_q.limit", limits.voltage_v, "bus / sqrt 3 [V]"),
            _Setting("LPF_current_d.Tf", 0.0, "no filter [s]: the phase margin allows none, least of all the default"),
            _Setting("LPF_current_q.Tf", 0.0, "no filter [s]"),
        ),
        "vesc": (
            _Setting("foc_current_kp", alpha * least, "alpha L, L the least of d and q [V/A]"),
            _Setting("foc_current_ki", alpha * r_s, "alpha R_s [V/(A s)]"),
            _Setting("foc_motor_r", r_s, "R_s [ohm]"),
            _Setting(
                "foc_temp_comp_base_temp",
                ROOM_C if control.winding_c is None else control.winding_c,
                "at which R_s holds [degC]; used where foc_temp_comp is on",
            ),
            _Setting("foc_motor_l", 0.5 * (rest_d + rest_q), "(L_d + L_q) / 2 without current [H]"),
            _Setting("foc_motor_ld_lq_diff", rest_q - rest_d, "L_q - L_d without current [H]"),
            *([] if linkage is None else [_Setting("foc_motor_flux_linkage", linkage, "psi_d without current [Wb]")]),
            *(
                [_Setting("foc_dt_us", lost_us, f"effective dead time at {number(limits.pwm_hz)} Hz PWM [us]")]
                if lost_us > 0.0
                else []
            ),
        ),
    }
    left_out = {name: _left_out(name, limits, control, compensation, lost_us) for name in texts}
    if linkage is None:
        left_out["vesc"].append("foc_motor_flux_linkage: the map does not reach zero current")
    heading = _heading(machine, limits, control)
    return {f"{name}.txt": _text(TITLES[name], heading, texts[name], left_out[name]) for name in texts}


def _linkage_wb(flux_map: FluxMap) -> float | None:
    return value_at((flux_map.i_d, flux_map.i_q), flux_map.psi_d, 0.0, 0.0)


def _at_rest(control: CurrentControl, flux_map: FluxMap) -> tuple[float, float]:
    """L_dd and L_qq without current [H], as the report has them."""
    axes = (flux_map.i_d, flux_map.i_q)
    l_d, l_q = (value_at(axes, table, 0.0, 0.0) for table in (flux_map.l_dd, flux_map.l_qq))
    if l_d is not None and l_q is not None:
        return l_d, l_q
    d, q = control.least
    return d.at_rest_h, q.at_rest_h


def _heading(machine: Machine, limits: DriveLimits, control: CurrentControl) -> list[str]:
    """What the settings are for and rest on."""
    alpha = control.bandwidth_rad_s
    # The open loop is alpha e^(-s T) / s where L is least. The control of flux has an integral part beside it.
    margin_deg = 90.0 - math.degrees(alpha * control.delay_s)
    return [
        f"One update each {1e6 / limits.sampling_hz:.4g} us, up to {limits.current_a:.4g} A peak.",
        *(basis[0].upper() + basis[1:] + "." for basis in machine.basis),
        "PI current control with constant gains: kp = alpha L, ki = alpha R_s.",
        f"alpha = {alpha:.4g} rad/s, a bandwidth of {alpha / (2.0 * math.pi):.4g} Hz: phase margin "
        f"{margin_deg:.0f}° at standstill where L is least, with a delay of {1e6 * control.delay_s:.4g} us.",
        *(
            f"L_{axis} = {quantity(one.inductance_h, 'H')}: incremental, the least within the current limit, at "
            f"(i_d, i_q) = ({one.i_d_a:.3g}, {one.i_q_a:.3g}) A; without current {quantity(one.at_rest_h, 'H')}."
            for axis, one in zip("dq", control.least, strict=True)
        ),
    ]


def _left_out(
    firmware: str, limits: DriveLimits, control: CurrentControl, compensation: Compensation, lost_us: float
) -> list[str]:
    """What of the tuning a file does not hold."""
    of_bus_v, rest_v = compensation.lost_parts_v(limits.bus_v)
    of_time = firmware == "vesc" and lost_us > 0.0
    lost_v = rest_v if of_time else of_bus_v + rest_v
    whole = quantity(of_bus_v + rest_v, "V")
    has_one_gain = firmware != "simplefoc"
    least_h = min(one.inductance_h for one in control.least)
    slowest = min((least_h if has_one_gain else one.inductance_h) / one.at_rest_h for one in control.least)
    lines = []
    if abs(lost_v) > NEGLIGIBLE_RATIO * abs(of_bus_v + rest_v):
        part = f"{quantity(rest_v, 'V')} of the {whole}" if of_time else f"{whole}, nothing of it"
        lines.append(f"the inverter's loss of a leg: {part} {'is no dead time' if of_time else 'is compensated'}")
    if compensation.corrects_readings:
        lines.append(f"corrections of readings, angle and delay ({listed([plain(n) for n in compensation.sources])})")
    slow = "without current a bandwidth is down to"
    if slowest < 1.0 - NEGLIGIBLE_RATIO:
        lines.append(f"inductance over current: the gains are constant; {slow} {100.0 * slowest:.0f} % of the above")
    lines.append("current references: MTPA and field weakening are in references.csv")
    if firmware != "vesc":
        lines.append("R_s over temperature: enter the warm winding's, or retune")
    return lines


def _text(firmware: str, heading: list[str], settings: tuple[_Setting, ...], left_out: list[str]) -> bytes:
    width = max(len(setting.name) for setting in settings)
    lines = [
        f"# Settings of {firmware}, written by fluxbench.",
        *(f"# {line}" for line in heading),
        *(f"{s.name:{width}} = {s.value:<12.6g} # {s.formula}" for s in settings),
        "# Not in this file, and not compensated by these settings:",
        *(f"#   {line}" for line in left_out),
    ]
    return in_ascii("\n".join(lines) + "\n").encode("ascii")
