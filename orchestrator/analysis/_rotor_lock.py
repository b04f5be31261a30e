"""Check that the rotor is locked, by the angle of its saliency at rest and under torque.

The principal axes of the Hessian rotate with the rotor. Injections at rest, under positive torque, at rest, under
negative torque and at rest measure the rotor's lasting rotation between the rests (a slipping brake, or no lock) and an
apparent turn while the torque acts, since cross-saturation rotates the axes as well. The axes' angle is known modulo
half a turn; the axes of a rotor that follows the current vector rotate by that much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.analysis._ripple import Ripple, demodulate
from orchestrator.analysis._rotor_direction import (
    Direction,
    OperatingPoint,
    corrected_to_current,
    inverter_loss_v,
    rotation,
    saliency_direction,
    saliency_sensitivity,
    saturation_direction,
    saturation_sensitivity,
    zero_share,
)
from orchestrator.analysis._rotor_follows import follows
from orchestrator.numerics.frames import to_dq
from protocols import Capture, LockChecked, NotMeasuredError, Segment

MIN_LOCK_PROBABILITY = 0.95
"""Minimum probability of a rotation within the tolerance for a rotor that counts as locked."""
NAMEPLATE_MARGIN = 0.9
"""Margin on a current computed from the nameplate's flux and inductances, which are accurate to some percent."""
MOVEMENT_SIGMAS = 3.0
"""A rotation beyond the tolerance counts as movement above this many of its standard deviations."""
DECIDING_SIGMAS = 4.5
"""Tolerance over the rotation's standard deviation at which a held rotor is found locked 99 times of 100."""


def judge_lock(
    captures: Sequence[tuple[Segment, Capture]],
    tolerance_rad: float,
    *,
    voltage_delay_samples: float = 0.0,
    time_constant_s: float | None = None,
    aligning_current_a: float = math.inf,
) -> LockChecked:
    """Judge from injection captures at rest and under torque whether the rotor turned.

    Parameters
    ----------
    captures : sequence of (Segment, Capture)
        In order of time, with currents of zero, plus, zero, minus, zero on the believed q axis, and a constant current
        (or none) on the d axis. The waveforms show which capture is which.
    tolerance_rad : float
        Largest lasting rotation (electrical) that counts as locked.
    voltage_delay_samples, time_constant_s : float
        As in `demodulate`.
    aligning_current_a : float
        Current above which reluctance outweighs the magnet, so a free rotor does not align its d axis with it [A].

    Raises
    ------
    NotMeasuredError
        Where there are fewer than two rests or no torque between them.

    Notes
    -----
    `locked` is None where the rotation is too uncertain, or where the rotor is back at each rest and both explanations
    of the inductances under torque remain: a rotor that follows the current, and saturation by that current.
    """
    points = []
    for segment, capture in captures:
        try:
            ripple = demodulate(
                capture,
                segment.rotor_angle_rad,
                voltage_delay_samples=voltage_delay_samples,
                time_constant_s=time_constant_s,
                where=segment.id,
            )
        except NotMeasuredError as error:
            return _unknown(tolerance_rad, f"{error}{_off_target(segment, capture)}")
        points.append(OperatingPoint(ripple, zero_share(capture)))
    torque_a = np.array([abs(float(point.ripple.mean_current_dq[1])) for point in points])
    at_rest = torque_a < 0.3 * torque_a.max() if len(points) else np.zeros(0, dtype=bool)
    rests = [point for point, rest in zip(points, at_rest, strict=True) if rest]
    loaded = [point for point, rest in zip(points, at_rest, strict=True) if not rest]
    if len(rests) < 2 or not loaded:
        raise NotMeasuredError("lock_check", "segments", "needs injection at rest before and after one under torque")
    first, torques, loss_v = rests[0].ripple, [point.ripple for point in loaded], inverter_loss_v(rests, loaded)
    ripples = [corrected_to_current(point.ripple, first.current_dq) for point in rests]
    salient = [saliency_direction(r, p.zero_share, loss_v) for r, p in zip(ripples, rests, strict=True)]
    free = follows(first, torques, tolerance_rad)
    max_a = max(float(np.linalg.norm(ripple.mean_current_dq)) for ripple in torques)
    is_twisted = abs(_twist_rad(first, torques)) > tolerance_rad
    if free is False and max_a > NAMEPLATE_MARGIN * aligning_current_a and is_twisted:
        # Symmetry then hides the rotation under torque, and the current at rest returns the rotor.
        free = None if float(np.linalg.norm(first.mean_current_dq)) > 0.1 * max_a else free
    by_saliency = [direction for direction in salient if direction is not None]
    if len(by_saliency) == len(rests) and _rotates_with_rotor(gain := saliency_sensitivity(ripples)):
        inverter = _Inverter(loss_v, first.amplitude_v, max(point.zero_share for point in rests))
        return _verdict(by_saliency, gain, free, tolerance_rad, inverter, _Twist(_twist_rad(first, torques)))
    by_saturation = [direction for direction in map(saturation_direction, ripples) if direction is not None]
    if len(by_saturation) == len(rests) and _rotates_with_rotor(gain := saturation_sensitivity(first, torques)):
        return _verdict(by_saturation, gain, free, tolerance_rad)
    reason = "at rest neither the inductances nor their saturation show a saliency that rotates with the rotor"
    return _unknown(tolerance_rad, f"{reason}, so a rotation cannot be measured")


