"""The flux of a rotor that turns, by its back-EMF: one energy, the magnet, R_s, iron loss and the angle's offset.

    v = R_s i + e + w J psi(i_m),      i = i_m + g w J psi,      psi = (psi_M, 0) + grad W(i_m)

in means over whole turns at a steady current; J rotates by +90 degrees. A voltage held over a sample while the rotor
turns is shorter by sin(x)/x, x = w Ts / 2, at the rotor's angle in the middle of the sample. W is even in i_q about the
true d axis; e is the inverter's error by the sign of each measured phase current, a mixture of knees: about 4/pi of a
phase's error lies along the current. R_s rises linearly in time as the winding warms. One fit gives all unknowns; R_s
and e need several speeds or a prior of R_s. The data determine the smoothness of W.
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
"""Knees of the inverter's error, as shares of the largest current: the error is a mixture of these."""
LOSS_SHARE, IRON_SHARE, TURN_RAD, WARM_SHARE = 0.02, 0.2, 0.2, 0.05
"""Prior standard deviations: inverter error (of the largest voltage), iron-loss current (of the largest current),
rotation of the axis, relative change of R_s from the first point to the last."""
_OHM, _WARMER, _IRON, _TURN, _LOSS = range(5)
"""Columns of the unknowns that are no modes of the energy."""


@dataclass(frozen=True)
class SpunPoints:
    """Means over whole turns, in the believed rotor frame.

    Attributes
    ----------
    i, v : array, shape (n, 2)
        Current [A], and the voltage that acted [V].
    speed : array, shape (n,)
        Electrical [rad/s].
    loss : array, shape (n, knees, 2)
        Voltage per volt of inverter error in each phase, for each knee.
    time_s : array, shape (n,)
        Since the start of the experiment.
    """

    i: Array
    v: Array
    speed: Array
    loss: Array
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
    """Mean points over whole turns of a capture in which the rotor turns.

    Parameters
    ----------
    theta_rad : array, shape (n,)
        Electrical angle of the believed d axis at each row.
    delay : float or None
        v[k] is held from t_k + `delay` Ts; None: it was measured at t_k with the bridge off.
    scale_a : float
        Largest current of all captures.
    turns : float
        Electrical turns per point.
    steady : float
        Maximum change of current (of the largest) and speed (relative) within a point.

    Raises
    ------
    NotMeasuredError
        Where the rotor makes too few turns, or no point is steady.
    """
    step, angle = 1.0 / capture.sampling_frequency_hz, np.unwrap(np.asarray(theta_rad, dtype=np.float64))
    made = abs(angle[-1] - angle[0]) / (2.0 * np.pi)
    count = int(made / turns)
    if count < 1:
        raise NotMeasuredError(where, "theta_rad", f"the rotor makes {made:.2g} turns: expected {turns:g} at least")
    speed = np.gradient(angle, step)
    smooth = np.convolve(speed, np.ones(5) / 5.0, mode="same") if len(speed) > 10 else speed
    smooth[:2], smooth[-2:] = speed[2], speed[-3]
    i, v = to_dq(capture.i_ab, angle), to_dq(capture.v_ab, angle)
    loss = np.zeros((len(i), len(KNEE_SHARES), 2))
    if delay is not None:
        loss = _unit_losses(capture, angle + 0.5 * step * smooth, scale_a)
        v = to_dq(capture.v_ab, angle + smooth * step * (delay + 0.5)) * np.sinc(0.5 * smooth * step / np.pi)[:, None]
    limits = np.searchsorted(np.abs(angle - angle[0]), 2.0 * np.pi * turns * np.arange(count + 1))
    points = []
    for first, last in zip(limits[:-1].tolist(), limits[1:].tolist(), strict=True):
        middle = (first + last) // 2
        current_change = np.linalg.norm(i[first:middle].mean(axis=0) - i[middle:last].mean(axis=0)) / scale_a
        mean = (angle[last] - angle[first]) / ((last - first) * step)
        speed_change = abs(smooth[first:middle].mean() - smooth[middle:last].mean()) / abs(mean)
        if max(current_change, speed_change) < steady:
            points.append([*(x[first:last].mean(axis=0) for x in (i, v, loss)), mean, capture.start_s + middle * step])
    if not points:
        raise NotMeasuredError(where, "i_alpha, i_beta", "current and speed are nowhere steady over two turns")
    means_i, means_v, means_loss, speeds, times = (np.array(x) for x in zip(*points, strict=True))
    # Noise alone has no direction: no inverter error below the smallest current.
    flows = np.linalg.norm(means_i, axis=1) > MIN_CURRENT_SHARE * scale_a
    return SpunPoints(means_i, means_v, speeds, means_loss * flows[:, None, None], times)


