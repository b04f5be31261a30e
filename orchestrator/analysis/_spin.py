"""The flux of a rotor that turns, by its back-EMF: one energy, the magnet, R_s, iron loss and the angle's offset.

    v = R_s i + e + w J psi(i_m),      i = i_m + g w J psi,      psi = (psi_M, 0) + grad W(i_m)

in means over whole turns at a steady current, J being a quarter turn ahead. A voltage that is held over a sample while
the rotor turns is shorter by sin(x)/x, x = w Ts / 2, and acts where the rotor is in the middle of it. W is even in i_q
about the true d axis; e is a phase's loss, by the sign of its current as it was measured, ripple and all, with a knee
that may be anywhere: about 4/pi of it along the current. R_s rises linearly in time as the winding warms. One fit gives
all; R_s and e need several speeds or a prior of R_s. The data determine the smoothness of W.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orchestrator.analysis._energy_fit import EnergyFit, energy_rows
from orchestrator.numerics.frames import from_phases, to_dq, to_phases
from orchestrator.numerics.reml import Solution, most_likely
from orchestrator.numerics.tensor_spline import EvenSpline
from orchestrator.numerics.types import Array
from protocols import Capture, NotMeasuredError, Segment

CELLS = (6, 6)
MIN_CURRENT_SHARE = 0.02
"""Share of the largest current below which the current counts as zero."""
KNEE_SHARES = (0.0, 0.04, 0.15)
"""Currents (of the largest) at which a phase's loss has its knee: it is a mixture of these."""
LOSS_SHARE, IRON_SHARE, TURN_RAD, WARM_SHARE = 0.02, 0.2, 0.2, 0.05
"""Standard deviations of what is believed: a phase's loss (of the largest voltage), the iron's current (of the largest
one), a turn of the axis, and by how much R_s changes from the first point to the last (of itself)."""


_OHM, _WARMER, _IRON, _TURN, _LOSS = range(5)


@dataclass(frozen=True)
class SpunPoints:
    """Means over whole turns, in the believed rotor frame.

    Attributes
    ----------
    i, v : array, shape (n, 2)
        Current [A], and the voltage that acted [V].
    speed : array, shape (n,)
        Electrical [rad/s].
    lost : array, shape (n, knees, 2)
        What a loss of one volt in each phase takes of the voltage, by its knee.
    time_s : array, shape (n,)
        Since the start of the experiment.
    """

    i: Array
    v: Array
    speed: Array
    lost: Array
    time_s: Array


def spun_points(
    capture: Capture,
    theta_rad: Array,
    *,
    delay: float | None,
    scale_a: float,
    where: str,
    turns: float = 2.0,
    steady: float = 0.03,
) -> SpunPoints:
    """Points of a capture in which the rotor turns.

    Parameters
    ----------
    theta_rad : array, shape (n,)
        Electrical angle of the believed d axis at each row.
    delay : float or None
        v[k] is held from t_k + `delay` Ts; None: it was measured at t_k, the bridge being off.
    scale_a : float
        The largest current of all.
    turns : float
        Whole turns that make a point.
    steady : float
        Change of current (of the largest) and speed within a point up to which it is one.

    Raises
    ------
    NotMeasuredError
        Where the rotor does not turn often enough, or nothing is steady.
    """
    step, angle = 1.0 / capture.sampling_frequency_hz, np.unwrap(np.asarray(theta_rad, dtype=np.float64))
    turned = abs(angle[-1] - angle[0]) / (2.0 * np.pi)
    count = int(turned / turns)
    if count < 1:
        raise NotMeasuredError(where, "theta_rad", f"the rotor makes {turned:.2g} turns: expected {turns:g} at least")
    speed = np.gradient(angle, step)
    smooth = np.convolve(speed, np.ones(5) / 5.0, mode="same") if len(speed) > 10 else speed
    smooth[:2], smooth[-2:] = speed[2], speed[-3]
    i, v = to_dq(capture.i_ab, angle), to_dq(capture.v_ab, angle)
    lost = np.zeros((len(i), len(KNEE_SHARES), 2))
    if delay is not None:
        lost = _lost(capture, angle + 0.5 * step * smooth, scale_a)
        v = to_dq(capture.v_ab, angle + smooth * step * (delay + 0.5)) * np.sinc(0.5 * smooth * step / np.pi)[:, None]
    edges = np.searchsorted(np.abs(angle - angle[0]), 2.0 * np.pi * turns * np.arange(count + 1))
    kept = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        middle = (first + last) // 2
        moved = np.linalg.norm(i[first:middle].mean(axis=0) - i[middle:last].mean(axis=0)) / scale_a
        mean = (angle[last] - angle[first]) / ((last - first) * step)
        faster = abs(smooth[first:middle].mean() - smooth[middle:last].mean()) / abs(mean)
        if max(moved, faster) < steady:
            kept.append([*(x[first:last].mean(axis=0) for x in (i, v, lost)), mean, capture.start_s + middle * step])
    if not kept:
        raise NotMeasuredError(where, "i_alpha, i_beta", "current and speed are steady over no two turns")
    means_i, means_v, means_lost, speeds, times = (np.array(x) for x in zip(*kept, strict=True))
    # A current that is noise has no direction.
    flows = np.linalg.norm(means_i, axis=1) > MIN_CURRENT_SHARE * scale_a
    return SpunPoints(means_i, means_v, speeds, means_lost * flows[:, None, None], times)


