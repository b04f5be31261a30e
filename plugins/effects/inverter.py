"""Voltage errors of the inverter that follow the sign of the phase current: dead time and device drop."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.frames import from_two_phases, inductance_to_ab
from orchestrator.numerics.kernels import phases_of, vector_of
from orchestrator.numerics.types import Array
from plugins.effects._batches import BatchEffect, pwm_share, rated_current_a
from plugins.effects._commutation import Swing, lost_at_edges, swing_lines
from plugins.effects._filters import lagged_steps
from plugins.effects._losses import along_losses
from plugins.effects._vectors import Starts, doubles, less_constant
from protocols import (
    Contrast,
    Correction,
    DriveRecord,
    EffectLayer,
    EffectParameters,
    LossHistory,
    RealArray,
    Remark,
    RemarkingEffect,
    SignalBatch,
    amplitude,
    refinement,
    shape,
)

PART_WIDTHS = (0.5, 1.5, 3.0)
"""Widths, in thresholds, of the additional components of a `Knee`."""
PART_EXPONENT = 3.0
"""Exponent of these components. With them tanh, arctan, Langevin's and the Gaussian step, an exponential, straight and
rounded ramps, and mixtures of them are approximated to 1.5e-3 of the step (rms to six thresholds)."""

MIN_LEG_DIFFERENCE_RATIO = 0.03
"""Relative difference of a leg's dead time from which a remark is made: gate drivers of one type differ less."""

COARSE_TABLE_RATIO = 32.0
"""Ratio of the second table's step, for currents far beyond the knee, where a logarithm is linear to 1e-5."""


def _soft_sign(x: Array, softness: float, parts: tuple[float, ...]) -> Array:
    """s(x) for x >= 0: x / (1 + x^p)^(1/p), mixed with `parts` of the widths `PART_WIDTHS`."""
    whole = (1.0 - sum(parts)) * _knee(x, 1.0 / softness)
    for part, width in zip(parts, PART_WIDTHS, strict=True):
        if part != 0.0:
            whole += part * _knee(x / width, PART_EXPONENT)
    return whole


def _charging(x: Array) -> Array:
    """Lost voltage with linear capacitive commutation, whose swing takes the dead time at x = 1."""
    return np.asarray(np.where(x < 1.0, 0.5 * x, 1.0 - 0.5 / np.maximum(x, 1.0)), dtype=np.float64)


def _knee(x: Array, sharpness: float) -> Array:
    small = np.minimum(x, 1.0)
    large = np.maximum(x, 1.0)
    below = small / (1.0 + small**sharpness) ** (1.0 / sharpness)
    above = 1.0 / (1.0 + large**-sharpness) ** (1.0 / sharpness)
    return np.asarray(np.where(x <= 1.0, below, above), dtype=np.float64)


@lru_cache(maxsize=32)
def _tables(softness: float, parts: tuple[float, ...], charged: float, growth: float, step: float, end: float) -> Array:
    """Tables of s: one up to `end`, one `COARSE_TABLE_RATIO` times as coarse and long; shape (2, m)."""
    # The part `charged` is `_charging`, the part `growth` log(1 + x), and the remainder `_soft_sign`.

    def whole(x: Array) -> Array:
        mere = _soft_sign(x, softness, parts)
        return (1.0 - charged - growth) * mere + charged * _charging(x) + growth * np.log1p(x)

    x = np.arange(0.0, end + 1.5 * step, step)
    return np.stack([whole(x), whole(COARSE_TABLE_RATIO * x)])


@njit(cache=True, nogil=True)
def _look_up(tables: Array, place: float, growth: float) -> float:
    """Odd function s at a current in steps of the first table; beyond both, extrapolated by `growth` log(x)."""
    size, end = abs(place), tables.shape[1] - 1
    if size < end:
        m = int(size)
        value = tables[0, m] + (size - m) * (tables[0, m + 1] - tables[0, m])
    elif size < COARSE_TABLE_RATIO * end:
        size /= COARSE_TABLE_RATIO
        m = int(size)
        value = tables[1, m] + (size - m) * (tables[1, m + 1] - tables[1, m])
    elif growth == 0.0:
        value = tables[1, end]
    else:
        value = tables[1, end] + growth * math.log(size / (COARSE_TABLE_RATIO * end))
    return float(value if place >= 0.0 else -value)


