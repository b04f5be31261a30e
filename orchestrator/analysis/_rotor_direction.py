"""Direction of a rotor's magnetic axes from the ripple of one operating point, with its standard deviation.

Three errors are kept apart. Noise is the demodulation's covariance. Iron that carries another mean current has its axes
elsewhere: the third derivatives, which the ripple shows as well, take the Hessian to a common current. The inverter
loses a voltage with the sign of each phase current; where a phase current passes zero within the ripple, that voltage
is taken for inductance, and all that is known is a bound.
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
SENSOR_SHARE = 0.005
"""Anisotropy in parts of H that sensors of unequal gain may make by themselves."""


@dataclass(frozen=True)
class Direction:
    """Angle of something that turns with the rotor [rad]; angles a `period` apart look alike."""

    angle: float
    std: float
    period: float
    inverter_bound: float = 0.0
    """Largest error of the angle by what the inverter loses while phase currents pass zero [rad]."""


@dataclass(frozen=True)
class OperatingPoint:
    """What one capture of the lock check shows.

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
        """Resistance that the ripple sees: R_s, and what the inverter loses in phase with the ripple."""
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
    """Voltage that the inverter loses with the sign of the ripple's current at rest [V].

    A loss of constant size against the current acts on the ripple as a resistance of (loss / ripple). It is seen as
    the excess of the apparent resistance at rest over that under torque, where fewer phase currents pass zero.
    """
    resistance_ohm = [float(np.mean([point.resistance_ohm for point in some])) for some in (rests, torques)]
    ripple_a = max(point.ripple_a for point in rests)
    return max(resistance_ohm[0] - resistance_ohm[1], 0.0) * ripple_a


def at_current(ripple: Ripple, current_dq: Array) -> Ripple:
    """The ripple's Hessian taken to a current nearby by its own third derivatives, with their covariance."""
    moved_wb = np.linalg.solve(ripple.hessian, current_dq - ripple.current_dq)
    d, q = moved_wb
    # of (H_11, H_12, H_22) by (H_111, H_112, H_122, H_222)
    by_third = np.array([[d, q, 0.0, 0.0], [0.0, d, q, 0.0], [0.0, 0.0, d, q]])
    shift = by_third @ ripple.third
    full = np.hstack([np.eye(3), by_third])
    covariance = ripple.covariance.copy()
    covariance[:3, :3] = full @ ripple.covariance @ full.T
    hessian = ripple.hessian + np.array([[shift[0], shift[1]], [shift[1], shift[2]]])
    return Ripple(**{**vars(ripple), "hessian": hessian, "covariance": covariance, "current_dq": current_dq})


def saliency_direction(ripple: Ripple, zeros: float = 0.0, loss_v: float = 0.0) -> Direction | None:
    """Axis of the smallest inductance; None where the motor is round within noise and sensors.

    Parameters
    ----------
    ripple : Ripple
    zeros : float
        Share of the time in which phase currents pass zero.
    loss_v : float
        What the inverter loses then [V]: it turns sign, so at most 2 zeros loss_v of the injected voltage is missing.
    """
    vector, covariance = anisotropy(ripple)
    trace = float(np.trace(ripple.hessian))
    error = 2.0 * zeros * loss_v / ripple.amplitude_v * 0.5 * trace
    return _direction(vector, covariance, trace, 2, error)


def saturation_direction(ripple: Ripple) -> Direction | None:
    """Direction in which the inductances fall: it follows the magnet even in a round motor."""
    size = float(np.trace(ripple.hessian)) / max(ripple.flux_rms_wb, 1e-12)
    return _direction(*slope(ripple), size, 1, 0.0)


def anisotropy(ripple: Ripple) -> tuple[Array, Array]:
    """(H_11 - H_22, 2 H_12) [A/Wb], which turns by twice the rotor's angle, and its covariance."""
    h = ripple.hessian
    by_h = np.array([[1.0, 0.0, -1.0], [0.0, 2.0, 0.0]])
    return np.array([h[0, 0] - h[1, 1], 2.0 * h[0, 1]]), by_h @ ripple.covariance[:3, :3] @ by_h.T


def slope(ripple: Ripple) -> tuple[Array, Array]:
    """Gradient of the Hessian's trace [A/Wb^2], shape (2,), and its covariance."""
    t = ripple.third
    by_t = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]])
    return np.array([t[0] + t[2], t[1] + t[3]]), by_t @ ripple.covariance[3:, 3:] @ by_t.T


def saliency_gain(rests: Sequence[Ripple]) -> tuple[float, float]:
    """By how much the saliency turns for each turn of the rotor while the current at rest stays, and its std.

    The rotor's own saliency turns with it; that which the current makes by saturating the iron turns with the current.
    A rotor turned by delta carries (i_d, -i_d delta) in its own frame, so that the angle of the saliency turns by

        delta (1 - i_d (dH_12 / di_q) / (H_11 - H_22)).
    """
    gains, variances = [], []
    for ripple in rests:
        (difference, _), scatter = anisotropy(ripple)
        per_flux = float(ripple.current_dq[0]) / float(difference)
        by_third = per_flux * np.linalg.inv(ripple.hessian)[1]  # dpsi / di_q
        covariance = ripple.covariance[4:6, 4:6]
        loss = float(by_third @ ripple.third[1:3])
        gains.append(1.0 - loss)
        variances.append(float(by_third @ covariance @ by_third) + loss**2 * float(scatter[0, 0]) / difference**2)
    return float(np.mean(gains)), math.sqrt(float(np.mean(variances)) / len(gains))


def saturation_gain(rest: Ripple, torques: Sequence[Ripple]) -> tuple[float, float]:
    """The same of the direction of saturation, by how far that turns under torque; its std."""
    before, scatter_before = slope(rest)
    loss, variance = 0.0, 0.0
    for ripple in torques:
        now, scatter = slope(ripple)
        share = float(rest.current_dq[0] / (before[0] * ripple.current_dq[1])) / len(torques)
        loss += share * float(now[1] - before[1])
        variance += share**2 * float(scatter[1, 1] + scatter_before[1, 1])
    return 1.0 - loss, math.sqrt(variance)


def rotation(later: Direction, earlier: Direction, gain: tuple[float, float]) -> tuple[float, float, float]:
    """Rotation of the rotor from one to the other, its standard deviation, and the inverter's part of that [rad]."""
    share, share_std = gain
    turn = math.remainder(later.angle - earlier.angle, earlier.period) / share
    # each bound is the half width of a uniform distribution
    inverter = math.hypot(later.inverter_bound, earlier.inverter_bound) / math.sqrt(3.0) / share
    noise = math.hypot(later.std, earlier.std, turn * share_std) / share
    return turn, math.hypot(noise, inverter), inverter


def _direction(vector: Array, covariance: Array, scale: float, order: int, error: float) -> Direction | None:
    length = float(np.linalg.norm(vector))
    if length <= max(SIGNIFICANT_SIGMAS * math.sqrt(float(np.trace(covariance))), SENSOR_SHARE * scale):
        return None
    across = np.array([-vector[1], vector[0]]) / length
    std = math.sqrt(float(across @ covariance @ across)) / length / order
    period = 2.0 * math.pi / order
    bound = min(error / length / order, 0.5 * period)
    return Direction(math.atan2(vector[1], vector[0]) / order, std, period, bound)
