"""Errors of the rotor angle: a misaligned rotor, and a brake with compliance or backlash."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from numba import njit
from scipy.signal import cont2discrete, lfilter_zi, ss2tf

from orchestrator.numerics.types import Array
from plugins.effects._batches import BatchEffect, by_value
from plugins.effects._filters import low_pass, second_order
from plugins.effects._flux import typical_inductance
from plugins.effects._vectors import Starts, doubles
from protocols import (
    Contrast,
    Correction,
    EffectLayer,
    EffectParameters,
    RealArray,
    SignalBatch,
    amplitude,
    refinement,
    shape,
)


class RotorMisalignment(BatchEffect):
    """True electrical angle = believed + delta [rad].

    It is observable as the map is even in the true i_q: in the believed frame L_dq(i_d, 0) is about (L_d - L_q) delta.
    """

    name: ClassVar[str] = "rotor_misalignment"
    summary: ClassVar[str] = "The rotor is not at the angle that the operator believes in."
    signature: ClassVar[str] = (
        "Evenness in i_q: the flux of the d axis tilts with i_q, by the same angle in every stage."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.FRAME
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_ANGLE,)
    gauge: ClassVar[str] = (
        "The angle is that at which the map is symmetric in i_q; that the motor's map is symmetric is assumed."
    )
    compensable: ClassVar[bool] = True
    """By the angle's offset in the drive."""
    remedy: ClassVar[str] = "add it to the angle that the drive believes, such as the encoder's offset"

    class Parameters(EffectParameters):
        angle_rad: float = amplitude("rad", typical=0.035, prior_width=0.05, low=-0.6, high=0.6)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Rotate the d axis to its true angle."""
        return Correction(theta_rad=batch.theta_rad + p.angle_rad)


class BrakeCompliance(BatchEffect):
    """A compliant brake: delta = kappa T_e, T_e = 3/2 n (psi_d i_q - psi_q i_d) [Nm].

    kappa is in electrical radians per Nm.

    The twist rotates the magnet's flux and induces a voltage. It lags the torque by viscous friction; without a lag it
    would be equivalent to a q-axis inductance. In the flexible form the rotor has inertia and oscillates on the brake's
    spring, delta + lag_s delta' + inertia_s2 delta'' = kappa T_e. Dry friction, `friction_nm`, holds it where it is
    until the torque has changed by twice as much; the part `elastic` of the twist follows before it slides.
    Sources: a spring beside friction is a play operator, M. Brokate, J. Sprekels, doi:10.1007/978-1-4612-4048-8; what
    follows before it slides: P. Dahl, doi:10.2514/3.61511.
    """

    name: ClassVar[str] = "brake_compliance"
    summary: ClassVar[str] = "The locked rotor twists with the torque."
    signature: ClassVar[str] = (
        "Flux loop on q: a little steeper than the model's and open, as the rotor turns with the slow sweep's "
        "torque and not with the ripple."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.FRAME
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "Without the magnet's flux on the nameplate a compliance passes for q-axis inductance."

    class Parameters(EffectParameters):
        rad_per_nm: float = amplitude("rad/Nm", typical=0.005, prior_width=0.01, low=0.0, high=0.1)
        lag_s: float = shape("s", typical=1e-3, prior_width=1.5, low=1e-5, high=0.1)
        inertia_s2: float = refinement("s^2", neutral=0.0, prior_width=1e-6, low=0.0, high=1e-3, other_form=3e-8)
        friction_nm: float = refinement("Nm", neutral=0.0, prior_width=0.3, low=0.0, high=10.0, other_form=0.1)
        elastic: float = refinement("1", neutral=0.0, prior_width=0.3, low=0.0, high=1.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Add the twist to the angle; nothing changes without a flux in the signals."""
        psi_ab, i_ab = _flux_and_current(batch)
        if psi_ab is None:
            return Correction()
        torque = _torque_of(psi_ab, i_ab, batch)
        if p.friction_nm > 0.0:
            slid = _slid(torque, batch.starts, *_torque_before(psi_ab, i_ab, batch), p.friction_nm)
            torque = slid + p.elastic * (torque - slid)
        twist = _swinging(torque, p.lag_s, p.inertia_s2, batch)
        twist *= p.rad_per_nm
        twist += batch.theta_rad
        return Correction(theta_rad=twist)


class BrakeBacklash(BatchEffect):
    """A brake with backlash: the rotor lies at either end of a gap, delta = gap/2 s(T_e / T_f), with a lag.

    The gap is in electrical radians; it is crossed within the friction torque T_f [Nm] by s(x) = x / (1 + |x|^p)^(1/p),
    p = 1 / `softness`.
    """

    name: ClassVar[str] = "brake_backlash"
    summary: ClassVar[str] = "The locked rotor has play, and turns to its other end with the torque's sign."
    signature: ClassVar[str] = (
        "Flux loop on q: a step where i_q and with it the torque changes its sign; two angles, one for each sign."
    )
    layer: ClassVar[EffectLayer] = EffectLayer.FRAME
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        gap_rad: float = amplitude("rad", typical=0.01, prior_width=0.01, low=0.0, high=0.2)
        friction_nm: float = shape("Nm", typical=0.05, prior_width=1.0, low=1e-3, high=1.0)
        lag_s: float = shape("s", typical=1e-3, prior_width=1.5, low=1e-5, high=0.1)
        softness: float = refinement("1", neutral=0.5, prior_width=0.2, low=0.1, high=1.0)

    def correct_batch(self, batch: SignalBatch, p: Parameters) -> Correction:
        """Add the position in the gap to the angle; nothing changes without a flux in the signals."""
        torque = _torque_nm(batch)
        if torque is None:
            return Correction()
        lies = _late(_ends(torque, p.friction_nm, p.softness), p.lag_s, batch)
        lies *= 0.5 * p.gap_rad
        lies += batch.theta_rad
        return Correction(theta_rad=lies)


