"""Current-control settings of open drives (ODrive, SimpleFOC, VESC), which know one inductance, from a tuning.

Their controllers have constant gains, kp = alpha L and ki = alpha R_s, so that the loop is faster by L / L(i) where
saturation has lowered the inductance. The least inductance within the current limit therefore keeps the bandwidth, and
the phase margin with it, at every current; elsewhere the control is slower. Sources, read for the formulas:

========= =================================================================================================
ODrive    docs.odriverobotics.com; `Motor::update_current_controller_gains` (p = bandwidth L, i = p R / L)
SimpleFOC docs.simplefoc.com/tuning_current_loop (P = L 2 pi f, I = R 2 pi f)
VESC      vesc-project.com; `conf_general_calc_apply_foc_cc_kp_ki_gain` (kp = L bw, ki = R bw)
========= =================================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.numerics.tables import value_at
from orchestrator.tuning.current_control import CurrentControl
from orchestrator.tuning.limits import DriveLimits
from protocols import FluxMap, InputError

WHERE = "firmware settings"


@dataclass(frozen=True)
class _Setting:
    name: str
    value: float
    formula: str


def settings_for_firmware(
    control: CurrentControl, limits: DriveLimits, flux_map: FluxMap | None = None, lost_time_s: float = 0.0
) -> dict[str, bytes]:
    """One text of `name = value` lines for each firmware, by file name; comments begin with #.

    Parameters
    ----------
    control : CurrentControl
    limits : DriveLimits
        The settings hold within its current limit and at its sampling frequency.
    flux_map : FluxMap, optional
        For the inductances and the flux without current; by default, and where it has none, they are the control's.
    lost_time_s : float
        Time that each leg loses in a PWM period; zero where it is not known.

    Raises
    ------
    InputError
        Where the map has an inductance within the current limit that is not positive.
    """
    d, q = least_inductances_h(control, limits)
    least = min(d, q)
    rest_d, rest_q = _at_rest(control, flux_map)
    alpha, r_s = control.bandwidth_rad_s, control.r_s_ohm
    linkage = None if flux_map is None else value_at((flux_map.i_d, flux_map.i_q), flux_map.psi_d, 0.0, 0.0)
    texts = {
        "odrive": (
            _Setting("current_control_bandwidth", alpha, "alpha [rad/s]"),
            _Setting("phase_inductance", least, "least incremental inductance [H]"),
            _Setting("phase_resistance", r_s, "R_s [ohm]"),
        ),
        "simplefoc": (
            _Setting("PID_current_d.P", alpha * d, "alpha L_dd, the least [V/A]"),
            _Setting("PID_current_d.I", alpha * r_s, "alpha R_s [V/(A s)]"),
            _Setting("PID_current_q.P", alpha * q, "alpha L_qq, the least [V/A]"),
            _Setting("PID_current_q.I", alpha * r_s, "alpha R_s [V/(A s)]"),
            _Setting("PID_current_d.limit", limits.voltage_v, "bus / sqrt 3 [V]"),
            _Setting("PID_current_q.limit", limits.voltage_v, "bus / sqrt 3 [V]"),
            _Setting("LPF_current_d.Tf", 0.0, "no filter [s]: the phase margin allows none, least of all the default"),
            _Setting("LPF_current_q.Tf", 0.0, "no filter [s]"),
        ),
        "vesc": (
            _Setting("foc_current_kp", alpha * least, "alpha L, the least [V/A]"),
            _Setting("foc_current_ki", alpha * r_s, "alpha R_s [V/(A s)]"),
            _Setting("foc_motor_r", r_s, "R_s [ohm]"),
            _Setting("foc_motor_l", 0.5 * (rest_d + rest_q), "(L_d + L_q) / 2 without current [H]"),
            _Setting("foc_motor_ld_lq_diff", rest_q - rest_d, "L_q - L_d without current [H]"),
            *([] if linkage is None else [_Setting("foc_motor_flux_linkage", linkage, "psi_d without current [Wb]")]),
            *(
                [_Setting("foc_dt_us", 1e6 * lost_time_s, "time that a leg loses in a period [us]")]
                if lost_time_s
                else []
            ),
        ),
    }
    files = {f"{name}.txt": _text(name, settings, control, limits) for name, settings in texts.items()}
    if linkage is None:
        files["vesc.txt"] += b"# foc_motor_flux_linkage is missing: the map does not reach zero current\n"
    return files


def least_inductances_h(control: CurrentControl, limits: DriveLimits) -> tuple[float, float]:
    """Least incremental inductance towards d and q within the current limit, cross-saturation included [H].

    A step on one axis meets 1 / (L^-1)_kk, which is below L_kk by L_dq^2 / L of the other axis.
    """
    at = np.stack(np.meshgrid(control.gain_i_d_a, control.gain_i_q_a, indexing="ij"), axis=-1)
    steps = [axis[1] - axis[0] for axis in (control.gain_i_d_a, control.gain_i_q_a)]
    inside = np.linalg.norm(at, axis=-1) <= limits.current_a + max(steps)
    dd, dq, qq = np.moveaxis(control.inductance_h[inside], -1, 0)
    determinant = dd * qq - dq**2
    if not (np.isfinite(determinant).all() and (determinant > 0.0).all() and (dd > 0.0).all()):
        raise InputError(WHERE, "inductance_h", "an inductance within the current limit is not positive")
    return float((determinant / qq).min()), float((determinant / dd).min())


def _at_rest(control: CurrentControl, flux_map: FluxMap | None) -> tuple[float, float]:
    """L_dd and L_qq without current [H], as the report has them."""
    if flux_map is not None:
        axes = (flux_map.i_d, flux_map.i_q)
        l_d, l_q = (value_at(axes, table, 0.0, 0.0) for table in (flux_map.l_dd, flux_map.l_qq))
        if l_d is not None and l_q is not None:
            return l_d, l_q
    nodes = (control.gain_i_d_a, control.gain_i_q_a)
    origin = [float(np.clip(0.0, axis[0], axis[-1])) for axis in nodes]
    l_d, l_q = (value_at(nodes, control.inductance_h[..., k], *origin) for k in (0, 2))
    return l_d or 0.0, l_q or 0.0


def _text(firmware: str, settings: tuple[_Setting, ...], control: CurrentControl, limits: DriveLimits) -> bytes:
    period_us = 1e6 / limits.sampling_hz
    opening = (
        f"# {firmware}: current control, one update each {period_us:.4g} us, up to {limits.current_a:.4g} A peak\n"
        f"# alpha = {control.bandwidth_rad_s:.4g} rad/s, delay {1e6 * control.delay_s:.4g} us\n"
    )
    width = max(len(setting.name) for setting in settings)
    lines = (f"{s.name:{width}} = {s.value:<12.6g} # {s.formula}\n" for s in settings)
    return (opening + "".join(lines)).encode("ascii")