@njit(cache=True, nogil=True)
def _without_sign(
    v_ab: Array, i_ab: Array, starts: Starts, volts: Array, legs: Array, steps: float, tables: Array, growth: float
) -> Array:
    """v - volts s, s averaged over each interval by Simpson's rule; `steps` is the number of table steps per ampere."""
    out = np.empty_like(v_ab)
    for s in range(starts.shape[0] - 1):
        first, last = starts[s], starts[s + 1] - 1
        a0, b0, c0 = phases_of(steps * i_ab[first, 0], steps * i_ab[first, 1])
        s0, s1, s2 = _look_up(tables, a0, growth), _look_up(tables, b0, growth), _look_up(tables, c0, growth)
        for k in range(first, last + 1):
            after = min(k + 1, last)
            a1, b1, c1 = phases_of(steps * i_ab[after, 0], steps * i_ab[after, 1])
            e0, e1, e2 = _look_up(tables, a1, growth), _look_up(tables, b1, growth), _look_up(tables, c1, growth)
            m0 = s0 + 4.0 * _look_up(tables, 0.5 * (a0 + a1), growth) + e0
            m1 = s1 + 4.0 * _look_up(tables, 0.5 * (b0 + b1), growth) + e1
            m2 = s2 + 4.0 * _look_up(tables, 0.5 * (c0 + c1), growth) + e2
            sixth = volts[k] / 6.0
            alpha, beta = vector_of(legs[0] * m0, legs[1] * m1, legs[2] * m2)
            out[k, 0] = v_ab[k, 0] - sixth * alpha
            out[k, 1] = v_ab[k, 1] - sixth * beta
            a0, b0, c0 = a1, b1, c1
            s0, s1, s2 = e0, e1, e2
    return out


class Knee(EffectParameters):
    """Shape of the step at zero current."""

    softness: float = refinement("1", neutral=0.5, prior_width=0.3, low=0.02, high=1.0)
    narrow: float = refinement("1", neutral=0.0, prior_width=0.3, low=-1.0, high=1.0, detail=True)
    wide: float = refinement("1", neutral=0.0, prior_width=0.3, low=-1.0, high=1.0, detail=True)
    wider: float = refinement("1", neutral=0.0, prior_width=0.3, low=-1.0, high=1.0, detail=True)


def _less_step(
    batch: SignalBatch,
    volts: Array,
    threshold_a: float,
    knee: Knee,
    legs: Array,
    *,
    charged: float = 0.0,
    growth: float = 0.0,
    step: float = 0.01,
    end: float = 40.0,
) -> Array:
    """The voltage minus `volts` (N,) with the sign of each phase current, in each leg times its factor `legs` (3,)."""
    # s is interpolated from `_tables` with this `step` and `end`, in thresholds.
    tables = _tables(knee.softness, (knee.narrow, knee.wide, knee.wider), charged, growth, step, end)
    steps = 1.0 / (threshold_a * step)
    courses = (doubles(batch.v_ab), _without_noise(batch), batch.starts)
    return np.asarray(_without_sign(*courses, volts, legs, steps, tables, growth))


