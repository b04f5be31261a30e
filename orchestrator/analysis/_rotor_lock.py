"""Check that the rotor is locked, by the angle of its saliency at rest and under torque.

The principal axes of the Hessian turn with the rotor. Injection at rest, under positive torque, at rest, under negative
torque and at rest shows by how much the rotor has turned between the rests (it slipped in its brake, or was never
locked) and how far it seems to give while the torque acts: cross-saturation turns the axes as well. Half a turn of the
axes' angle looks like none; a rotor that follows the current vector turns by as much as that.
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
    at_current,
    inverter_loss_v,
    rotation,
    saliency_direction,
    saliency_gain,
    saturation_direction,
    saturation_gain,
    zero_share,
)
from orchestrator.analysis._rotor_follows import follows
from orchestrator.numerics.frames import to_dq
from protocols import Capture, LockChecked, NotMeasuredError, Segment

MIN_LOCK_PROBABILITY = 0.95
"""Probability of a rotation within the tolerance from which on a rotor counts as locked."""
NAMEPLATE_SHARE = 0.9
"""Of a current that follows from the nameplate's flux and inductances, which hold to some percent."""
MOVEMENT_SIGMAS = 3.0
"""Standard deviations of a rotation beyond the tolerance from which on the rotor counts as moved."""
DECIDING_SIGMAS = 4.5
"""Standard deviations in the tolerance with which a rotor that is held is found locked 99 times of 100."""


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
        In order of time, with currents of zero, plus, zero, minus, zero on the believed q axis, and one current (or
        none) on its d axis. Which are which is found from the waveforms.
    tolerance_rad : float
        Largest lasting rotation (electrical) that counts as locked.
    voltage_delay_samples, time_constant_s : float
        As in `demodulate`.
    aligning_current_a : float
        From there on L_q - L_d outweighs the magnet, and a free rotor does not rest with its d axis on the current [A].

    Raises
    ------
    NotMeasuredError
        Where there are fewer than two rests or no torque between them.

    Notes
    -----
    `locked` is None where the rotation is not known well enough, or where the rotor is back at each rest, and under
    torque the inductances are what a rotor would show that follows the current, and what saturation by that current
    would show as well.
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
    ripples = [at_current(point.ripple, first.current_dq) for point in rests]
    salient = [saliency_direction(r, p.zero_share, loss_v) for r, p in zip(ripples, rests, strict=True)]
    free = follows(first, torques, tolerance_rad)
    most_a = max(float(np.linalg.norm(ripple.mean_current_dq)) for ripple in torques)
    if free is False and most_a > NAMEPLATE_SHARE * aligning_current_a and abs(_lean(first, torques)) > tolerance_rad:
        # Symmetry then hides the rotation, and a rotor that the current at rest brings back shows no other sign.
        free = None if float(np.linalg.norm(first.mean_current_dq)) > 0.1 * most_a else free
    by_saliency = [direction for direction in salient if direction is not None]
    if len(by_saliency) == len(rests) and _turns_with_rotor(gain := saliency_gain(ripples)):
        inverter = _Inverter(loss_v, first.amplitude_v, max(point.zero_share for point in rests))
        return _verdict(by_saliency, gain, free, tolerance_rad, inverter, _Twist(_lean(first, torques)))
    by_saturation = [direction for direction in map(saturation_direction, ripples) if direction is not None]
    if len(by_saturation) == len(rests) and _turns_with_rotor(gain := saturation_gain(first, torques)):
        return _verdict(by_saturation, gain, free, tolerance_rad)
    reason = (
        "the motor shows no saliency at rest, neither in its inductances nor in their saturation, that turns with it"
    )
    return _unknown(tolerance_rad, f"{reason}, so a rotation is invisible")


def lock_duration_ratio(
    segment: Segment, capture: Capture, tolerance_rad: float, *, voltage_delay_samples: float = 0.0
) -> float:
    """How many times as long as this capture those of a lock check have to be for its noise to leave no doubt.

    Parameters
    ----------
    segment, capture : Segment, Capture
        Injection at rest, before any torque: noise of the rest that later ones are compared with cannot be made up for.
    tolerance_rad : float
        Largest lasting rotation (electrical) that counts as locked.
    voltage_delay_samples : float
        As in `demodulate`.

    Notes
    -----
    Noise falls with the root of the time. Below 1 where this capture is longer than it need be; 1 where it shows no
    direction, so that nobody knows what a longer one would show.
    """
    try:
        ripple = demodulate(
            capture, segment.rotor_angle_rad, voltage_delay_samples=voltage_delay_samples, where=segment.id
        )
    except NotMeasuredError:
        return 1.0
    saliency, saturation, gain = saliency_direction(ripple), saturation_direction(ripple), saliency_gain([ripple])
    turns = saliency is not None and _turns_with_rotor(gain)
    direction = saliency if turns else saturation or saliency
    if direction is None:
        return 1.0
    std = math.sqrt(2.0) * direction.std  # between two rests
    return _duration_ratio(std / abs(gain[0]) if turns else std, tolerance_rad)


