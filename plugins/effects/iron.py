"""Iron and magnets: eddy currents, hysteresis, magnet heating, slotting. Each corrects the magnetising current."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.kernels import dq_of, unit_vectors
from orchestrator.numerics.types import Array
from plugins.effects._batches import BatchEffect, RandomBatchEffect, per_segment
from plugins.effects._filters import lagged_steps
from plugins.effects._flux import flux_of, initial_paths, magnet_wb, typical_inductance
from plugins.effects._losses import along_losses
from plugins.effects._stops import Course, stops, yields_of
from plugins.effects._vectors import Starts, doubles, plus_along_d
from protocols import (
    Contrast,
    Correction,
    EffectLayer,
    EffectParameters,
    LossHistory,
    RealArray,
    SignalBatch,
    amplitude,
    refinement,
    shape,
)


class EddyCurrents(BatchEffect):
    """Eddy currents in the iron: i = i_m + (dpsi/dt) / R_c [A], R_c in ohm, dpsi/dt = v - R_s i.

    A sample just before the voltage changes responds to the voltage of the interval before, at its end where commands
    are delayed. The eddy current's path has an inductance, with the time constant `lag_s`: read in the zero vector, a
    current of a short one has almost decayed. In the flexible form the time constants are spread: a path with
    lag_s 4^k has `slower`^k of the middle one's conductance, one with lag_s / 4^k has `faster`^k. At 2 and 1/2 the
    field diffuses into thick iron, as the root of frequency. The conductance is (1 + `saliency`) / R_c on d,
    (1 - `saliency`) / R_c on q: at +-1 on one axis only. What came before a segment is taken to be like its beginning.
    Sources: the core-loss resistance of the equivalent circuit, e.g. S. Morimoto et al., doi:10.1109/28.315238; spread
    time constants for a root of frequency: A. Oustaloup et al., doi:10.1109/81.817385.
    """

    name: ClassVar[str] = "eddy_currents"
    summary: ClassVar[str] = "Eddy currents in the iron add a current in step with the voltage."
    signature: ClassVar[str] = (
        "Ripple: measured less model is a square with the sign of its slope, the same per volt at every amplitude."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.IRON
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        core_loss_ohm: float = amplitude(
            "ohm", typical=1e3, prior_width=1e3, low=20.0, high=1e7, neutral=1e7, strong_when_small=True
        )
        lag_s: float = shape("s", typical=5e-5, prior_width=1.5, low=1e-6, high=5e-3)
        slower: float = refinement("1", neutral=0.0, prior_width=1.0, low=0.0, high=4.0, other_form=0.5)
        faster: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.0, other_form=0.5)
        saliency: float = refinement("1", neutral=0.0, prior_width=0.5, low=-1.0, high=1.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the eddy current from the magnetising current, and its steps from the resistive drop."""
        i_m_ab, v_ab = _without_eddies(
            doubles(batch.i_m_ab),
            doubles(batch.v_ab),
            np.zeros((0, 2)) if batch.v_late_ab is None else doubles(batch.v_late_ab),
            doubles(batch.i_ab),
            doubles(batch.resistance_ohm),
            doubles(batch.theta_rad) if p.saliency != 0.0 else np.zeros(0),
            batch.starts,
            np.array([1.0 + p.saliency, 1.0 - p.saliency]) / p.core_loss_ohm,
            per_segment(p.lag_s * batch.sampling_frequency_hz, lambda late: _paths(late, p.slower, p.faster)),
        )
        return Correction(i_m_ab=i_m_ab, v_ab=v_ab)


EDDY_PATHS = np.arange(-4.0, 4.0)
"""Paths of spread time constants, each with four times the time constant of the one before; 0 is the middle one."""


def _paths(late: float, slower: float, faster: float) -> Array:
    """Each path's share of the conductance, decay, curvature and end response, shape (paths, 4)."""
    # `late` is the middle path's lag in sample periods.
    shares = np.where(EDDY_PATHS > 0.0, slower, faster) ** np.abs(EDDY_PATHS)
    rows = zip(shares / shares.sum(), late * 4.0**EDDY_PATHS, strict=True)
    return np.array([(share, *_path(lag)) for share, lag in rows if share > 0.0])