def _ends(torque_nm: Array, friction_nm: float, softness: float) -> Array:
    """Static position of the rotor in its gap, (N,), from -1 at one end to 1 at the other."""
    x = torque_nm / friction_nm
    large = np.abs(x)
    # Only powers of numbers below one are taken, so that none overflows.
    share = np.minimum(large, 1.0)
    np.maximum(large, 1.0, out=large)
    large **= -1.0 / softness
    large += share ** (1.0 / softness)
    large **= softness
    share /= large
    return np.copysign(share, x, out=share)


def _torque_nm(batch: SignalBatch) -> Array | None:
    """T_e = 3/2 n (psi_d i_q - psi_q i_d), shape (N,); None without a flux."""
    psi, i = _flux_and_current(batch)
    return None if psi is None else _torque_of(psi, i, batch)


def _flux_and_current(batch: SignalBatch) -> tuple[RealArray | None, RealArray]:
    """Flux and current of the torque, both (N, 2): with the readings' noise it would rotate the frame at every one."""
    if batch.psi_smooth_ab is None or batch.i_smooth_ab is None:
        return batch.psi_ab, batch.i_ab
    return batch.psi_smooth_ab, batch.i_smooth_ab


def _torque_of(psi_ab: RealArray, i_ab: RealArray, batch: SignalBatch) -> Array:
    pairs = batch.motor.pole_pairs if batch.motor is not None else 1
    return np.asarray(_torques(doubles(psi_ab), doubles(i_ab), 1.5 * pairs))


@njit(cache=True, nogil=True)
def _torques(psi_ab: Array, i_ab: Array, factor: float) -> Array:
    out = np.empty(psi_ab.shape[0])
    for k in range(psi_ab.shape[0]):
        out[k] = factor * (psi_ab[k, 0] * i_ab[k, 1] - psi_ab[k, 1] * i_ab[k, 0])
    return out


def _torque_before(psi_ab: RealArray, i_ab: RealArray, batch: SignalBatch) -> tuple[Array, Starts]:
    """Torque (M,) on the way to each segment, where its current came from, and the bounds of these by segment."""
    came_from = [np.zeros((0, 2)) if s.came_from_ab is None else s.came_from_ab for s in batch.segments]
    count, first, before_ab = np.array([len(one) for one in came_from]), batch.starts[:-1], np.concatenate(came_from)
    change_ab = before_ab - i_ab[first].repeat(count, axis=0)
    flux_ab = psi_ab[first].repeat(count, axis=0) + typical_inductance(batch).repeat(count)[:, None] * change_ab
    return _torque_of(flux_ab, before_ab, batch), np.append(0, np.cumsum(count))


@njit(cache=True, nogil=True)
def _slid(x: Array, starts: Starts, before: Array, before_starts: Starts, half_width: float) -> Array:
    """Play operator of x (N,), segment by segment.

    Parameters
    ----------
    before, before_starts : array
        What preceded each segment, oldest first; the play begins in its middle. Of a segment without any, its end did.
    """
    out = np.empty_like(x)
    for s in range(starts.shape[0] - 1):
        first, end = before_starts[s], before_starts[s + 1]
        if end > first:
            y = before[first]
            for k in range(first, end):
                y = max(before[k] - half_width, min(before[k] + half_width, y))
        else:
            y = x[starts[s + 1] - 1]
            for k in range(starts[s], starts[s + 1]):
                y = max(x[k] - half_width, min(x[k] + half_width, y))
        for k in range(starts[s], starts[s + 1]):
            y = max(x[k] - half_width, min(x[k] + half_width, y))
            out[k] = y
    return out


MIN_LAG_SAMPLES = 1e-3
"""Lag below which it is neglected, as the matrix exponential cannot resolve it beside a lag of many samples."""


def _swinging(x: Array, lag_s: float, inertia_s2: float, batch: SignalBatch) -> Array:
    """y (N,) of y + lag y' + inertia y'' = x, in steady state at each segment's x_0; exact for x linear in between."""
    # Only a lag where the inertia is negligible within a sample period.
    y = _late(x, lag_s, batch)
    for rate_hz, segments in by_value(batch.sampling_frequency_hz):
        step_s = 1.0 / rate_hz
        if inertia_s2 > lag_s * MIN_LAG_SAMPLES * step_s:
            second_order(y, x, batch.starts, segments, *_spring(lag_s, inertia_s2, step_s))
    return y


def _spring(lag_s: float, inertia_s2: float, step_s: float) -> tuple[Array, Array, Array]:
    """The filter of `_swinging` for one sampling interval, as arguments of `second_order`."""
    # With y and its rate over the natural frequency as states, both have the same scale.
    natural = 1.0 / math.sqrt(inertia_s2)
    state = np.array([[0.0, natural], [-natural, -lag_s * natural**2]])
    force, output = np.array([[0.0], [natural]]), np.array([[1.0, 0.0]])
    phi, gamma, out, through, _ = cont2discrete((state, force, output, np.zeros((1, 1))), step_s, method="foh")
    above, below = ss2tf(phi, gamma, out, through)
    return above[0].copy(), below, lfilter_zi(above[0], below)


def _late(x: Array, lag_s: float, batch: SignalBatch) -> Array:
    """x (N,) behind a first-order lag."""
    return np.asarray(low_pass(x, batch.starts, doubles(1.0 / (lag_s * batch.sampling_frequency_hz))))