def _lost(capture: Capture, theta_rad: Array, scale_a: float) -> Array:
    """T tanh(i_abc / knee) in the rotor's frame, from sample to sample, shape (n, knees, 2)."""
    i = to_phases(np.asarray(capture.i_ab, dtype=np.float64))
    middle = 0.5 * (i + np.concatenate([i[1:], i[-1:]]))
    shapes = [np.tanh(middle / (knee * scale_a)) if knee else np.sign(middle) for knee in KNEE_SHARES]
    return np.stack([to_dq(from_phases(shape), theta_rad) for shape in shapes], axis=1)


def theta_of(segment: Segment, capture: Capture) -> Array:
    """Electrical angle of the believed d axis at each row of a rotor that turns, shape (n,).

    Raises
    ------
    NotMeasuredError
        Where it was not logged, and no speed is known.
    """
    if capture.theta_rad is not None:
        return np.asarray(capture.theta_rad, dtype=np.float64)
    speed = segment.settings.get("speed_rad_s")
    if isinstance(speed, bool) or not isinstance(speed, int | float):
        problem = "the rotor turns, and neither its angle (a column theta_rad) nor a setting speed_rad_s is there"
        raise NotMeasuredError(segment.id, "theta_rad", problem)
    time_s = np.arange(len(capture), dtype=np.float64) / capture.sampling_frequency_hz
    return np.asarray(segment.rotor_angle_rad + float(speed) * time_s)


def require_emf_turns_with(segment: Segment, capture: Capture) -> None:
    """Refuse a voltage that turns the other way than the rotor, or at another multiple of it.

    Raises
    ------
    NotMeasuredError
        In words: the phases' order, or the pole pairs; or what `theta_of` raises.
    """
    v = np.asarray(capture.v_ab, dtype=np.float64) @ [1.0, 1j]
    window = np.hanning(len(v))
    angle = np.unwrap(theta_of(segment, capture))
    ratios = [k / n for n in range(1, 9) for k in range(1, 9)]
    shares = {s * r: abs(np.vdot(np.exp(1j * s * r * angle) * window, v)) for r in sorted({*ratios}) for s in (1, -1)}
    best = max(shares, key=shares.__getitem__)
    if best == 1.0 or shares[best] < 3.0 * shares[1.0]:
        return
    if best < 0.0:
        problem = "the voltage turns the other way than the angle: phases in another order, or the angle's sign"
        raise NotMeasuredError(segment.id, "theta_rad", problem)
    problem = (
        f"the voltage turns {best:.4g} times as fast as the angle: {best:.4g} times the pole pairs that are believed?"
    )
    raise NotMeasuredError(segment.id, "motor.pole_pairs", problem)