class DeadTime(BatchEffect, RemarkingEffect):
    """Blanking time between the switches of a leg.

    e = T V_dt s(x), x = i_abc / i_th, V_dt = t_d f_pwm V_dc; the impressed voltage is v* - e. The capacitances of a leg
    make s cross zero within i_th; in the simple form s(x) = x / (1 + |x|^p)^(1/p).

    ====== ============== ==================================================================================== ====
    symbol name           meaning                                                                              unit
    ====== ============== ==================================================================================== ====
    V_dt   voltage_v      lost voltage at the drive's nominal PWM frequency and bus voltage                    V
    i_th   threshold_a    current within which s crosses zero; C V_dc / t_d, C of both devices of a leg        A
    1/p    softness       rounding of the step                                                                 1
    w_1..3 narrow to ...  parts of the step with widths of 0.5 (`narrow`), 1.5 (`wide`) and 3 i_th (`wider`)   1
    c      charged        part with constant capacitances: s = x / 2 up to i_th, 1 - 1 / (2 x) above           1
    h      switched       part lost edge by edge at instantaneous currents (`plugins.effects._commutation`)    1
    m      grading        exponent of the capacitances' decrease with voltage (`switched`)                     1
    r      takeover       extra delay of an edge against the motor's rated current, over t_d (`switched`)      1
    y      yielding       response of currents within a swing over the inductance's (`switched`)               1
    a      leg_a_longer   leg a's dead time minus the mean, over the mean; b and c each have -a / 2            1
    b      leg_b_over_c   half the difference of b's and c's dead times, over the mean                         1
    ====== ============== ==================================================================================== ====

    Source: S.-G. Jeong, M.-H. Park, IEEE Trans. Ind. Electron. 38 (1991), doi:10.1109/41.88903.
    """

    name: ClassVar[str] = "dead_time"
    summary: ClassVar[str] = "The inverter's dead time takes voltage against the sign of each phase current."
    signature: ClassVar[str] = (
        "Residual against each phase's current: a step up where the current turns positive; larger at a higher "
        "PWM frequency."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_PWM_FREQUENCY,)
    gauge: ClassVar[str] = ""

    at_the_bench: ClassVar[str] = "compare with the dead time that is set and with the gate drivers' data sheet"

    class Parameters(Knee):
        voltage_v: float = amplitude("V", typical=8.0, prior_width=8.0, low=-60.0, high=60.0)
        threshold_a: float = shape("A", typical=0.1, prior_width=1.0, low=1e-3, high=10.0, other_form=2.0)
        charged: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.0)
        switched: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.0, other_form=1.0, detail=True)
        grading: float = refinement("1", neutral=0.0, prior_width=0.4, low=0.0, high=0.8, other_form=0.5)
        takeover: float = refinement("1", neutral=0.0, prior_width=0.05, low=0.0, high=1.0)
        yielding: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.5)
        leg_a_longer: float = refinement("1", neutral=0.0, prior_width=0.1, low=-0.95, high=2.0, detail=True)
        leg_b_over_c: float = refinement("1", neutral=0.0, prior_width=0.1, low=-1.5, high=1.5, detail=True)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the voltage lost from the commanded voltage."""
        volts = batch.per_sample(p.voltage_v * pwm_share(batch) / _nominal_bus_v(batch)) * batch.v_dc
        v_ab = batch.v_ab
        legs = np.maximum([1.0 + longer for longer in _longer(p)], 0.0)
        if p.switched < 1.0:
            unswitched = volts if p.switched == 0.0 else (1.0 - p.switched) * volts
            v_ab = _less_step(batch, unswitched, p.threshold_a, p, legs, charged=p.charged)
        if p.switched > 0.0:
            lost = _lost_at_edges(batch, volts, legs, p)
            lost *= -p.switched
            lost += v_ab
            v_ab = lost
        return Correction(v_ab=v_ab)

    def derived(self, p: Parameters, drive: DriveRecord) -> dict[str, tuple[float, str]]:
        """The dead time t_d = V_dt / (f_pwm V_dc), and the charge i_th t_d of a swing with capacitive commutation."""
        if drive.pwm_frequency_hz is None:
            return {}
        dead_time_s = p.voltage_v / (drive.pwm_frequency_hz * drive.dc_bus_voltage_v)
        quantities = {"dead_time": (dead_time_s, "s")}
        if p.charged > 0.0 or p.switched > 0.0:
            quantities["charge_of_a_swing"] = (p.threshold_a * abs(dead_time_s), "C")
        return quantities

    def remarks(self, p: Parameters) -> list[Remark]:
        """A remark on the leg whose dead time differs most from the mean."""
        legs = dict(zip("abc", _longer(p), strict=True))
        leg = max(legs, key=lambda one: abs(legs[one]))
        if abs(legs[leg]) < MIN_LEG_DIFFERENCE_RATIO:
            return []
        text = "leg {leg}'s is {percent:.2g} % {which} than the legs' mean: look at its gate driver"
        which = "longer" if legs[leg] > 0.0 else "shorter"
        return [Remark.of("leg_differs", text, leg=leg, percent=100.0 * abs(legs[leg]), which=which)]


def _nominal_bus_v(batch: SignalBatch) -> RealArray | float:
    """The drive's nominal bus voltage, or else the mean over each segment (segments,)."""
    if batch.drive is not None:
        return batch.drive.dc_bus_voltage_v
    return np.array([np.mean(batch.v_dc[batch.slice_of(k)]) for k in range(len(batch.segments))])