def _path(late: float) -> tuple[float, float, float]:
    """A path's decay in a sample period, the curvature of a step, and the response to the interval's end."""
    decay = math.exp(-1.0 / late) if late > 1e-2 else 0.0
    # Mean of the exponential within an interval minus that of the chord between its samples.
    bend = 0.5 * (1.0 + decay) - late * (1.0 - decay)
    # Response to the voltage at an interval's end minus its mean: one without a lag, zero for a long lag.
    return decay, bend, math.tanh(0.25 / late) if late > 1e-2 else 1.0


@njit(cache=True, nogil=True)
def _without_eddies(
    i_m_ab: Array,
    v_ab: Array,
    late_ab: Array,
    i_ab: Array,
    ohm: Array,
    theta_rad: Array,
    starts: Starts,
    siemens: Array,
    paths: Array,
) -> tuple[Array, Array]:
    """The current minus the eddy current, and the voltage minus the drop of its steps, shapes (N, 2).

    Parameters
    ----------
    late_ab : array, shape (N, 2) or (0, 2)
        Voltage at an interval's end minus its mean; empty where zero.
    theta_rad : array, shape (N,) or (0,)
        Angle of the d axis; empty without saliency.
    siemens : array, shape (2,)
        Conductance on d and on q.
    paths : array, shape (segments, m, 4)
        For each path: share of the conductance; decay in a sample period with constant voltage; mean of a step over an
        interval minus the mean of both samples; response to the voltage at the interval's end.
    """
    i_out, v_out = i_m_ab.copy(), v_ab.copy()
    salient = theta_rad.shape[0] > 0
    for s in range(starts.shape[0] - 1):
        first = starts[s]
        axis = unit_vectors(theta_rad[first : starts[s + 1]]) if salient else np.zeros((0, 2))
        for m in range(paths.shape[1]):
            part, decay, bend, felt = paths[s, m]
            if part == 0.0:
                continue
            felt_a, felt_b = _before(v_ab, i_ab, ohm, first, starts[s + 1], decay)
            late_a, late_b, next_a, next_b = 0.0, 0.0, 0.0, 0.0
            for k in range(first, starts[s + 1]):
                # The sample responds to the voltage of the interval before.
                before = max(k - 1, first)
                if late_ab.shape[0] > 0:
                    late_a, late_b = felt * late_ab[before, 0], felt * late_ab[before, 1]
                    next_a, next_b = felt * late_ab[k, 0], felt * late_ab[k, 1]
                drop_a, drop_b = ohm[k] * i_ab[k, 0], ohm[k] * i_ab[k, 1]
                if k > first:
                    felt_a = decay * felt_a + (1.0 - decay) * (v_ab[before, 0] + late_a - drop_a)
                    felt_b = decay * felt_b + (1.0 - decay) * (v_ab[before, 1] + late_b - drop_b)
                step_a = ohm[k] * (bend * (v_ab[k, 0] - drop_a - felt_a) - 0.5 * (1.0 - decay) * next_a)
                step_b = ohm[k] * (bend * (v_ab[k, 1] - drop_b - felt_b) - 0.5 * (1.0 - decay) * next_b)
                cos, sin = (axis[k - first, 0], axis[k - first, 1]) if salient else (1.0, 0.0)
                d, q = dq_of(part * felt_a, part * felt_b, cos, sin)
                i_out[k, 0] -= siemens[0] * d * cos - siemens[1] * q * sin
                i_out[k, 1] -= siemens[0] * d * sin + siemens[1] * q * cos
                d, q = dq_of(part * step_a, part * step_b, cos, sin)
                v_out[k, 0] -= siemens[0] * d * cos - siemens[1] * q * sin
                v_out[k, 1] -= siemens[0] * d * sin + siemens[1] * q * cos
    return i_out, v_out