def _duration_ratio(std_rad: float, tolerance_rad: float) -> float:
    """How many times as long a capture has to be for a rotation of this standard deviation to be decided."""
    return (DECIDING_SIGMAS * std_rad / tolerance_rad) ** 2


def _turns_with_rotor(gain: tuple[float, float]) -> bool:
    """Whether a direction is the rotor's, and not that of the current which saturates the iron."""
    return abs(gain[0]) > MOVEMENT_SIGMAS * gain[1]


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
    # An angle that cannot be seen may be anything: all that is known is how much of a quarter turn is tolerated.
    return LockChecked(
        locked=None,
        confidence=min(tolerance_rad / (0.5 * math.pi), 1.0),
        moved_rad=0.0,
        moved_std_rad=0.5 * math.pi / math.sqrt(3.0),
        twist_rad=0.0,
        summary=f"cannot tell: {reason}; nothing speaks against the lock, the brake has to be trusted",
    )


@dataclass(frozen=True)
class _Inverter:
    """What the inverter loses while phase currents pass zero at rest."""

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
    """By how much the saliency at rest would have to turn for the coupling that is seen under torque [rad]."""

    lean: float

    def describe(self, tolerance_rad: float) -> str:
        # A turn changes the coupling by half the saliency at most: what leans more is no turn.
        if abs(self.lean) > 0.5:
            return "cross-saturation under torque hides any twist"
        size = f"twist under torque {math.degrees(self.lean):+.2f} deg el."
        return size if abs(self.lean) <= tolerance_rad else f"apparent {size}: cross-saturation looks like it"


def _verdict(
    rests: Sequence[Direction],
    gain: tuple[float, float],
    free: bool | None,
    tolerance_rad: float,
    inverter: _Inverter | None = None,
    twist: _Twist | None = None,
) -> LockChecked:
    turns = [rotation(rest, rests[0], gain) for rest in rests[1:]]
    moved, std, by_inverter = max(turns, key=lambda turn: abs(turn[0]))
    confidence = min(_within(turn, sigma, tolerance_rad) for turn, sigma, _ in turns)
    has_moved = any(abs(turn) > max(tolerance_rad, MOVEMENT_SIGMAS * sigma) for turn, sigma, _ in turns)
    locked: bool | None = confidence >= MIN_LOCK_PROBABILITY
    words = "locked"
    if free:
        words = "the saliency follows the current vector: the rotor is free"
        locked, confidence = False, min(confidence, 1e-6)
    elif has_moved:
        words, locked = "the rotor moved", False
    elif not locked:
        words, locked = "cannot tell: the rotation is not known to within the tolerance", None
        if by_inverter > 0.5 * std and inverter is not None:
            words += f": {inverter.describe(by_inverter)}"
        else:
            longer = max(2.0, _duration_ratio(std, tolerance_rad))
            words += f": a duration_s {longer:.2g} times as long would tell"
    elif free is None:
        words = (
            "cannot tell: under torque this saliency is that of a rotor that follows the current and comes back, "
            "or of one that is held and saturates; a smaller torque_current_a may tell"
        )
        locked = None
    size = f"lasting rotation {math.degrees(moved):+.2f} +- {math.degrees(2 * std):.2f} deg el. (95 %)"
    seen = (
        twist.describe(tolerance_rad)
        if twist is not None
        else "seen by the direction of saturation, as the motor shows no saliency"
    )
    return LockChecked(
        locked=locked,
        confidence=confidence,
        moved_rad=moved,
        moved_std_rad=std,
        twist_rad=twist.lean if twist is not None else 0.0,
        summary=f"{words}; {size}, tolerance {math.degrees(tolerance_rad):.2f} deg; {seen}",
    )


def _lean(rest: Ripple, torques: Sequence[Ripple]) -> float:
    """How far the saliency leans under torque [rad].

    The angle is the one by which the saliency at rest would have to turn to give the coupling H_12 seen under torque,
    half the difference between both signs; the principal axes themselves do not serve, since saturation can make the
    motor round, or salient the other way, at full current.
    """
    _, axes = np.linalg.eigh(rest.hessian)
    along, across = axes.T if abs(axes[0, 0]) > abs(axes[0, 1]) else axes.T[::-1]
    saliency = float(along @ rest.hessian @ along - across @ rest.hessian @ across)
    turns: dict[bool, list[float]] = {True: [], False: []}
    for ripple in torques:
        positive = bool(ripple.mean_current_dq @ across * np.sign(across[1]) > 0)
        turns[positive].append(float(ripple.hessian[0, 1] - rest.hessian[0, 1]) / saliency)
    plus, minus = (float(np.mean(turns[way])) if turns[way] else 0.0 for way in (True, False))
    return 0.5 * (plus - minus) if turns[True] and turns[False] else plus - minus


def _within(value: float, std: float, tolerance: float) -> float:
    """Probability that a Gaussian quantity lies within +-tolerance."""
    if std <= 0.0:
        return float(abs(value) <= tolerance)
    scale = std * math.sqrt(2.0)
    return 0.5 * (math.erf((tolerance - value) / scale) + math.erf((tolerance + value) / scale))