def _lost_at_edges(batch: SignalBatch, volts: Array, legs: Array, p: DeadTime.Parameters) -> Array:
    """Voltage (N, 2) lost edge by edge, for V_dt = `volts` (N,)."""
    # The current is nearly linear between samples: two carrier periods represent all of them.
    cycles = np.clip(np.round(batch.pwm_frequency_hz / batch.sampling_frequency_hz), 1, 2).astype(np.int64)
    takeover = p.takeover * p.threshold_a / (rated_current_a(batch) or p.threshold_a)
    swing = Swing(swing_lines(p.grading), takeover, p.yielding)
    courses = (doubles(batch.v_ab), _without_noise(batch), volts, batch.starts)
    carrier = (_inductance(batch), doubles(1.0 / batch.pwm_frequency_hz), cycles)
    return np.asarray(lost_at_edges(*courses, legs, 1.0 / p.threshold_a, *carrier, swing))


def _longer(p: DeadTime.Parameters) -> tuple[float, float, float]:
    """Each leg's dead time minus the mean, over the mean."""
    others = -0.5 * p.leg_a_longer
    return p.leg_a_longer, others + p.leg_b_over_c, others - p.leg_b_over_c


def _without_noise(batch: SignalBatch) -> Array:
    """The stator current without noise where known: the curvature near zero would rectify noise."""
    return doubles(batch.i_ab if batch.i_quiet_ab is None else batch.i_quiet_ab)


def _inductance(batch: SignalBatch) -> Array:
    """L_aa, L_ab, L_bb in the stator frame [H], (N, 3) or (1, 3), by model or nameplate; 1e9 H without either."""
    if batch.inductance_ab is not None:
        return doubles(batch.inductance_ab)
    motor = batch.motor
    if motor is None or motor.d_inductance_h is None or motor.q_inductance_h is None:
        return np.array([[1e9, 0.0, 1e9]])
    theta_rad = np.array([np.mean(batch.theta_rad[batch.slice_of(k)]) for k in range(len(batch.segments))])
    return inductance_to_ab(np.array([[motor.d_inductance_h, 0.0, motor.q_inductance_h]]), batch.per_sample(theta_rad))


