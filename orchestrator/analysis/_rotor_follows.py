"""Detect a rotor that follows the current and returns, because its brake does not hold.

The current at rest lies on the d axis, so it brings back a rotor that is free. Friction that lets the torque turn the
rotor, and yet lets that weaker current bring it back to within the tolerance, is so small that under torque the rotor's
d axis lay along the current to within the tolerance as well. By the symmetry of a rotor about its d axis there is then

    c H n = 0,    |(H_cc - H_nn) - (H_cc - H_nn at rest)| <= increase of the trace,

c the direction of the current and n across it: more current along d saturates both axes, and the saliency changes by no
more than the two together. Any other result means that the rotor was held. This result may still come from a held
rotor that saturates: then the slope of the inductances decides, since the magnet's share of it stays with the rotor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orchestrator.analysis._ripple import Ripple
from orchestrator.analysis._rotor_direction import anisotropy, saliency_direction, saturation_direction, slope
from orchestrator.numerics.frames import to_dq

MIN_SIGMAS = 3.0
FOLLOWING_SHARE = 0.5
"""Decision threshold, halfway between a held rotor (1) and one that follows (0)."""


def follows(rest: Ripple, torques: Sequence[Ripple], tolerance_rad: float) -> bool | None:
    """Whether the rotor followed the current under torque; None where a held rotor would show the same.

    Parameters
    ----------
    rest : Ripple
        Before any torque.
    torques : sequence of Ripple
    tolerance_rad : float
        Rotation (electrical) that counts as none.
    """
    suspects = [ripple for ripple in torques if _may_lie_on_current(rest, ripple, tolerance_rad)]
    if not suspects:
        return False
    shares_at_3_sigma = [_magnet_share(rest, ripple) for ripple in suspects]
    known_shares = [share for share in shares_at_3_sigma if share is not None]
    eighth = math.sqrt(0.5)  # cosine of an eighth of a turn
    if known_shares and len(known_shares) == len(suspects) and min(low for low, _ in known_shares) > eighth:
        return False
    max_a = max(float(np.linalg.norm(ripple.current_dq)) for ripple in suspects)
    carries_current = float(np.linalg.norm(rest.current_dq)) > 0.1 * max_a
    # With a current at rest the magnet's share is an extrapolation: it may show a held rotor, but no free one.
    if not carries_current and known_shares and max(high for _, high in known_shares) < FOLLOWING_SHARE * eighth:
        return True
    return True if any(_falls(rest, ripple) for ripple in suspects) else None


def _may_lie_on_current(rest: Ripple, ripple: Ripple, tolerance_rad: float) -> bool:
    """Whether the saliency under torque is one of a rotor whose d axis lies along the current."""
    before, scatter_before = anisotropy(rest)
    now, scatter = anisotropy(ripple)
    # (H_cc - H_nn, 2 H_cn) by the anisotropy in the believed frame
    along, across = (float(x) for x in to_dq(now[None], 2.0 * _angle(ripple))[0])
    # Anisotropy across the known d axis at rest comes from unequal sensor gains or a rotation of the brake.
    unknown = abs(float(before[1])) + MIN_SIGMAS * math.sqrt(float(np.linalg.eigvalsh(scatter + scatter_before)[-1]))
    if abs(across) > unknown + 2.0 * tolerance_rad * float(np.linalg.norm(now)):
        return False
    growth = float(np.trace(ripple.hessian) - np.trace(rest.hessian))
    return abs(along - float(before[0])) <= growth + unknown


def _angle(ripple: Ripple) -> float:
    d, q = ripple.mean_current_dq
    return math.atan2(q, d)


def _magnet_share(rest: Ripple, ripple: Ripple) -> tuple[float, float] | None:
    """Bounds (3 sigma) of the magnet's slope across the current over that at rest; None where it is not significant.

    In a held rotor the slope is g + k i, the magnet's and the current's; k follows from the torque current's effect.
    A rotor whose d axis lies along the current has no slope across it.
    """
    if saturation_direction(rest) is None:
        return None
    angle = _angle(ripple)
    normal = np.array([-math.sin(angle), math.cos(angle)])
    (before, scatter_before), (now, scatter) = slope(rest), slope(ripple)
    lever = float(rest.current_dq @ normal) / float(ripple.current_dq[1] - rest.current_dq[1])
    weight = normal + np.array([0.0, lever])
    size = float(before @ weight) - lever * float(now[1])
    size_variance = float(weight @ scatter_before @ weight) + lever**2 * float(scatter[1, 1])
    if abs(size) <= MIN_SIGMAS * math.sqrt(size_variance):
        return None
    share = float(now @ normal) / size
    std = math.sqrt(float(normal @ scatter @ normal) + share**2 * size_variance) / abs(size)
    return share - MIN_SIGMAS * std, share + MIN_SIGMAS * std


def _falls(rest: Ripple, ripple: Ripple) -> bool:
    """Whether H falls on an axis by half of what a rotation causes; saturation by more current raises H."""
    if saliency_direction(rest) is None:
        return False
    saliency = abs(float(anisotropy(rest)[0][0]))
    change = ripple.hessian - rest.hessian
    std = np.sqrt(np.diag(ripple.covariance + rest.covariance)[[0, 2]])
    fall = float(np.max(-np.diag(change) - MIN_SIGMAS * std))
    return fall > FOLLOWING_SHARE * math.sin(_angle(ripple)) ** 2 * saliency
