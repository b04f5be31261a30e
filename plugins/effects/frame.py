"""Angles that are not what the operator believes: a misaligned rotor, a brake that gives way, or has play."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from scipy.signal import cont2discrete, lfilter, lfilter_zi, ss2tf

from orchestrator.numerics.types import Array
from plugins.effects._filters import low_pass
from protocols import Contrast, Correction, EffectLayer, EffectParameters, Signals, amplitude, refinement, shape


class RotorMisalignment:
    """True electrical angle = believed + delta [rad].

    It shows only because the machine is even in the true i_q: in the believed frame the map then has
    L_dq(i_d, 0) of about (L_d - L_q) delta.
    """

    name: ClassVar[str] = "rotor_misalignment"
    summary: ClassVar[str] = "The rotor is not at the angle that the operator believes in."
    signature: ClassVar[str] = "A map that is not even in i_q, with reciprocity kept."
    layer: ClassVar[EffectLayer] = EffectLayer.FRAME
    needs: ClassVar[tuple[Contrast, ...]] = (Contrast.SECOND_ANGLE,)
    gauge: ClassVar[str] = "The angle is visible only through the assumed evenness in i_q."

    class Parameters(EffectParameters):
        angle_rad: float = amplitude("rad", typical=0.035, prior_width=0.05, low=-0.6, high=0.6)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """Turn the d axis to where it is."""
        return Correction(theta_rad=signals.theta_rad + p.angle_rad)


class BrakeCompliance:
    """A brake that gives way: delta = kappa T_e, T_e = 3/2 n (psi_d i_q - psi_q i_d) [Nm].

    kappa is in electrical radians per Nm.

    A twist that follows the torque turns the magnet's flux and so induces a voltage. It lags the torque by the
    time that friction asks for: without a lag it would be one more q-axis inductance. In the flexible form the rotor
    has inertia and swings on the brake's spring, delta + lag_s delta' + inertia_s2 delta'' = kappa T_e.
    """

    name: ClassVar[str] = "brake_compliance"
    summary: ClassVar[str] = "The locked rotor twists with the torque."
    signature: ClassVar[str] = "A voltage with every change of torque, and an angle that follows the torque."
    layer: ClassVar[EffectLayer] = EffectLayer.FRAME
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = "Without the magnet's flux on the nameplate a compliance passes for q-axis inductance."

    class Parameters(EffectParameters):
        rad_per_nm: float = amplitude("rad/Nm", typical=0.005, prior_width=0.01, low=0.0, high=0.1)
        lag_s: float = shape("s", typical=1e-3, prior_width=1.5, low=1e-5, high=0.1)
        inertia_s2: float = refinement("s^2", neutral=0.0, prior_width=1e-6, low=0.0, high=1e-3, other_form=3e-8)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """Add the twist to the angle; without a flux in the signals there is no torque, and nothing changes."""
        torque = _torque_nm(signals)
        if torque is None:
            return Correction()
        twist = _swinging(torque, p.lag_s, p.inertia_s2, signals)
        return Correction(theta_rad=signals.theta_rad + p.rad_per_nm * twist)


class BrakeBacklash:
    """A brake with play: the rotor lies at either end of a gap, delta = gap/2 s(T_e / T_f), with a lag.

    The gap is in electrical radians; within the torque T_f [Nm], friction's, it is crossed by
    s(x) = x / (1 + |x|^p)^(1/p), p = 1 / `softness`.
    """

    name: ClassVar[str] = "brake_backlash"
    summary: ClassVar[str] = "The locked rotor has play, and turns to its other end with the torque's sign."
    signature: ClassVar[str] = "A voltage where the torque changes its sign, and two angles, one for each sign."
    layer: ClassVar[EffectLayer] = EffectLayer.FRAME
    needs: ClassVar[tuple[Contrast, ...]] = ()
    gauge: ClassVar[str] = ""

    class Parameters(EffectParameters):
        gap_rad: float = amplitude("rad", typical=0.01, prior_width=0.01, low=0.0, high=0.2)
        friction_nm: float = shape("Nm", typical=0.05, prior_width=1.0, low=1e-3, high=1.0)
        lag_s: float = shape("s", typical=1e-3, prior_width=1.5, low=1e-5, high=0.1)
        softness: float = refinement("1", neutral=0.5, prior_width=0.2, low=0.1, high=1.0)

    def correct(self, signals: Signals, p: Parameters) -> Correction:
        """Add to the angle where in its gap the rotor lies; without a flux in the signals nothing changes."""
        torque = _torque_nm(signals)
        if torque is None:
            return Correction()
        x = torque / p.friction_nm
        size = np.abs(x)
        # Powers of what is below one alone, so that none overflows.
        small, large = np.minimum(size, 1.0), np.maximum(size, 1.0)
        share = small / (small ** (1.0 / p.softness) + large ** (-1.0 / p.softness)) ** p.softness
        end = np.copysign(share, x)
        return Correction(theta_rad=signals.theta_rad + 0.5 * p.gap_rad * _late(end, p.lag_s, signals))


def _torque_nm(signals: Signals) -> Array | None:
    """T_e = 3/2 n (psi_d i_q - psi_q i_d), shape (n,); None without a flux."""
    # A torque with the readings' noise in it would turn the frame to and fro with every sample.
    psi, i = signals.psi_smooth_ab, signals.i_smooth_ab
    if psi is None or i is None:
        psi, i = signals.psi_ab, signals.i_ab
    if psi is None:
        return None
    pairs = signals.motor.pole_pairs if signals.motor is not None else 1
    return np.asarray(1.5 * pairs * (psi[:, 0] * i[:, 1] - psi[:, 1] * i[:, 0]), dtype=np.float64)


NO_TIME = 1e-3
"""Of a sample period, a lag that is none; and no matrix exponential tells it beside a lag of many."""


def _swinging(x: Array, lag_s: float, inertia_s2: float, signals: Signals) -> Array:
    """y (n,) of y + lag y' + inertia y'' = x, from rest at x_0; exact for what is linear between samples."""
    step = 1.0 / signals.sampling_frequency_hz
    if inertia_s2 <= lag_s * NO_TIME * step:
        return _late(x, lag_s, signals)
    # In y and its rate over the natural frequency both states are of one size, however fast they are.
    natural = 1.0 / math.sqrt(inertia_s2)
    state = np.array([[0.0, natural], [-natural, -lag_s * natural**2]])
    force, seen = np.array([[0.0], [natural]]), np.array([[1.0, 0.0]])
    phi, gamma, out, through, _ = cont2discrete((state, force, seen, np.zeros((1, 1))), step, method="foh")
    above, below = ss2tf(phi, gamma, out, through)
    return np.asarray(lfilter(above[0], below, x, zi=lfilter_zi(above[0], below) * x[0])[0])


def _late(x: Array, lag_s: float, signals: Signals) -> Array:
    """The same (n,) behind a first-order lag."""
    rate = 1.0 / (lag_s * signals.sampling_frequency_hz)
    return np.asarray(low_pass(np.ascontiguousarray(x[:, None]), rate)[:, 0])