class DeviceDrop(BatchEffect):
    """Forward drop of transistors and diodes.

    e = T V_0 s(i_abc / i_th) [V] at any PWM frequency; the ohmic part r_on i counts as R_s. In the flexible form the
    drop grows beyond its knee like a junction's, n k T / q log(1 + i / i_s): from a step at `growth` 0 to that
    logarithm alone at 1,

        e = T V_0 ((1 - growth) s(x) + growth log(1 + |x|) sign x) / (1 - growth + growth log(1 + x_r)),

    x = i_abc / i_th, so that `voltage_v` is the drop at the motor's rated current x_r i_th. The devices' losses heat
    them with a lag of `warming_s`; `warming` is the relative change of the drop at the highest temperature in the
    experiment (a junction has about -2 mV/K).
    Sources: as `DeadTime`; W. Shockley, Bell Syst. Tech. J. 28 (1949), doi:10.1002/j.1538-7305.1949.tb03645.x.
    """

    name: ClassVar[str] = "device_drop"
    summary: ClassVar[str] = "The switches' forward drop takes voltage against the sign of each phase current."
    signature: ClassVar[str] = (
        "Residual against each phase's current: a step up where the current turns positive; another PWM frequency "
        "leaves it as it is."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_PWM_FREQUENCY,)
    gauge: ClassVar[str] = "The switches' on-resistance counts as R_s; no measurement of this kind tells them apart."

    at_the_bench: ClassVar[str] = "compare with the forward voltages in the data sheet of the switches and diodes"

    class Parameters(Knee):
        voltage_v: float = amplitude("V", typical=1.0, prior_width=2.0, low=0.0, high=20.0)
        threshold_a: float = shape("A", typical=0.03, prior_width=1.0, low=1e-3, high=1.0)
        growth: float = refinement("1", neutral=0.0, prior_width=0.3, low=0.0, high=1.0)
        warming: float = refinement("1", neutral=0.0, prior_width=0.05, low=-0.5, high=0.5)
        warming_s: float = refinement("s", neutral=3.0, prior_width=3.0, low=0.1, high=100.0)

    def derived(self, p: Parameters, drive: DriveRecord) -> dict[str, tuple[float, str]]:
        """The forward voltage, which data sheets give together with an on-resistance."""
        return {"forward_voltage": (p.voltage_v, "V")}

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the drop from the commanded voltage."""
        # Avoids division by log1p(0) where the rated current is unknown.
        rated = math.log1p((rated_current_a(batch) or p.threshold_a) / p.threshold_a)
        at_knee = p.voltage_v / (1.0 - p.growth + p.growth * rated)
        volts = np.full(batch.samples, at_knee)
        if p.warming != 0.0:
            volts *= 1.0 + p.warming * _warmth(batch, p.warming_s)
        return Correction(v_ab=_less_step(batch, volts, p.threshold_a, p, np.ones(3), growth=p.growth))


def _warmth(batch: SignalBatch, lag_s: float) -> Array:
    """Temperature rise of devices with losses proportional to current, over its maximum, (N,); 0 where unknown."""

    def warm(losses: LossHistory) -> Array:
        # The loss of a nearly constant drop is proportional to the current, the root of the copper loss.
        warm = lagged_steps(losses.time_s, np.sqrt(losses.power_w), lag_s)
        return np.asarray(warm / max(float(warm.max()), 1e-12))

    return along_losses(batch, warm, lambda: 0.0)


class VoltageBias(BatchEffect):
    """Constant voltage error of each leg: e = T (b_a, b_b, -b_a - b_b) [V], while the bridge is on.

    It is due to a constant error of the modulation or of the gate drivers' delays. In the flexible form the part
    `at_edges`, by delays, is proportional to the PWM frequency; the biases hold at the drive's nominal one.
    """

    name: ClassVar[str] = "voltage_bias"
    summary: ClassVar[str] = "The inverter keeps a constant voltage back from the commanded one."
    signature: ClassVar[str] = (
        "Residual against each phase's current: a constant in each phase, the bias itself; none with the gates off."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.GATES_OFF,)
    gauge: ClassVar[str] = (
        "Only readings with the gates off tell it from a current offset, whose voltage is R_s times the offset."
    )
    remedy: ClassVar[str] = "add it to the commanded voltage of each phase; that of c is minus the sum of a and b"

    at_the_bench: ClassVar[str] = (
        "measure the mean voltage of each leg at half duty, and compare the gate drivers' delays"
    )

    class Parameters(EffectParameters):
        bias_a_v: float = amplitude("V", typical=0.15, prior_width=0.2, low=-2.0, high=2.0)
        bias_b_v: float = amplitude("V", typical=0.15, prior_width=0.2, low=-2.0, high=2.0)
        at_edges: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.0, other_form=1.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the bias from the commanded voltage."""
        share = 1.0 - p.at_edges + p.at_edges * pwm_share(batch)
        biases = np.outer(share, from_two_phases(p.bias_a_v, p.bias_b_v))
        return Correction(v_ab=less_constant(batch.v_ab, batch.starts, biases))