def _unit_losses(capture: Capture, theta_rad: Array, scale_a: float) -> Array:
    """T tanh(i_abc / knee) in the rotor's frame, between samples, shape (n, knees, 2)."""
    i = to_phases(np.asarray(capture.i_ab, dtype=np.float64))
    middle = 0.5 * (i + np.concatenate([i[1:], i[-1:]]))
    shapes = [np.tanh(middle / (knee * scale_a)) if knee else np.sign(middle) for knee in KNEE_SHARES]
    return np.stack([to_dq(from_phases(shape), theta_rad) for shape in shapes], axis=1)


def rotor_angles_rad(segment: Segment, capture: Capture) -> Array:
    """Electrical angle of the believed d axis at each row of a rotor that turns, shape (n,).

    Raises
    ------
    NotMeasuredError
        Where neither the angle was logged nor a speed is set.
    """
    if capture.theta_rad is not None:
        return np.asarray(capture.theta_rad, dtype=np.float64)
    speed = segment.settings.get("speed_rad_s")
    if isinstance(speed, bool) or not isinstance(speed, int | float):
        problem = "the rotor turns: expected its angle (a column theta_rad) or a setting speed_rad_s"
        raise NotMeasuredError(segment.id, "theta_rad", problem)
    time_s = np.arange(len(capture), dtype=np.float64) / capture.sampling_frequency_hz
    return np.asarray(segment.rotor_angle_rad + float(speed) * time_s)


def require_emf_follows_angle(segment: Segment, capture: Capture) -> None:
    """Refuse a voltage that rotates against the rotor, or at a multiple of its speed.

    Raises
    ------
    NotMeasuredError
        Names the likely cause, phase order or pole pairs; or as `rotor_angles_rad` raises.
    """
    v = np.asarray(capture.v_ab, dtype=np.float64) @ [1.0, 1j]
    window = np.hanning(len(v))
    angle = np.unwrap(rotor_angles_rad(segment, capture))
    ratios = [k / n for n in range(1, 9) for k in range(1, 9)]
    shares = {s * r: abs(np.vdot(np.exp(1j * s * r * angle) * window, v)) for r in sorted({*ratios}) for s in (1, -1)}
    best = max(shares, key=shares.__getitem__)
    if best == 1.0 or shares[best] < 3.0 * shares[1.0]:
        return
    if best < 0.0:
        problem = "the voltage rotates against the angle: is the phase order wrong, or the angle's sign?"
        raise NotMeasuredError(segment.id, "theta_rad", problem)
    problem = (
        f"the voltage rotates {best:.4g} times as fast as the angle: are there {best:.4g} times as many pole pairs?"
    )
    raise NotMeasuredError(segment.id, "motor.pole_pairs", problem)