def lock_duration_ratio(
    segment: Segment, capture: Capture, tolerance_rad: float, *, voltage_delay_samples: float = 0.0
) -> float:
    """Required duration of a lock check's captures over this one's, for noise small enough to decide.

    Parameters
    ----------
    segment, capture : Segment, Capture
        Injection at rest, before any torque: later rests are compared with it, so its noise cannot be averaged later.
    tolerance_rad : float
        Largest lasting rotation (electrical) that counts as locked.
    voltage_delay_samples : float
        As in `demodulate`.

    Notes
    -----
    Noise falls with the root of the time. Below 1 where a shorter capture suffices; 1 where this shows no direction.
    """
    try:
        ripple = demodulate(
            capture, segment.rotor_angle_rad, voltage_delay_samples=voltage_delay_samples, where=segment.id
        )
    except NotMeasuredError:
        return 1.0
    saliency, saturation = saliency_direction(ripple), saturation_direction(ripple)
    gain = saliency_sensitivity([ripple])
    is_rotor_fixed = saliency is not None and _rotates_with_rotor(gain)
    direction = saliency if is_rotor_fixed else saturation or saliency
    if direction is None:
        return 1.0
    std = math.sqrt(2.0) * direction.std  # difference of two rests
    return _duration_ratio(std / abs(gain[0]) if is_rotor_fixed else std, tolerance_rad)


def _duration_ratio(std_rad: float, tolerance_rad: float) -> float:
    """Required duration over the present one for a rotation of this standard deviation to be decided."""
    return (DECIDING_SIGMAS * std_rad / tolerance_rad) ** 2


def _rotates_with_rotor(sensitivity: tuple[float, float]) -> bool:
    """Whether a direction rotates with the rotor and not with the current that saturates the iron."""
    return abs(sensitivity[0]) > MOVEMENT_SIGMAS * sensitivity[1]


def _off_target(segment: Segment, capture: Capture) -> str:
    """A remark where the current deviates far from its set point; imported settings may have no set point."""
    target = [segment.settings.get(f"target_{axis}_a") for axis in "dq"]
    if not all(isinstance(value, int | float) for value in target):
        return ""
    commanded = np.array(target, dtype=np.float64)
    mean = to_dq(capture.i_ab, segment.rotor_angle_rad).mean(axis=0)
    if np.linalg.norm(mean - commanded) <= 0.1 * np.linalg.norm(commanded):
        return ""
    return (
        f"; ({mean[0]:.3g}, {mean[1]:.3g}) A flow instead of ({commanded[0]:.3g}, {commanded[1]:.3g}) A: a longer "
        "settle_s lets the current control overcome the inverter's dead time"
    )


def _unknown(tolerance_rad: float, reason: str) -> LockChecked:
    # Without a measured angle the prior is uniform over +-a quarter turn.
    return LockChecked(
        locked=None,
        confidence=min(tolerance_rad / (0.5 * math.pi), 1.0),
        moved_rad=0.0,
        moved_std_rad=0.5 * math.pi / math.sqrt(3.0),
        twist_rad=0.0,
        summary=f"cannot tell: {reason}; no sign of movement, so the lock rests on the brake alone",
    )


@dataclass(frozen=True)
class _Inverter:
    """Voltage error of the inverter while phase currents pass zero at rest."""

    loss_v: float
    injected_v: float
    zero_share: float

    def describe(self, rotation_rad: float) -> str:
        return (
            f"phase currents have the other sign for {self.zero_share:.0%} of the time at rest, where the inverter may "
            f"lose {self.loss_v:.2g} V of the {self.injected_v:.2g} V injected: that alone may look like "
            f"{math.degrees(2.0 * rotation_rad):.2g} deg; a larger rest_current_a keeps them from zero, with "
            "alignment.angle_rad at a multiple of 60 deg"
        )