class BusSag(BatchEffect):
    """The bus voltage sags under load while the drive modulates for the nominal one.

    v = v* (1 - k s) for a source of resistance R_0 and a bus capacitor with series resistance R_c,

        s = (u + c P) / (1 + g c),    tau (1 - a) du/dt = P - g s,    c = a / (1 - a),

    P = 3/2 v . i the power drawn [W], u the capacitor's sag in units of power, k = `per_watt`, tau = `lag_s`,
    a = `at_once` = R_c / (R_0 + R_c) the part without lag. g is 1 for s >= 0 and 1 - `one_way` for s < 0, where power
    flows back: `one_way` is the part of the source's conductance that conducts outwards only, 1 for a rectifier.
    """

    name: ClassVar[str] = "bus_sag"
    summary: ClassVar[str] = "The bus voltage sags with the power drawn, and the drive does not know."
    signature: ClassVar[str] = (
        "Residual against each phase's current: beside what R_s takes up, it bends as voltage times power, with "
        "the voltage's sign."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.BUS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "A constant error of the bus voltage scales R_s and the flux together."

    class Parameters(EffectParameters):
        per_watt: float = amplitude("1/W", typical=5e-5, prior_width=1e-4, low=0.0, high=0.01)
        lag_s: float = shape("s", typical=1e-3, prior_width=1.5, low=1e-5, high=0.1)
        at_once: float = refinement("1", neutral=0.0, prior_width=0.2, low=0.0, high=0.9)
        one_way: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Scale the commanded voltage by the bus voltage over its nominal value."""
        intervals = doubles(p.lag_s * batch.sampling_frequency_hz)
        v_ab, i_ab = doubles(batch.v_ab), doubles(batch.i_ab)
        return Correction(v_ab=_sagged(v_ab, i_ab, batch.starts, p.per_watt, intervals, p.at_once, 1.0 - p.one_way))


@njit(cache=True, nogil=True)
def _sagged(
    v_ab: Array, i_ab: Array, starts: Starts, per_watt: float, lags: Array, at_once: float, back: float
) -> Array:
    """The voltage (N, 2) scaled by the bus, whose sag lags the power by `lags` (segments,) intervals."""
    # `at_once` is the part without lag, `back` the source's conductance for reverse current over that for forward.
    out = np.empty_like(v_ab)
    direct = at_once / (1.0 - at_once)
    ways = (1.0, back)
    given = (1.0 / (1.0 + direct), back / (1.0 + back * direct))
    for s in range(starts.shape[0] - 1):
        first, last, lag = starts[s], starts[s + 1] - 1, lags[s]
        # First-order lag over an interval: change over initial slope, at the end and on average.
        rates = (given[0] / (lag * (1.0 - at_once)), given[1] / (lag * (1.0 - at_once)))
        to_end = (_part_gone(rates[0]), _part_gone(rates[1]))
        on_mean = (_part_gone_on_mean(rates[0]), _part_gone_on_mean(rates[1]))
        late = 0.0
        for k in range(first, last + 1):
            after = min(k + 1, last)
            power = 0.75 * (v_ab[k, 0] * (i_ab[k, 0] + i_ab[after, 0]) + v_ab[k, 1] * (i_ab[k, 1] + i_ab[after, 1]))
            if k == first:
                late = power
            way = 0 if late + direct * power >= 0.0 else 1
            slope = (power - given[way] * (late + direct * power)) / (lag * (1.0 - at_once))
            mean = late + on_mean[way] * slope
            ratio = 1.0 - per_watt * ((mean + direct * power) / (1.0 + ways[way] * direct))
            out[k, 0] = v_ab[k, 0] * ratio
            out[k, 1] = v_ab[k, 1] * ratio
            late += to_end[way] * slope
    return out


@njit(cache=True, nogil=True)
def _part_gone(rate: float) -> float:
    return -math.expm1(-rate) / rate if rate > 1e-9 else 1.0


@njit(cache=True, nogil=True)
def _part_gone_on_mean(rate: float) -> float:
    return (1.0 - _part_gone(rate)) / rate if rate > 1e-4 else 0.5 - rate / 6.0