@njit(cache=True, nogil=True)
def _before(v_ab: Array, i_ab: Array, ohm: Array, first: int, end: int, decay: float) -> tuple[float, float]:
    """Mean voltage that a path has felt before a segment: that of its beginning, weighted as by the path."""
    felt_a, felt_b, weight, total, k = 0.0, 0.0, 1.0, 0.0, first
    while weight > 1e-4 and k < end:
        felt_a += weight * (v_ab[k, 0] - ohm[k] * i_ab[k, 0])
        felt_b += weight * (v_ab[k, 1] - ohm[k] * i_ab[k, 1])
        total, weight, k = total + weight, weight * decay, k + 1
    return felt_a / total, felt_b / total


INITIAL_STATE_STD_RATIO = 0.25
"""Standard deviation of a stop's unknown initial state over its limit."""


class Hysteresis(RandomBatchEffect):
    """Hysteresis of the iron: i = grad H(psi) + sum of vector stop operators of psi [A].

    A stop follows kappa psi up to its limit. The limits add up to `half_width_a`, half the loop's width, and kappa is
    that over `yield_wb`, the flux at which stops yield for any width. Minor loops have 1/L + kappa instead of 1/L. A
    stop's state at a segment's start follows from the path to it: straight from the earlier current, with a
    controller's overshoot by the part `overshoot`.
    In the flexible form the stops yield at fluxes that differ by the factors exp(-+sqrt(`variance`)); the one that
    yields earlier has `early_share` of kappa, which has no effect at zero variance. A third one between them may have
    `middle_share` of all. With a `softness` they yield before their limits: outwards they move by
    1 - (size / limit)^(1 / softness) of kappa psi. The part `giving` of the yielding also acts inwards, where they then
    move by more than kappa psi. The part `by_axes` is held by independent stops on d and q. The loop's width is
    multiplied by 1 + `widening_per_wb2` |psi|^2. Saturating iron needs a disproportionate current, which the stops
    follow: psi (1 + `stiffening_per_wb2` psi^2), magnet included.
    Sources: A. Bergqvist, Physica B 233 (1997), doi:10.1016/S0921-4526(97)00319-0; the yielding: Y.-K. Wen, J. Eng.
    Mech. Div. 102 (1976) 249; what the stops follow: D. C. Jiles, D. L. Atherton, J. Magn. Magn. Mater. 61 (1986) 48,
    doi:10.1016/0304-8853(86)90066-1.
    """

    name: ClassVar[str] = "hysteresis"
    summary: ClassVar[str] = "The iron's hysteresis lags the flux behind the current, whatever the speed."
    signature: ClassVar[str] = (
        "Flux loop: open at every rate, the measured flux below while the current rises, above while it falls; "
        "the ripple is larger than the model's."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.IRON
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        half_width_a: float = amplitude("A", typical=0.03, prior_width=0.05, low=0.0, high=0.5)
        yield_wb: float = shape("Wb", typical=0.02, prior_width=1.0, low=5e-4, high=1.0)
        variance: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=2.5)
        early_share: float = refinement("1", neutral=0.5, prior_width=0.2, low=0.05, high=0.95)
        middle_share: float = refinement("1", neutral=0.0, prior_width=0.3, low=0.0, high=0.8)
        softness: float = refinement("1", neutral=0.0, prior_width=0.4, low=0.0, high=4.0, other_form=0.6)
        giving: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.0)
        by_axes: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.0)
        widening_per_wb2: float = refinement("1/Wb^2", neutral=0.0, prior_width=100.0, low=-500.0, high=500.0)
        overshoot: float = refinement("1", neutral=0.0, prior_width=0.2, low=0.0, high=1.0)
        stiffening_per_wb2: float = refinement("1/Wb^2", neutral=0.0, prior_width=100.0, low=0.0, high=500.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the stops' sum from the magnetising current."""
        i_m_ab = self._held(batch, p)(np.zeros((3, 2)))
        i_m_ab *= -p.half_width_a
        i_m_ab += batch.i_m_ab
        return Correction(i_m_ab=i_m_ab)

    def random_directions_batch(self, batch: SignalBatch, p: Parameters) -> list[Correction]:
        """Unknown initial states of a segment beside the known path: the outer stops along each axis."""
        held, directions = self._held(batch, p), []
        known = held(np.zeros((3, 2)))
        for stop in (0, 2):
            for axis in range(2):
                off = np.zeros((3, 2))
                off[stop, axis] = INITIAL_STATE_STD_RATIO
                directions.append(Correction(i_m_ab=batch.i_m_ab - p.half_width_a * (held(off) - known)))
        return directions

    def _held(self, batch: SignalBatch, p: Parameters) -> Callable[[Array], Array]:
        """The stops' sum over the half width, shape (N, 2), as a function of added initial states (3, 2)."""
        rest, spread = 1.0 - p.middle_share, math.sqrt(p.variance)
        shares = np.array([rest * p.early_share, p.middle_share, rest * (1.0 - p.early_share)])
        limits = shares * np.exp([-spread, 0.0, spread])
        present = shares > 0.0
        stiffness, parts = shares[present] / p.yield_wb, limits[present] / limits.sum()
        psi = flux_of(batch)
        course = Course(psi, batch.starts, *initial_paths(batch, psi, p.overshoot))

        def stopped(course: Course, off: Array) -> Array:
            if p.stiffening_per_wb2 > 0.0:
                followed = (_stiffened(x, p.stiffening_per_wb2) for x in (course.values, course.ways))
                course = Course(next(followed), course.starts, next(followed), course.way_starts)
            return np.asarray(stops(course, stiffness, parts, yields_of(p.softness), p.giving, off))

        def held(off: Array) -> Array:
            memory = np.repeat(off[None, present], len(batch.segments), axis=0)
            of_all = stopped(course, memory) if p.by_axes < 1.0 else np.zeros_like(psi)
            if p.by_axes > 0.0:
                of_axes = _by_axes(stopped, course, memory, batch.theta_rad[batch.starts[:-1]])
                of_all = (1.0 - p.by_axes) * of_all + p.by_axes * of_axes
            if p.widening_per_wb2 == 0.0:
                return of_all
            return of_all * _width(batch, psi, p.widening_per_wb2)[:, None]

        return held


def _stiffened(flux: Array, stiffening_per_wb2: float) -> Array:
    square = np.einsum("ij,ij->i", flux, flux)
    return np.asarray(flux * (1.0 + stiffening_per_wb2 * square)[:, None])


def _by_axes(stopped: Callable[[Course, Array], Array], course: Course, off: Array, theta_rad: RealArray) -> Array:
    """The stops' sum with independent axes at each segment's angle, shape (N, 2); `off` as in `stops`."""
    back = np.stack([np.cos(theta_rad), np.sin(theta_rad)], axis=1)
    turn, first = back * [1.0, -1.0], np.array([1.0, 0.0])
    psi, way = _turned(course.values, course.starts, turn), _turned(course.ways, course.way_starts, turn)
    memory = np.einsum("sij,smj->smi", _rotations(turn), off)
    held = np.empty_like(psi)
    for k in range(2):
        alone = Course(np.outer(psi[:, k], first), course.starts, np.outer(way[:, k], first), course.way_starts)
        held[:, k] = stopped(alone, np.multiply.outer(memory[:, :, k], first))[:, 0]
    return np.asarray(_turned(held, course.starts, back))


def _rotations(turns: Array) -> Array:
    """Rotation matrices (segments, 2, 2) for cosine and sine (segments, 2)."""
    cos, sin = turns.T
    return np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)