@dataclass(frozen=True)
class _Twist:
    """Rotation of the saliency at rest that would explain the coupling under torque [rad]."""

    angle_rad: float

    def describe(self, tolerance_rad: float) -> str:
        # A rotation changes the coupling by half the saliency at most: more is cross-saturation.
        if abs(self.angle_rad) > 0.5:
            return "cross-saturation under torque hides any twist"
        size = f"{math.degrees(self.angle_rad):+.2f} deg el."
        if abs(self.angle_rad) <= tolerance_rad:
            return f"twist under torque {size}"
        return f"cross-saturation under torque turns the saliency by {size}, not the rotor"


def _verdict(
    rests: Sequence[Direction],
    sensitivity: tuple[float, float],
    free: bool | None,
    tolerance_rad: float,
    inverter: _Inverter | None = None,
    twist: _Twist | None = None,
) -> LockChecked:
    rotations = [rotation(rest, rests[0], sensitivity) for rest in rests[1:]]
    moved, std, inverter_std = max(rotations, key=lambda angle: abs(angle[0]))
    confidence = min(_within(angle, sigma, tolerance_rad) for angle, sigma, _ in rotations)
    has_moved = any(abs(angle) > max(tolerance_rad, MOVEMENT_SIGMAS * sigma) for angle, sigma, _ in rotations)
    locked: bool | None = confidence >= MIN_LOCK_PROBABILITY
    finding = "locked"
    if free:
        finding = "the saliency follows the current vector: the rotor is free"
        locked, confidence = False, min(confidence, 1e-6)
    elif has_moved:
        finding, locked = "the rotor moved", False
    elif not locked:
        finding, locked = "cannot tell: the rotation is not known to within the tolerance", None
        if inverter_std > 0.5 * std and inverter is not None:
            finding += f": {inverter.describe(inverter_std)}"
        else:
            longer = max(2.0, _duration_ratio(std, tolerance_rad))
            finding += f": a duration_s {longer:.2g} times as long would tell"
    elif free is None:
        finding = (
            "cannot tell: under torque this saliency is that of a rotor that follows the current and comes back, "
            "or of one that is held and saturates; a smaller torque_current_a may tell"
        )
        locked = None
    size = f"lasting rotation {math.degrees(moved):+.2f} +- {math.degrees(2 * std):.2f} deg el. (95 %)"
    source = (
        twist.describe(tolerance_rad)
        if twist is not None
        else "measured by the direction of saturation, as the motor shows no saliency"
    )
    return LockChecked(
        locked=locked,
        confidence=confidence,
        moved_rad=moved,
        moved_std_rad=std,
        twist_rad=twist.angle_rad if twist is not None else 0.0,
        summary=f"{finding}; {size}, tolerance {math.degrees(tolerance_rad):.2f} deg; {source}",
    )


def _twist_rad(rest: Ripple, torques: Sequence[Ripple]) -> float:
    """Apparent twist under torque [rad].

    The rotation of the saliency at rest that gives the coupling H_12 measured under torque: half the difference between
    both signs of torque. The principal axes themselves are unsuitable, since at full current saturation can remove or
    reverse the saliency.
    """
    _, axes = np.linalg.eigh(rest.hessian)
    along, across = axes.T if abs(axes[0, 0]) > abs(axes[0, 1]) else axes.T[::-1]
    saliency = float(along @ rest.hessian @ along - across @ rest.hessian @ across)
    angles: dict[bool, list[float]] = {True: [], False: []}
    for ripple in torques:
        positive = bool(ripple.mean_current_dq @ across * np.sign(across[1]) > 0)
        angles[positive].append(float(ripple.hessian[0, 1] - rest.hessian[0, 1]) / saliency)
    plus, minus = (float(np.mean(angles[sign])) if angles[sign] else 0.0 for sign in (True, False))
    return 0.5 * (plus - minus) if angles[True] and angles[False] else plus - minus


def _within(value: float, std: float, tolerance: float) -> float:
    """Probability that a Gaussian quantity lies within +-tolerance."""
    if std <= 0.0:
        return float(abs(value) <= tolerance)
    scale = std * math.sqrt(2.0)
    return 0.5 * (math.erf((tolerance - value) / scale) + math.erf((tolerance + value) / scale))
