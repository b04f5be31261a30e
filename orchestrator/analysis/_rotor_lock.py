"""Whether the rotor is really locked, judged from the angle of its saliency at rest and under torque.

The principal axes of the Hessian turn with the rotor. Injection at zero, positive, zero, negative and zero torque
current shows by how much the rotor has turned between the rests (it slipped in its brake, or was never locked) and
how far it seems to give while the torque acts: cross-saturation turns the axes as well. Half a turn of the axes' angle
looks like none; a rotor that follows the current vector turns by a quarter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.analysis._ripple import Ripple, demodulate
from orchestrator.numerics.types import Array
from protocols import Capture, LockChecked, NotMeasuredError, Segment


@dataclass(frozen=True)
class _Direction:
    """Angle of something that turns with the rotor; angles a `turn` apart look alike."""

    angle: float
    std: float
    turn: float


def judge_lock(
    captures: Sequence[tuple[Segment, Capture]],
    tolerance_rad: float,
    *,
    voltage_delay_samples: float = 0.0,
    time_constant_s: float | None = None,
) -> LockChecked:
    """Judge from injection captures at rest and under torque whether the rotor turned.

    Parameters
    ----------
    captures : sequence of (Segment, Capture)
        In order of time, with currents of zero, plus, zero, minus, zero on the believed q axis. Which are which
        is told from the waveforms.
    tolerance_rad : float
        Largest lasting rotation (electrical) that counts as locked.
    voltage_delay_samples, time_constant_s : float
        As in `demodulate`.

    Raises
    ------
    NotMeasuredError
        Where there are fewer than two rests or no torque between them.

    Notes
    -----
    `locked` is None where the rotor is back at each rest, and under torque the inductances are what a rotor would show
    that follows the current, and what saturation by that current would show as well.
    """
    ripples = [
        demodulate(
            capture,
            segment.rotor_angle_rad,
            voltage_delay_samples=voltage_delay_samples,
            time_constant_s=time_constant_s,
            where=segment.id,
        )
        for segment, capture in captures
    ]
    length = np.array([float(np.linalg.norm(r.mean_current_dq)) for r in ripples])
    at_rest = length < 0.3 * length.max() if len(length) else np.zeros(0, dtype=bool)
    rests = [r for r, rest in zip(ripples, at_rest, strict=True) if rest]
    torques = [r for r, rest in zip(ripples, at_rest, strict=True) if not rest]
    if len(rests) < 2 or not torques:
        raise NotMeasuredError("lock_check", "segments", "needs injection at rest before and after one under torque")
    for direction_of in (_saliency_direction, _saturation_direction):
        directions = [direction_of(r) for r in rests]
        if all(d is not None for d in directions):
            torque = _under_torque(rests[0], torques) if direction_of is _saliency_direction else None
            return _verdict([d for d in directions if d is not None], torque, tolerance_rad)
    return _blind(tolerance_rad)


def _blind(tolerance_rad: float) -> LockChecked:
    # An angle that cannot be seen may be anything: all that is known is how much of a quarter turn is tolerated.
    return LockChecked(
        locked=True,
        confidence=min(tolerance_rad / (0.5 * math.pi), 1.0),
        moved_rad=0.0,
        moved_std_rad=0.5 * math.pi / math.sqrt(3.0),
        twist_rad=0.0,
        summary=(
            "cannot tell: the motor shows no saliency at rest, neither in its inductances nor in their saturation, "
            "so a rotation is invisible; nothing speaks against the lock, the brake has to be trusted"
        ),
    )


def _saliency_direction(ripple: Ripple) -> _Direction | None:
    """Axis of the smallest inductance; None where the motor is round within the noise."""
    h = ripple.hessian
    difference = np.array([h[0, 0] - h[1, 1], 2.0 * h[0, 1]])
    by_h = np.array([[1.0, 0.0, -1.0], [0.0, 2.0, 0.0]])
    return _direction(difference, by_h @ ripple.covariance[:3, :3] @ by_h.T, float(np.trace(h)), 2)


def _saturation_direction(ripple: Ripple) -> _Direction | None:
    """Direction in which the inductances fall: it follows the magnet even in a round motor."""
    size = float(np.trace(ripple.hessian)) / max(ripple.flux_rms_wb, 1e-12)
    return _direction(*_slope(ripple), size, 1)


def _slope(ripple: Ripple) -> tuple[Array, Array]:
    """Gradient of the Hessian's trace [A/Wb^2], shape (2,), and its covariance."""
    t = ripple.third
    by_t = np.array([[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]])
    return np.array([t[0] + t[2], t[1] + t[3]]), by_t @ ripple.covariance[3:, 3:] @ by_t.T


def _direction(
    vector: Array, covariance: Array, scale: float, order: int, sure: float = 5.0, sensors: float = 0.005
) -> _Direction | None:
    """Where a vector points; None unless it is `sure` standard deviations long and beyond what sensors differ by."""
    length = float(np.linalg.norm(vector))
    if length <= max(sure * math.sqrt(float(np.trace(covariance))), sensors * scale):
        return None
    across = np.array([-vector[1], vector[0]]) / length
    std = math.sqrt(float(across @ covariance @ across)) / length / order
    return _Direction(math.atan2(vector[1], vector[0]) / order, std, 2.0 * math.pi / order)