@njit(cache=True, nogil=True)
def _turned(x: Array, starts: Starts, turns: Array) -> Array:
    """Vectors (n, 2) rotated per segment, for cosine and sine (segments, 2)."""
    out = np.empty_like(x)
    for s in range(starts.shape[0] - 1):
        cos, sin = turns[s, 0], turns[s, 1]
        for k in range(starts[s], starts[s + 1]):
            out[k, 0] = cos * x[k, 0] - sin * x[k, 1]
            out[k, 1] = sin * x[k, 0] + cos * x[k, 1]
    return out


def _width(batch: SignalBatch, psi: Array, widening_per_wb2: float) -> Array:
    """Factor of the loop's width (N,) at a flux psi (N, 2), magnet included."""
    by_current = plus_along_d(psi, batch.starts, np.full(batch.samples, -magnet_wb(batch)), batch.theta_rad)
    wider = 1.0 + abs(widening_per_wb2) * np.einsum("ij,ij->i", by_current, by_current)
    return np.asarray(wider if widening_per_wb2 > 0.0 else 1.0 / wider)


class MagnetHeating(BatchEffect):
    """Magnet heating: the magnets' flux falls (about -0.11 %/K for NdFeB), which shifts the map along i_d.

    i_m = i + Delta psi(t) / L_d on the d axis [A]; Delta psi follows the copper loss through a thermal lag
    and is `flux_change_wb` at the end of the experiment [Wb]. With the rotor locked it induces no voltage. In the
    flexible form a part `steady` follows a constant loss through the same lag: other heat sources, or a different
    temperature before the experiment.
    """

    name: ClassVar[str] = "magnet_heating"
    summary: ClassVar[str] = "The magnets warm up and lose flux."
    signature: ClassVar[str] = (
        "In no picture by itself: the last injection points differ from the first ones, as the map slides along i_d."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.IRON
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "The magnet's flux itself is invisible to a locked rotor; only its change shows."

    class Parameters(EffectParameters):
        flux_change_wb: float = amplitude("Wb", typical=0.005, prior_width=0.01, low=-0.1, high=0.1)
        time_constant_s: float = shape("s", typical=300.0, prior_width=1.0, low=5.0, high=20000.0)
        steady: float = refinement("1", neutral=0.0, prior_width=0.4, low=0.0, high=1.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Shift the map along the d axis by the flux lost so far."""

        def warm(losses: LossHistory) -> Array:
            warm = (1.0 - p.steady) * _warmth(losses.time_s, losses.power_w, p.time_constant_s)
            if p.steady > 0.0:
                warm += p.steady * _warmth(losses.time_s, np.ones(len(losses.time_s)), p.time_constant_s)
            return warm

        part = along_losses(batch, warm, lambda: _part_of_heat(batch))
        nameplate = batch.motor.d_inductance_h if batch.motor is not None else None
        inductance = np.array([nameplate]) if nameplate else typical_inductance(batch)
        part *= batch.per_sample(p.flux_change_wb / inductance)
        return Correction(i_m_ab=plus_along_d(batch.i_m_ab, batch.starts, part, batch.theta_rad))


def _part_of_heat(batch: SignalBatch) -> Array:
    """Heat over its value at the end of the segment, shape (N,)."""
    return np.asarray(batch.heat_j / batch.per_sample(np.maximum(batch.heat_j[batch.starts[1:] - 1], 1e-12)))


def _warmth(time_s: RealArray, power_w: RealArray, time_constant_s: float) -> Array:
    """Response of a lag to a loss, over its final value."""
    warm = lagged_steps(time_s, power_w, time_constant_s)
    return np.asarray(warm / max(float(warm[-1]), 1e-12), dtype=np.float64)


class SlotHarmonics(BatchEffect):
    """Slotting adds a saliency that depends on the locked angle: an L_dq even in i_q, `relative` times L.

    Its energy r L i_d i_q is added to the map's, which keeps reciprocity: the flux r L (i_q, i_d) [Wb] is subtracted
    from the voltage's integral. In the flexible form it decreases as the teeth saturate: r / (1 + f |i|^2), f in 1/A^2.
    The part `by_flux` is the current for an uneven gap, proportional to the flux without the magnet's:
    i_m = i + r psi / L with exchanged axes. For a rotor rotated by delta, L_dq increases by `across` L 2 sin(3 delta),
    L_dd and L_qq by `along_d` and `along_q` times L 2 sin(3 delta): slotting has six periods per turn of unknown phase,
    and for two angles these three parameters describe any difference.
    """

    name: ClassVar[str] = "slot_harmonics"
    summary: ClassVar[str] = "The slots make the map depend on the angle at which the rotor is locked."
    signature: ClassVar[str] = (
        "Evenness in i_q: the flux of the d axis tilts with i_q, and differently at another rotor angle."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.IRON
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_ANGLE,)
    gauge: ClassVar[str] = (
        "Only what breaks the map's symmetry in i_q shows; the rest of the slotting counts as this angle's map."
    )

    class Parameters(EffectParameters):
        relative: float = amplitude("1", typical=0.02, prior_width=0.03, low=-0.3, high=0.3)
        across: float = amplitude("1", typical=0.02, prior_width=0.03, low=-0.3, high=0.3)
        along_d: float = amplitude("1", typical=0.02, prior_width=0.03, low=-0.3, high=0.3)
        along_q: float = amplitude("1", typical=0.02, prior_width=0.03, low=-0.3, high=0.3)
        fading_per_a2: float = refinement("1/A^2", neutral=0.0, prior_width=0.1, low=-0.03, high=10.0)
        by_flux: float = refinement("1", neutral=0.0, prior_width=0.5, low=0.0, high=1.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Subtract the change of this flux from the voltage of each interval."""
        shift = 2.0 * np.sin(3.0 * batch.turned_rad)
        mere = np.full_like(shift, p.relative)
        parts = np.stack([shift * p.along_d, mere + shift * p.across, shift * p.along_q], axis=1)
        inductance, theta_rad = typical_inductance(batch), doubles(batch.theta_rad)
        strengths = (1.0 - p.by_flux) * parts * (inductance * batch.sampling_frequency_hz)[:, None]
        v_ab, i_m_ab = doubles(batch.v_ab), doubles(batch.i_m_ab)
        less = _without_slots(v_ab, i_m_ab, theta_rad, batch.starts, strengths, p.fading_per_a2)
        if p.by_flux == 0.0:
            return Correction(v_ab=less)
        by_flux = p.by_flux * parts / inductance[:, None]
        more = _with_slots(i_m_ab, flux_of(batch), theta_rad, batch.starts, by_flux, magnet_wb(batch))
        return Correction(v_ab=less, i_m_ab=more)


@njit(cache=True, nogil=True)
def _without_slots(
    v_ab: Array, i_ab: Array, theta_rad: Array, starts: Starts, strengths: Array, fading: float
) -> Array:
    """The voltage without the steps of the gradient of (a i_d^2 / 2 + r i_d i_q + b i_q^2 / 2) / (1 + f |i|^2)."""
    # `theta_rad` (N,) is the d axis' angle, `strengths` (segments, 3) are a, r and b.
    out = v_ab.copy()
    for s in range(starts.shape[0] - 1):
        first, (along_d, across, along_q) = starts[s], strengths[s]
        axis = unit_vectors(theta_rad[first : starts[s + 1]])
        old_alpha, old_beta = 0.0, 0.0
        for k in range(first, starts[s + 1]):
            cos, sin = axis[k - first, 0], axis[k - first, 1]
            d, q = dq_of(i_ab[k, 0], i_ab[k, 1], cos, sin)
            fade = 1.0 / max(1.0 + fading * (d * d + q * q), 0.1)
            mere_d, mere_q = along_d * d + across * q, across * d + along_q * q
            # The quadratic form is half of its gradient times the current.
            bend = fading * (mere_d * d + mere_q * q) * fade * fade
            psi_d, psi_q = mere_d * fade - bend * d, mere_q * fade - bend * q
            alpha, beta = cos * psi_d - sin * psi_q, sin * psi_d + cos * psi_q
            if k > first:
                out[k - 1, 0] -= alpha - old_alpha
                out[k - 1, 1] -= beta - old_beta
            old_alpha, old_beta = alpha, beta
    return out


@njit(cache=True, nogil=True)
def _with_slots(i_ab: Array, psi_ab: Array, theta_rad: Array, starts: Starts, extra: Array, magnet_wb: float) -> Array:
    """The current (N, 2) plus that of an uneven gap for the flux without the magnet's; `extra` as `strengths`."""
    out = np.empty_like(i_ab)
    for s in range(starts.shape[0] - 1):
        first, (along_d, across, along_q) = starts[s], extra[s]
        axis = unit_vectors(theta_rad[first : starts[s + 1]])
        for k in range(first, starts[s + 1]):
            cos, sin = axis[k - first, 0], axis[k - first, 1]
            d, q = dq_of(psi_ab[k, 0], psi_ab[k, 1], cos, sin)
            d -= magnet_wb
            more_d, more_q = along_d * d + across * q, across * d + along_q * q
            out[k, 0] = i_ab[k, 0] + cos * more_d - sin * more_q
            out[k, 1] = i_ab[k, 1] + sin * more_d + cos * more_q
    return out
