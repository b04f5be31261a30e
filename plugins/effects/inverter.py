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
"""Widths, in thresholds, of the parts that a step of `Knee` may have beside its main one."""
PART_EXPONENT = 3.0
"""Exponent of these parts. With them the hyperbolic and the circular tangent, Langevin's and the Gaussian step, an
exponential, straight and rounded ramps, and mixtures of them are met to 1.5e-3 of the step (rms to six thresholds)."""

MIN_LEG_DIFFERENCE_RATIO = 0.03
"""Difference of a leg's dead time over the mean that a remark names: more than gate drivers of one kind differ."""

COARSE_TABLE_RATIO = 32.0
"""How much coarser a second table is, for currents far beyond the step: a logarithm there is straight to 1e-5."""


def _soft_sign(x: Array, softness: float, parts: tuple[float, ...]) -> Array:
    """s(x), x at least 0: x / (1 + x^p)^(1/p), but for the `parts` of it that happen within `PART_WIDTHS`."""
    whole = (1.0 - sum(parts)) * _knee(x, 1.0 / softness)
    for part, width in zip(parts, PART_WIDTHS, strict=True):
        if part != 0.0:
            whole += part * _knee(x / width, PART_EXPONENT)
    return whole


def _charging(x: Array) -> Array:
    """What a dead time takes where capacitances have to be charged: they swing in a straight line, 1 within it."""
    return np.asarray(np.where(x < 1.0, 0.5 * x, 1.0 - 0.5 / np.maximum(x, 1.0)), dtype=np.float64)


def _knee(x: Array, sharpness: float) -> Array:
    small = np.minimum(x, 1.0)
    large = np.maximum(x, 1.0)
    below = small / (1.0 + small**sharpness) ** (1.0 / sharpness)
    above = 1.0 / (1.0 + large**-sharpness) ** (1.0 / sharpness)
    return np.asarray(np.where(x <= 1.0, below, above), dtype=np.float64)


@lru_cache(maxsize=32)
def _tables(softness: float, parts: tuple[float, ...], charged: float, growth: float, step: float, end: float) -> Array:
    """Tables of a step of these parts, one up to `end`, one `COARSE_TABLE_RATIO` times as coarse and long; (2, m).

    The part `charged` goes as `_charging`, the part `growth` as log(1 + x), what is left as `_soft_sign`.
    """

    def whole(x: Array) -> Array:
        mere = _soft_sign(x, softness, parts)
        return (1.0 - charged - growth) * mere + charged * _charging(x) + growth * np.log1p(x)

    x = np.arange(0.0, end + 1.5 * step, step)
    return np.stack([whole(x), whole(COARSE_TABLE_RATIO * x)])


@njit(cache=True, nogil=True)
def _look_up(tables: Array, place: float, growth: float) -> float:
    """s at a place in the first table's steps, odd; beyond both tables it grows so much with each factor e."""
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
    """v - volts s, s averaged over each interval by Simpson's rule; `steps` of the first table are one ampere."""
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
    """How the step at zero current is rounded, beside the current within which it happens."""

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
    """The voltage without `volts` (N,) against the sign of each phase current, in each leg times its part (3,).

    It is read, linearly between entries, from `_tables` of this `step` and `end`, in thresholds.
    """
    tables = _tables(knee.softness, (knee.narrow, knee.wide, knee.wider), charged, growth, step, end)
    steps = 1.0 / (threshold_a * step)
    courses = (doubles(batch.v_ab), _without_noise(batch), batch.starts)
    return np.asarray(_without_sign(*courses, volts, legs, steps, tables, growth))