@dataclass(frozen=True)
class SpinFit:
    """Results from a turning rotor; each number with its standard deviation.

    Attributes
    ----------
    energy : EnergyFit
        Of the flux without the magnet's.
    magnet_wb : (float, float)
    resistance_ohm : (float, float)
    angle_rad : (float, float)
        Of the true d axis from the believed one.
    conductance_s : (float, float)
        g, of the iron's loss.
    loss_v : (float, float)
        What each phase loses.
    left_wb : array, shape (n, 2)
        Residual flux at each point.
    """

    energy: EnergyFit
    magnet_wb: tuple[float, float]
    resistance_ohm: tuple[float, float]
    angle_rad: tuple[float, float]
    conductance_s: tuple[float, float]
    loss_v: tuple[float, float]
    left_wb: Array


def flux_by_emf(points: SpunPoints, resistance_ohm: float) -> Array:
    """psi_d = (v_q - R i_q) / w, psi_q = -(v_d - R i_d) / w, shape (n, 2) [Wb]."""
    return _behind(points.v - resistance_ohm * points.i) / points.speed[:, None]


def fit_spin(points: SpunPoints, resistance_ohm: tuple[float, float], rounds: int = 6) -> SpinFit:
    """Fit all points at once.

    Parameters
    ----------
    resistance_ohm : (float, float)
        What is known of R_s beforehand, and its standard deviation.
    """
    psi = flux_by_emf(points, resistance_ohm[0])
    size = np.full(2, 1e-2 * float(np.median(np.linalg.norm(psi, axis=1))))
    system = _System(points, resistance_ohm, magnet_axis(points, resistance_ohm[0]))
    solution = system.solved(size)
    for _ in range(rounds):
        # What iron loss and a turn of the axis do is known only where the flux is.
        system = system.informed(solution)
        solution = system.solved(size)
        size = system.left(solution)
    return system.finished(solution)


def magnet_axis(points: SpunPoints, resistance_ohm: float, small: float = 0.3) -> float:
    """Angle of the flux where little current flows, from the believed d axis; zero where much flows everywhere."""
    length = np.linalg.norm(points.i, axis=1)
    least = int(np.argmin(length))
    if length[least] > small * length.max():
        return 0.0
    d, q = flux_by_emf(points, resistance_ohm)[least]
    return float(np.arctan2(q, d))


