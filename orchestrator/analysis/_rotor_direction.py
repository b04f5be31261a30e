"""Direction of a rotor's magnetic axes from the ripple of one operating point, with its standard deviation.

The Hessian is H = (dpsi/di)^-1. The error budget has three terms. Noise is the demodulation's covariance. Saturation
turns the axes with the mean current: the third derivatives, measured by the same ripple, correct H to a common current.
The inverter's voltage error has the sign of each phase current; where a phase current passes zero within the ripple,
the error looks like an inductance, and only a bound of it is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.analysis._ripple import Ripple
from orchestrator.numerics.frames import to_phases
from orchestrator.numerics.types import Array
from protocols import Capture

SIGNIFICANT_SIGMAS = 5.0
"""Length of a vector in standard deviations from which on its direction is used."""
MIN_RELATIVE_ANISOTROPY = 0.005
"""Anisotropy of H over its trace that current sensors of unequal gain alone can cause."""


@dataclass(frozen=True)
class Direction:
    """Angle of a quantity that rotates with the rotor [rad], known modulo `period`."""

    angle: float
    std: float
    period: float
    inverter_bound: float = 0.0
    """Largest error of the angle from the inverter's voltage error while phase currents pass zero [rad]."""


@dataclass(frozen=True)
class OperatingPoint:
    """Evaluation of one capture of the lock check.

    Attributes
    ----------
    ripple : Ripple
    zero_share : float
        Share of the time in which a phase current has the other sign than on average.
    """

    ripple: Ripple
    zero_share: float

    @property
    def resistance_ohm(self) -> float:
        """Apparent resistance at the ripple: R_s plus the inverter's voltage error in phase with the ripple current."""
        return self.ripple.decay_per_s / float(np.linalg.eigvalsh(self.ripple.hessian)[0])

    @property
    def ripple_a(self) -> float:
        """Amplitude of the current ripple [A]."""
        return math.sqrt(2.0) * self.ripple.flux_rms_wb * float(np.linalg.eigvalsh(self.ripple.hessian)[1])


def zero_share(capture: Capture) -> float:
    """Share of the samples in which some phase current has the other sign than on average."""
    phases = to_phases(capture.i_ab)
    against = phases * np.sign(phases.mean(axis=0, dtype=np.float64)) <= 0.0
    return float(against.any(axis=1).mean())


def inverter_loss_v(rests: Sequence[OperatingPoint], torques: Sequence[OperatingPoint]) -> float:
    """Inverter voltage error with the sign of the ripple current at rest [V].

    An error of constant size opposed to the current acts on the ripple as a resistance of (error / ripple). It is the
    excess of the apparent resistance at rest over that under torque, where fewer phase currents pass zero.
    """
    resistance_ohm = [float(np.mean([point.resistance_ohm for point in some])) for some in (rests, torques)]
    ripple_a = max(point.ripple_a for point in rests)
    return max(resistance_ohm[0] - resistance_ohm[1], 0.0) * ripple_a


def corrected_to_current(ripple: Ripple, current_dq: Array) -> Ripple:
    """The ripple with its Hessian extrapolated to a nearby current by the third derivatives, covariance propagated."""
    step_wb = np.linalg.solve(ripple.hessian, current_dq - ripple.current_dq)
    d, q = step_wb
    # Jacobian d(H_11, H_12, H_22) / d(H_111, H_112, H_122, H_222)
    jacobian_third = np.array([[d, q, 0.0, 0.0], [0.0, d, q, 0.0], [0.0, 0.0, d, q]])
    shift = jacobian_third @ ripple.third
    full = np.hstack([np.eye(3), jacobian_third])
    covariance = ripple.covariance.copy()
    covariance[:3, :3] = full @ ripple.covariance @ full.T
    hessian = ripple.hessian + np.array([[shift[0], shift[1]], [shift[1], shift[2]]])
    return Ripple(**{**vars(ripple), "hessian": hessian, "covariance": covariance, "current_dq": current_dq})


def saliency_direction(ripple: Ripple, zeros: float = 0.0, loss_v: float = 0.0) -> Direction | None:
    """Axis of the smallest inductance; None where noise and sensor gains explain the anisotropy.

    Parameters
    ----------
    ripple : Ripple
    zeros : float
        Share of the time in which phase currents pass zero.
    loss_v : float
        Voltage error of the inverter [V]: it changes sign then, so at most 2 zeros loss_v of the injection is missing.
    """
    vector, covariance = anisotropy(ripple)
    trace = float(np.trace(ripple.hessian))
    error = 2.0 * zeros * loss_v / ripple.amplitude_v * 0.5 * trace
    return _direction(vector, covariance, trace, 2, error)