class DeadTime(BatchEffect, RemarkingEffect):
    """Blanking time between the switches of a leg.

    e = T V_dt s(i_abc / i_th), V_dt = t_d f_pwm V_dc [V]; the impressed voltage is v* - e. `voltage_v`
    is V_dt at the drive's own PWM frequency and nominal bus voltage. Near zero current the parasitic
    capacitances take over, and s crosses zero within i_th; its form here is x / (1 + |x|^p)^(1/p), p = 1 / `softness`.
    In the flexible form the softness is free, and parts of the step happen within half, one and a half and three i_th
    (`narrow`, `wide`, `wider`): the capacitances are not constant. The part `charged` goes as where they are: a leg
    swings in a straight line, within the dead time at i_th, and of it |i| / 2 i_th is lost below, 1 - i_th / 2 |i|
    above. A share `switched` of the voltage is lost as at the
    edges of a switching leg, each with the current of its own instant, ripple included
    (`plugins.effects._commutation`). i_th is then C V_dc / t_d with C of both devices of a leg, the same at every PWM
    frequency, and i_th t_d the charge of a swing; `grading` is by which power their capacitances fall with the voltage,
    and `takeover` the part of the dead time by which an edge against the motor's rated current is later still.
    `yielding` is how far the currents follow the edges within a swing itself as the inductance has them: 0 where they
    are those of the command, 1 where a winding is its inductance in a microsecond, too.
    `leg_a_longer` is by how much of the legs' mean leg a's own dead time is, which the other two make up for alike, and
    `leg_b_over_c` by how much of it b's is above, and c's below theirs.
    Source: S.-G. Jeong, M.-H. Park, IEEE Trans. Ind. Electron. 38 (1991), doi:10.1109/41.88903.
    """

    name: ClassVar[str] = "dead_time"
    summary: ClassVar[str] = "The inverter's dead time takes voltage against the sign of each phase current."
    signature: ClassVar[str] = "An odd step in each phase current that grows with the PWM frequency."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_PWM_FREQUENCY,)
    gauge: ClassVar[str] = ""

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
            rest = volts if p.switched == 0.0 else (1.0 - p.switched) * volts
            v_ab = _less_step(batch, rest, p.threshold_a, p, legs, charged=p.charged)
        if p.switched > 0.0:
            lost = _lost_at_edges(batch, volts, legs, p)
            lost *= -p.switched
            lost += v_ab
            v_ab = lost
        return Correction(v_ab=v_ab)

    def derived(self, p: Parameters, drive: DriveRecord) -> dict[str, tuple[float, str]]:
        """The dead time t_d = V_dt / (f_pwm V_dc), and the charge i_th t_d of a swing where its form shows that."""
        if drive.pwm_frequency_hz is None:
            return {}
        dead_time_s = p.voltage_v / (drive.pwm_frequency_hz * drive.dc_bus_voltage_v)
        quantities = {"dead_time": (dead_time_s, "s")}
        if p.charged > 0.0 or p.switched > 0.0:
            quantities["charge_of_a_swing"] = (p.threshold_a * abs(dead_time_s), "C")
        return quantities

    def remarks(self, p: Parameters) -> list[Remark]:
        """Which leg's dead time is none of the others'."""
        legs = dict(zip("abc", _longer(p), strict=True))
        leg = max(legs, key=lambda one: abs(legs[one]))
        if abs(legs[leg]) < MIN_LEG_DIFFERENCE_RATIO:
            return []
        text = "leg {leg}'s is {percent:.2g} % {which} than the legs' mean: look at its gate driver"
        which = "longer" if legs[leg] > 0.0 else "shorter"
        return [Remark.of("leg_differs", text, leg=leg, percent=100.0 * abs(legs[leg]), which=which)]


def _nominal_bus_v(batch: SignalBatch) -> RealArray | float:
    """The drive's, or else the mean over each segment (segments,)."""
    if batch.drive is not None:
        return batch.drive.dc_bus_voltage_v
    return np.array([np.mean(batch.v_dc[batch.slice_of(k)]) for k in range(len(batch.segments))])


def _lost_at_edges(batch: SignalBatch, volts: Array, legs: Array, p: DeadTime.Parameters) -> Array:
    """What a leg that switches loses of its V_dt, `volts` (N,), shape (N, 2)."""
    # Current between samples hardly bends: two carrier periods stand for all of them.
    cycles = np.clip(np.round(batch.pwm_frequency_hz / batch.sampling_frequency_hz), 1, 2).astype(np.int64)
    takeover = p.takeover * p.threshold_a / (rated_current_a(batch) or p.threshold_a)
    swing = Swing(swing_lines(p.grading), takeover, p.yielding)
    courses = (doubles(batch.v_ab), _without_noise(batch), volts, batch.starts)
    carrier = (_inductance(batch), doubles(1.0 / batch.pwm_frequency_hz), cycles)
    return np.asarray(lost_at_edges(*courses, legs, 1.0 / p.threshold_a, *carrier, swing))