def _turned(later: _Direction, earlier: _Direction) -> tuple[float, float]:
    turn = math.remainder(later.angle - earlier.angle, earlier.turn)
    return turn, math.hypot(later.std, earlier.std)


@dataclass(frozen=True)
class _UnderTorque:
    lean: float
    """By how much the saliency at rest would have to turn for the coupling that is seen [rad]."""
    follows: bool | None
    """Whether the rotor goes where the current points; None: saturation would look the same."""

    def in_words(self, tolerance_rad: float) -> str:
        # A turn changes the coupling by half the saliency at most: what leans more is no turn.
        if abs(self.lean) > 0.5:
            return "cross-saturation under torque hides any twist"
        size = f"twist under torque {math.degrees(self.lean):+.2f} deg el."
        return size if abs(self.lean) <= tolerance_rad else f"apparent {size}: cross-saturation looks like it"


def _verdict(rests: list[_Direction], torque: _UnderTorque | None, tolerance_rad: float) -> LockChecked:
    moved, std = max((_turned(rest, rests[0]) for rest in rests[1:]), key=lambda turn: abs(turn[0]))
    confidence = _within(moved, std, tolerance_rad)
    # A measurement blunter than the tolerance convicts nobody: then only a rotation beyond its own error does.
    blunt = 2.0 * std > tolerance_rad and abs(moved) < 3.0 * std
    locked: bool | None = confidence > 0.5 or blunt
    words = "locked" if confidence > 0.5 else "the rotor moved"
    if blunt:
        words = "no movement seen, but the saliency is too weak to tell to within the tolerance"
    if torque is not None and torque.follows:
        words = "the saliency follows the current vector: the rotor is free"
        locked, confidence = False, min(confidence, 1e-6)
    elif torque is not None and torque.follows is None and locked:
        words = (
            "cannot tell: under torque this weak saliency is that of a rotor that follows the current and comes back, "
            "or of one that is held and saturates"
        )
        locked = None
    size = f"lasting rotation {math.degrees(moved):+.2f} +- {math.degrees(2 * std):.2f} deg el. (95 %)"
    seen = (
        torque.in_words(tolerance_rad)
        if torque is not None
        else "seen by the direction of saturation, as the motor shows no saliency"
    )
    return LockChecked(
        locked=locked,
        confidence=confidence,
        moved_rad=moved,
        moved_std_rad=std,
        twist_rad=torque.lean if torque is not None else 0.0,
        summary=f"{words}; {size}, tolerance {math.degrees(tolerance_rad):.2f} deg; {seen}",
    )


def _under_torque(rest: Ripple, torques: list[Ripple]) -> _UnderTorque:
    """How far the saliency leans under torque, and whether it goes where the current points.

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
    lean = 0.5 * (plus - minus) if turns[True] and turns[False] else plus - minus
    return _UnderTorque(lean, _follows(rest, torques, along, across))


def _follows(rest: Ripple, torques: list[Ripple], along: Array, across: Array) -> bool | None:
    """Whether the rotor went where the current points; None where saturation by that current would look the same.

    H is even about the rotor's d axis. In a rotor that lies along the current it falls and rises along the current
    only, while in one that is held the magnet's share of its slope stays on the believed d axis: that tells, where the
    magnet saturates the motor. Else the saliency has to: a rotor that followed shows its q axis across the current.
    But saturation by that current raises H on both axes, and so makes an axis with the less H look like the other;
    only an H that falls is none of it.
    """
    eighth = math.sqrt(0.5)  # cosine of the 45 degrees at which the saliency changes sides
    kept = _slope_kept(rest, torques, (along, across))
    if kept is not None and kept[0] > eighth:
        return False
    changes = [ripple.hessian - rest.hessian for ripple in torques]
    saliency = float(along @ rest.hessian @ along - across @ rest.hessian @ across)
    if not any(-float(along @ change @ along) / saliency > 0.5 for change in changes):
        return False
    falls = max(-float(axis @ change @ axis) for change in changes for axis in (along, across))
    if falls > 0.5 * abs(saliency) or (kept is not None and kept[1] < 0.5 * eighth):
        return True
    return None


def _slope_kept(rest: Ripple, torques: list[Ripple], axes: tuple[Array, Array]) -> tuple[float, float] | None:
    """The least and the most of the slope at rest that is left under torque, at 3 sigma; None where it is not seen.

    Along that of the principal axes on which the slope lies: they are known the better.
    """
    if _saturation_direction(rest) is None:
        return None
    slope, covariance = _slope(rest)
    axis = max(axes, key=lambda e: abs(float(slope @ e)))
    size = float(slope @ axis)
    left = []
    for ripple in torques:
        now, scatter = _slope(ripple)
        share = float(now @ axis) / size
        std = math.sqrt(float(axis @ (scatter + share**2 * covariance) @ axis)) / abs(size)
        left.append((share - 3.0 * std, share + 3.0 * std))
    return min(low for low, _ in left), max(high for _, high in left)


def _within(value: float, std: float, tolerance: float) -> float:
    """Probability that a Gaussian quantity lies within +-tolerance."""
    if std <= 0.0:
        return float(abs(value) <= tolerance)
    scale = std * math.sqrt(2.0)
    return 0.5 * (math.erf((tolerance - value) / scale) + math.erf((tolerance + value) / scale))