@dataclass(frozen=True)
class SpinFit:
    """Results from a turning rotor; each number with its standard deviation.

    Attributes
    ----------
    energy : EnergyFit
        Energy of the flux without the magnet's.
    magnet_wb : (float, float)
    resistance_ohm : (float, float)
    angle_rad : (float, float)
        Angle of the true d axis from the believed one.
    conductance_s : (float, float)
        Iron-loss conductance g.
    loss_v : (float, float)
        Inverter voltage error of each phase.
    residual_wb : array, shape (n, 2)
        Residual flux at each point.
    """

    energy: EnergyFit
    magnet_wb: tuple[float, float]
    resistance_ohm: tuple[float, float]
    angle_rad: tuple[float, float]
    conductance_s: tuple[float, float]
    loss_v: tuple[float, float]
    residual_wb: Array


def flux_by_emf(points: SpunPoints, resistance_ohm: float) -> Array:
    """psi_d = (v_q - R i_q) / w, psi_q = -(v_d - R i_d) / w, shape (n, 2) [Wb]."""
    return _quarter_turn_back(points.v - resistance_ohm * points.i) / points.speed[:, None]


def fit_spin(points: SpunPoints, resistance_ohm: tuple[float, float], rounds: int = 6) -> SpinFit:
    """Fit all points at once.

    Parameters
    ----------
    resistance_ohm : (float, float)
        Prior mean of R_s and its standard deviation.
    """
    psi = flux_by_emf(points, resistance_ohm[0])
    size = np.full(2, 1e-2 * float(np.median(np.linalg.norm(psi, axis=1))))
    system = _System(points, resistance_ohm, magnet_axis(points, resistance_ohm[0]))
    solution = system.solved(size)
    for _ in range(rounds):
        # The effects of iron loss and of the axis angle need the flux of the previous round.
        system = system.relinearised(solution)
        solution = system.solved(size)
        size = system.residual_rms(solution)
    return system.finished(solution)


def magnet_axis(points: SpunPoints, resistance_ohm: float, small: float = 0.3) -> float:
    """Angle of the flux at the smallest current from the believed d axis; zero where no current is small."""
    length = np.linalg.norm(points.i, axis=1)
    smallest = int(np.argmin(length))
    if length[smallest] > small * length.max():
        return 0.0
    d, q = flux_by_emf(points, resistance_ohm)[smallest]
    return float(np.arctan2(q, d))