def _longer(p: DeadTime.Parameters) -> tuple[float, float, float]:
    """By how much of the legs' mean dead time each one's own is longer."""
    others = -0.5 * p.leg_a_longer
    return p.leg_a_longer, others + p.leg_b_over_c, others - p.leg_b_over_c


def _without_noise(batch: SignalBatch) -> Array:
    """The stator current; a bend near zero would turn its noise into a mean."""
    return doubles(batch.i_ab if batch.i_quiet_ab is None else batch.i_quiet_ab)


def _inductance(batch: SignalBatch) -> Array:
    """L_aa, L_ab, L_bb in the stator frame [H], by the model or else the nameplate; endless where neither is known.

    Of shape (N, 3), or (1, 3) where all are the same.
    """
    if batch.inductance_ab is not None:
        return doubles(batch.inductance_ab)
    motor = batch.motor
    if motor is None or motor.d_inductance_h is None or motor.q_inductance_h is None:
        return np.array([[1e9, 0.0, 1e9]])
    theta_rad = np.array([np.mean(batch.theta_rad[batch.slice_of(k)]) for k in range(len(batch.segments))])
    return inductance_to_ab(np.array([[motor.d_inductance_h, 0.0, motor.q_inductance_h]]), batch.per_sample(theta_rad))


class DeviceDrop(BatchEffect):
    """Forward drop of transistors and diodes.

    e = T V_0 s(i_abc / i_th) [V], whatever the PWM frequency; the part proportional to the current,
    r_on i, counts as R_s. In the flexible form the drop goes on growing beyond its knee as over any junction,
    whose drop is log(1 + i / i_s) times n k T / q: from a mere step at `growth` 0 to that logarithm alone at 1,

        e = T V_0 ((1 - growth) s(x) + growth log(1 + |x|) sign x) / (1 - growth + growth log(1 + x_r)),

    x = i_abc / i_th, so that `voltage_v` is the drop at the motor's rated current, x_r thresholds. And devices warm by
    what they carry, through a lag of `warming_s`: where they are warmest in the experiment, the drop has changed by the
    part `warming`, some -2 mV/K of a junction.
    Sources: as `DeadTime`; W. Shockley, Bell Syst. Tech. J. 28 (1949), doi:10.1002/j.1538-7305.1949.tb03645.x.
    """

    name: ClassVar[str] = "device_drop"
    summary: ClassVar[str] = "The switches' forward drop takes voltage against the sign of each phase current."
    signature: ClassVar[str] = "An odd step in each phase current, the same at every PWM frequency."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_PWM_FREQUENCY,)
    gauge: ClassVar[str] = "The switches' on-resistance counts as R_s; no measurement of this kind tells them apart."

    class Parameters(Knee):
        voltage_v: float = amplitude("V", typical=1.0, prior_width=2.0, low=0.0, high=20.0)
        threshold_a: float = shape("A", typical=0.03, prior_width=1.0, low=1e-3, high=1.0)
        growth: float = refinement("1", neutral=0.0, prior_width=0.3, low=0.0, high=1.0)
        warming: float = refinement("1", neutral=0.0, prior_width=0.05, low=-0.5, high=0.5)
        warming_s: float = refinement("s", neutral=3.0, prior_width=3.0, low=0.1, high=100.0)

    def derived(self, p: Parameters, drive: DriveRecord) -> dict[str, tuple[float, str]]:
        """The forward voltage, which data sheets give beside an on-resistance."""
        return {"forward_voltage": (p.voltage_v, "V")}

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the drop from the commanded voltage."""
        # A logarithm alone is nothing at the current zero, which an unknown rated one would be.
        rated = math.log1p((rated_current_a(batch) or p.threshold_a) / p.threshold_a)
        at_knee = p.voltage_v / (1.0 - p.growth + p.growth * rated)
        volts = np.full(batch.samples, at_knee)
        if p.warming != 0.0:
            volts *= 1.0 + p.warming * _warmth(batch, p.warming_s)
        return Correction(v_ab=_less_step(batch, volts, p.threshold_a, p, np.ones(3), growth=p.growth))


def _warmth(batch: SignalBatch, lag_s: float) -> Array:
    """How warm devices are that lose power with their current, (N,), in parts of the most; 0 where that is unknown."""

    def warm(losses: LossHistory) -> Array:
        # A nearly constant drop times the current, of which the copper loss goes with the square.
        warm = lagged_steps(losses.time_s, np.sqrt(losses.power_w), lag_s)
        return np.asarray(warm / max(float(warm.max()), 1e-12))

    return along_losses(batch, warm, lambda: 0.0)


class VoltageBias(BatchEffect):
    """Constant voltage error of each leg: e = T (b_a, b_b, -b_a - b_b) [V], while the bridge is on.

    Its cause is a constant error of the modulation or of the gate drivers' delays. What delays make happens at every
    edge: in the flexible form the part `at_edges` of it grows with the PWM frequency, and `bias_a_v` and `bias_b_v` are
    those at the drive's own.
    """

    name: ClassVar[str] = "voltage_bias"
    summary: ClassVar[str] = "The inverter keeps a constant voltage back from the commanded one."
    signature: ClassVar[str] = "A constant residual, the same at every current."
    layer: ClassVar[EffectLayer] = EffectLayer.INVERTER
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.GATES_OFF,)
    gauge: ClassVar[str] = "Without a gates-off reading a bias of R_s o equals a current offset o."

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

    v = v* (1 - k P), P = 3/2 v . i the power drawn [W], k in 1/W. The bus's own capacitors make the sag follow
    the power with a lag, but for the part `at_once`, which their resistance R_c in series lets follow without: behind
    a source of resistance R_0 that is R_c / (R_0 + R_c). A rectifier takes nothing back, and what a motor returns lifts
    the bus; of any source, `one_way` is the part of 1 / R_0 that it has outwards only.
    """

    name: ClassVar[str] = "bus_sag"
    summary: ClassVar[str] = "The bus voltage sags with the power drawn, and the drive does not know."
    signature: ClassVar[str] = "A residual along the voltage that grows with voltage times power."
    layer: ClassVar[EffectLayer] = EffectLayer.BUS
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "A constant error of the bus voltage scales R_s and the flux together."

    class Parameters(EffectParameters):
        per_watt: float = amplitude("1/W", typical=5e-5, prior_width=1e-4, low=0.0, high=0.01)
        lag_s: float = shape("s", typical=1e-3, prior_width=1.5, low=1e-5, high=0.1)
        at_once: float = refinement("1", neutral=0.0, prior_width=0.2, low=0.0, high=0.9)
        one_way: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Scale the commanded voltage by what the bus has left."""
        intervals = doubles(p.lag_s * batch.sampling_frequency_hz)
        v_ab, i_ab = doubles(batch.v_ab), doubles(batch.i_ab)
        return Correction(v_ab=_sagged(v_ab, i_ab, batch.starts, p.per_watt, intervals, p.at_once, 1.0 - p.one_way))


@njit(cache=True, nogil=True)
def _sagged(
    v_ab: Array, i_ab: Array, starts: Starts, per_watt: float, lags: Array, at_once: float, back: float
) -> Array:
    """The voltage (N, 2) that a bus has left, which sags with the power that its source gives.

    Parameters
    ----------
    lags : array, shape (segments,)
        Of the sag behind the power drawn, in intervals.
    at_once : float
        Part of it that does not lag.
    back : float
        Conductance of the source for a current that flows back, over that for one that flows out.
    """
    out = np.empty_like(v_ab)
    direct = at_once / (1.0 - at_once)
    ways = (1.0, back)
    given = (1.0 / (1.0 + direct), back / (1.0 + back * direct))
    for s in range(starts.shape[0] - 1):
        first, last, lag = starts[s], starts[s + 1] - 1, lags[s]
        # Of a first-order lag, over an interval: how much of its first slope it goes, to the end and on the mean.
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
            left = 1.0 - per_watt * ((mean + direct * power) / (1.0 + ways[way] * direct))
            out[k, 0] = v_ab[k, 0] * left
            out[k, 1] = v_ab[k, 1] * left
            late += to_end[way] * slope
    return out


@njit(cache=True, nogil=True)
def _part_gone(rate: float) -> float:
    return -math.expm1(-rate) / rate if rate > 1e-9 else 1.0


@njit(cache=True, nogil=True)
def _part_gone_on_mean(rate: float) -> float:
    return (1.0 - _part_gone(rate)) / rate if rate > 1e-4 else 0.5 - rate / 6.0