@dataclass(frozen=True)
class _System:
    """The equations of all points, where the axis stands and as far as the flux is known."""

    points: SpunPoints
    known: tuple[float, float]
    angle_rad: float
    flux: tuple[Array, Array] | None = None
    """With the magnet's, (n, 2), and the inductances, (n, 3)."""

    @cached_property
    def spline(self) -> EvenSpline:
        own = to_dq(self.points.i, self.angle_rad)
        low, high = own.min(axis=0), own.max(axis=0)
        more = 0.06 * float((high - low).max())
        reach = float(np.abs(own[:, 1]).max())
        return EvenSpline(float(low[0]) - more, float(high[0]) + more, reach + more, CELLS)

    @property
    def free(self) -> int:
        """Modes of the energy that are free; its constant is none."""
        return self.spline.smooth - 1

    @property
    def own(self) -> slice:
        """The unknowns that are no modes of the energy."""
        return slice(self.free, self.free + _LOSS + len(KNEE_SHARES))

    def shape(self, at: Array, order: int = 1) -> Array:
        """Derivatives of the energy's modes at believed currents, shape (n, order + 1, modes)."""
        return np.asarray(energy_rows(self.spline, at, self.angle_rad, order) @ self.spline.modes[:, 1:])

    @cached_property
    def rows(self) -> Array:
        """What each unknown does to each flux, shape (n, 2, unknowns)."""
        shape = self.shape(self.points.i)
        return np.concatenate([shape[:, :, : self.free], self._own(), shape[:, :, self.free :]], axis=2)

    def _own(self) -> Array:
        """Columns of R_s, of its rise, of the iron's conductance, of a turn of the axis, and of a loss by its knees."""
        p = self.points
        out = np.zeros((len(p.i), 2, _LOSS + len(KNEE_SHARES)))
        over = 1.0 / p.speed[:, None]
        out[:, :, _OHM] = _behind(p.i) * over
        late = p.time_s - p.time_s.mean()
        out[:, :, _WARMER] = out[:, :, _OHM] * (late / max(float(np.ptp(late)), 1e-9))[:, None]
        for number in range(len(KNEE_SHARES)):
            out[:, :, _LOSS + number] = _behind(p.lost[:, number]) * over
        if self.flux is not None:
            psi, inductance = self.flux
            matrix = inductance[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
            ahead = -_behind(psi)
            out[:, :, _IRON] = -np.einsum("nij,nj->ni", matrix, ahead) * p.speed[:, None]
            out[:, :, _TURN] = ahead - np.einsum("nij,nj->ni", matrix, -_behind(p.i))
        return out

    @cached_property
    def _std(self) -> Array:
        """Of what is believed of each of these."""
        p = self.points
        emf = float(np.linalg.norm(p.v, axis=1).max())
        iron = IRON_SHARE * float(np.abs(p.i).max()) / emf
        warmer = WARM_SHARE * self.known[0]
        return np.array([self.known[1], warmer, iron, TURN_RAD, *[LOSS_SHARE * emf] * len(KNEE_SHARES)])

    def solved(self, size: Array) -> Solution:
        """What is most likely where so much is left of each axis, shape (2,)."""
        own = self.own
        prior = np.zeros((len(self._std), self.rows.shape[2]))
        prior[:, own] = np.diag(1.0 / self._std)
        expected = np.where(np.arange(len(self._std)) == _OHM, self.known[0], 0.0) / self._std
        target = flux_by_emf(self.points, 0.0)
        rows = (self.rows / size[None, :, None]).reshape(-1, self.rows.shape[2])
        data = np.concatenate([(target / size).ravel(), expected])
        return most_likely(np.concatenate([rows, prior]), data, own.stop)

    def left(self, solution: Solution, resolved: float = 1e-4) -> Array:
        """rms of what is left, shape (2,), as far as there are more points than unknowns."""
        off = self.residual(solution)
        count = max(len(off) - 0.5 * solution.modes.size, 0.3 * len(off))
        least = resolved * float(np.abs(flux_by_emf(self.points, 0.0)).max())
        return np.asarray(np.maximum(np.sqrt((off**2).sum(axis=0) / count), least))

    def residual(self, solution: Solution) -> Array:
        """Shape (n, 2) [Wb]."""
        return np.asarray(flux_by_emf(self.points, 0.0) - self.rows @ solution.modes)

    def informed(self, solution: Solution) -> _System:
        """The same with the axis where it was found, and the flux there."""
        modes = np.delete(solution.modes, self.own)
        psi, inductance = self.shape(self.points.i) @ modes, self.shape(self.points.i, 2) @ modes
        turn = float(solution.modes[self.free + _TURN])
        return _System(self.points, self.known, self.angle_rad + turn, (psi, inductance))

    def finished(self, solution: Solution) -> SpinFit:
        """The answer as numbers with their deviations."""
        value, std = solution.modes[self.own].tolist(), np.linalg.norm(solution.root[self.own], axis=1).tolist()
        losses = slice(self.free + _LOSS, self.own.stop)
        loss = float(solution.modes[losses].sum()), float(np.linalg.norm(solution.root[losses].sum(axis=0)))
        modes, root = (np.delete(x, self.own, axis=0) for x in (solution.modes, solution.root))
        axis = np.array([np.cos(self.angle_rad), np.sin(self.angle_rad)])
        at_zero = axis @ self.shape(np.zeros((1, 2)))[0]
        space = self.spline.modes[:, 1:]
        fit = EnergyFit(
            spline=self.spline,
            angle_rad=self.angle_rad,
            coefficients=space @ modes,
            covariance=(space @ root) @ (space @ root).T,
        )
        return SpinFit(
            energy=fit,
            magnet_wb=(float(at_zero @ modes), float(np.linalg.norm(at_zero @ root))),
            resistance_ohm=(value[_OHM], std[_OHM]),
            loss_v=loss,
            conductance_s=(value[_IRON], std[_IRON]),
            angle_rad=(self.angle_rad + value[_TURN], std[_TURN]),
            left_wb=self.residual(solution),
        )


def _behind(x: Array) -> Array:
    """Vectors turned back by a quarter, shape (n, 2)."""
    return np.column_stack([x[:, 1], -x[:, 0]])