@dataclass(frozen=True)
class _System:
    """The equations of all points, linearised at an axis angle and a flux."""

    points: SpunPoints
    prior_ohm: tuple[float, float]
    angle_rad: float
    flux: tuple[Array, Array] | None = None
    """Flux with the magnet's, (n, 2), and inductances, (n, 3), of the previous round."""

    @cached_property
    def spline(self) -> EvenSpline:
        current = to_dq(self.points.i, self.angle_rad)
        low, high = current.min(axis=0), current.max(axis=0)
        margin = 0.06 * float((high - low).max())
        reach = float(np.abs(current[:, 1]).max())
        return EvenSpline(float(low[0]) - margin, float(high[0]) + margin, reach + margin, CELLS)

    @property
    def free(self) -> int:
        """Number of unpenalised modes of the energy, without its constant."""
        return self.spline.smooth - 1

    @property
    def other_columns(self) -> slice:
        """Columns of the unknowns that are no modes of the energy."""
        return slice(self.free, self.free + _LOSS + len(KNEE_SHARES))

    def shape(self, at: Array, order: int = 1) -> Array:
        """Derivatives of the energy's modes at believed currents, shape (n, order + 1, modes)."""
        return np.asarray(energy_rows(self.spline, at, self.angle_rad, order) @ self.spline.modes[:, 1:])

    @cached_property
    def rows(self) -> Array:
        """Derivative of the flux by each unknown, shape (n, 2, unknowns)."""
        shape = self.shape(self.points.i)
        return np.concatenate([shape[:, :, : self.free], self._other_columns(), shape[:, :, self.free :]], axis=2)

    def _other_columns(self) -> Array:
        """Columns of R_s, its rise, the iron-loss conductance, the axis angle and the inverter error at each knee."""
        p = self.points
        out = np.zeros((len(p.i), 2, _LOSS + len(KNEE_SHARES)))
        over = 1.0 / p.speed[:, None]
        out[:, :, _OHM] = _quarter_turn_back(p.i) * over
        time_s = p.time_s - p.time_s.mean()
        out[:, :, _WARMER] = out[:, :, _OHM] * (time_s / max(float(np.ptp(time_s)), 1e-9))[:, None]
        for number in range(len(KNEE_SHARES)):
            out[:, :, _LOSS + number] = _quarter_turn_back(p.loss[:, number]) * over
        if self.flux is not None:
            psi, inductance = self.flux
            matrix = inductance[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
            ahead = -_quarter_turn_back(psi)
            out[:, :, _IRON] = -np.einsum("nij,nj->ni", matrix, ahead) * p.speed[:, None]
            out[:, :, _TURN] = ahead - np.einsum("nij,nj->ni", matrix, -_quarter_turn_back(p.i))
        return out

    @cached_property
    def _std(self) -> Array:
        """Prior standard deviations of these unknowns."""
        p = self.points
        emf = float(np.linalg.norm(p.v, axis=1).max())
        iron = IRON_SHARE * float(np.abs(p.i).max()) / emf
        warmer = WARM_SHARE * self.prior_ohm[0]
        return np.array([self.prior_ohm[1], warmer, iron, TURN_RAD, *[LOSS_SHARE * emf] * len(KNEE_SHARES)])

    def solved(self, size: Array) -> Solution:
        """Most likely solution for these rms residuals of the axes, shape (2,) [Wb]."""
        columns = self.other_columns
        prior = np.zeros((len(self._std), self.rows.shape[2]))
        prior[:, columns] = np.diag(1.0 / self._std)
        expected = np.where(np.arange(len(self._std)) == _OHM, self.prior_ohm[0], 0.0) / self._std
        target = flux_by_emf(self.points, 0.0)
        rows = (self.rows / size[None, :, None]).reshape(-1, self.rows.shape[2])
        data = np.concatenate([(target / size).ravel(), expected])
        return most_likely(np.concatenate([rows, prior]), data, columns.stop)

    def residual_rms(self, solution: Solution, resolved: float = 1e-4) -> Array:
        """rms residual, shape (2,) [Wb], corrected for the degrees of freedom."""
        off = self.residual(solution)
        count = max(len(off) - 0.5 * solution.coefficients.size, 0.3 * len(off))
        floor = resolved * float(np.abs(flux_by_emf(self.points, 0.0)).max())
        return np.asarray(np.maximum(np.sqrt((off**2).sum(axis=0) / count), floor))

    def residual(self, solution: Solution) -> Array:
        """Flux residual, shape (n, 2) [Wb]."""
        return np.asarray(flux_by_emf(self.points, 0.0) - self.rows @ solution.coefficients)

    def relinearised(self, solution: Solution) -> _System:
        """The system linearised at the fitted axis angle and flux."""
        modes = np.delete(solution.coefficients, self.other_columns)
        psi, inductance = self.shape(self.points.i) @ modes, self.shape(self.points.i, 2) @ modes
        turn = float(solution.coefficients[self.free + _TURN])
        return _System(self.points, self.prior_ohm, self.angle_rad + turn, (psi, inductance))

    def finished(self, solution: Solution) -> SpinFit:
        """The result with standard deviations."""
        columns = self.other_columns
        value, std = solution.coefficients[columns].tolist(), np.linalg.norm(solution.root[columns], axis=1).tolist()
        losses = slice(self.free + _LOSS, columns.stop)
        loss = float(solution.coefficients[losses].sum()), float(np.linalg.norm(solution.root[losses].sum(axis=0)))
        modes, root = (np.delete(x, columns, axis=0) for x in (solution.coefficients, solution.root))
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
            residual_wb=self.residual(solution),
        )


def _quarter_turn_back(x: Array) -> Array:
    """Vectors rotated by -90 degrees, shape (n, 2)."""
    return np.column_stack([x[:, 1], -x[:, 0]])