def saturation_direction(ripple: Ripple) -> Direction | None:
    """Direction in which the inductances fall; it follows the magnet even in a motor without saliency."""
    size = float(np.trace(ripple.hessian)) / max(ripple.flux_rms_wb, 1e-12)
    return _direction(*slope(ripple), size, 1, 0.0)


def anisotropy(ripple: Ripple) -> tuple[Array, Array]:
    """(H_11 - H_22, 2 H_12) [A/Wb], which rotates by twice the rotor's angle, and its covariance."""
    h = ripple.hessian
    by_h = np.array([[1.0, 0.0, -1.0], [0.0, 2.0, 0.0]])
    return np.array([h[0, 0] - h[1, 1], 2.0 * h[0, 1]]), by_h @ ripple.covariance[:3, :3] @ by_h.T


def slope(ripple: Ripple) -> tuple[Array, Array]:
    """Gradient of the Hessian's trace [A/Wb^2], shape (2,), and its covariance."""
    t = ripple.third
    by_t = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]])
    return np.array([t[0] + t[2], t[1] + t[3]]), by_t @ ripple.covariance[3:, 3:] @ by_t.T


def saliency_sensitivity(rests: Sequence[Ripple]) -> tuple[float, float]:
    """Rotation of the saliency axis per rotation of the rotor at constant current (1 without saturation), and its std.

    The rotor's own saliency rotates with it; the saliency from saturation by the current stays with the current.
    A rotor turned by delta carries (i_d, -i_d delta) in its own frame, so the saliency axis rotates by

        delta (1 - i_d (dH_12 / di_q) / (H_11 - H_22)).
    """
    sensitivities, variances = [], []
    for ripple in rests:
        (difference, _), scatter = anisotropy(ripple)
        per_flux = float(ripple.current_dq[0]) / float(difference)
        row = per_flux * np.linalg.inv(ripple.hessian)[1]  # dpsi / di_q
        covariance = ripple.covariance[4:6, 4:6]
        reduction = float(row @ ripple.third[1:3])
        sensitivities.append(1.0 - reduction)
        variances.append(float(row @ covariance @ row) + reduction**2 * float(scatter[0, 0]) / difference**2)
    return float(np.mean(sensitivities)), math.sqrt(float(np.mean(variances)) / len(sensitivities))


def saturation_sensitivity(rest: Ripple, torques: Sequence[Ripple]) -> tuple[float, float]:
    """Sensitivity of the saturation direction, from its rotation under torque current; its std."""
    slope_before, scatter_before = slope(rest)
    reduction, variance = 0.0, 0.0
    for ripple in torques:
        slope_now, scatter = slope(ripple)
        weight = float(rest.current_dq[0] / (slope_before[0] * ripple.current_dq[1])) / len(torques)
        reduction += weight * float(slope_now[1] - slope_before[1])
        variance += weight**2 * float(scatter[1, 1] + scatter_before[1, 1])
    return 1.0 - reduction, math.sqrt(variance)


def rotation(later: Direction, earlier: Direction, sensitivity: tuple[float, float]) -> tuple[float, float, float]:
    """(angle, total standard deviation, standard deviation due to the inverter) of the rotor's rotation [rad]."""
    ratio, ratio_std = sensitivity
    angle = math.remainder(later.angle - earlier.angle, earlier.period) / ratio
    # each bound is the half width of a uniform distribution
    inverter = math.hypot(later.inverter_bound, earlier.inverter_bound) / math.sqrt(3.0) / ratio
    noise = math.hypot(later.std, earlier.std, angle * ratio_std) / ratio
    return angle, math.hypot(noise, inverter), inverter


def _direction(vector: Array, covariance: Array, scale: float, order: int, error: float) -> Direction | None:
    length = float(np.linalg.norm(vector))
    if length <= max(SIGNIFICANT_SIGMAS * math.sqrt(float(np.trace(covariance))), MIN_RELATIVE_ANISOTROPY * scale):
        return None
    across = np.array([-vector[1], vector[0]]) / length
    std = math.sqrt(float(across @ covariance @ across)) / length / order
    period = 2.0 * math.pi / order
    bound = min(error / length / order, 0.5 * period)
    return Direction(math.atan2(vector[1], vector[0]) / order, std, period, bound)
