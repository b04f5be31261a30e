"""Choose the injection point with the most information about the flux map per second: sequential I-optimal design.

The energy is linear in its modes, so a point's effect on the map's covariance is known before the measurement
(V. V. Fedorov, "Theory of Optimal Experiments", Academic Press 1972). With S the covariance of the modes, A their
effect on a point's inductances, in standard deviations, and N that on the flux at the nodes of a plane of currents,

    S' = S - S A' (1 + A S A')^-1 A S,        gain = sum_n w_n tr N_n (S - S') N_n' / seconds,

each node weighted by its own variance. A longer capture has less noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from orchestrator.analysis._captures import each_capture
from orchestrator.analysis._energy_fit import EnergyFit, EnergyProblem, energy_rows, finished, pose
from orchestrator.analysis._energy_search import behind_dead_time
from orchestrator.analysis._integration import PAIRS, TRIPLES, Inductances, invert
from orchestrator.analysis._ripple import Ripple, demodulate
from orchestrator.numerics.types import Array
from protocols import Capture, NotMeasuredError, RecordingReader, Segment

_NORMAL_95 = 1.96
_CELLS = (8, 8)
"""Intervals of the spline during the measurement: fine enough for the error band, and fast."""
_RINGS = 5
"""Number of rings of nodes in the current plane."""
_MIN_POINTS = 6
"""Smallest number of points that determines the energy's smoothness."""


@dataclass(frozen=True)
class Candidate:
    """A candidate injection point.

    Attributes
    ----------
    current_a : (float, float)
        (i_d, i_q).
    capture_s, seconds : float
        Duration of the capture alone, and of motor time with settling.
    """

    current_a: tuple[float, float]
    capture_s: float
    seconds: float


@dataclass(frozen=True)
class KnownMap:
    """Knowledge of the map from the injections so far.

    Attributes
    ----------
    fit : EnergyFit
    root : array, shape (k, r)
        Root of the covariance of the modes (energy and measurement errors).
    problem : EnergyProblem
        With the estimated sizes of the errors.
    noise : array, shape (n, 7, 7)
        Covariance of each point's inductances and slopes, times its capture's length.
    reach : array, shape (m, 2, k)
        Flux of each mode at the nodes of the target plane.
    """

    fit: EnergyFit
    root: Array
    problem: EnergyProblem
    noise: Array
    reach: Array

    @property
    def band_wb(self) -> tuple[float, float]:
        """Half width of the flux vector's 95 % band over the plane: rms and maximum [Wb]."""
        variance = _variance(self.reach @ self.root)
        return _NORMAL_95 * float(np.sqrt(variance.mean())), _NORMAL_95 * float(np.sqrt(variance.max()))

    def flux_wb(self, current_a: tuple[float, float]) -> float:
        """Length of psi(i) - psi(0) [Wb]."""
        return float(np.linalg.norm(self.fit.flux(np.array([current_a]))[0]))

    def best(self, candidates: Sequence[Candidate], count: int) -> list[Candidate]:
        """The best `count` candidates, each chosen as if the ones before it were measured; ties go to the first."""
        return [candidates[index] for index, _ in islice(self._greedy(candidates), count)]

    def seconds_to(self, target_wb: float, candidates: Sequence[Candidate], max_s: float) -> float:
        """Expected motor time until the band's maximum is below a target, at most `max_s` [s]."""
        spent = 0.0
        for index, worst_wb in self._greedy(candidates):
            spent += candidates[index].seconds
            if worst_wb <= target_wb or spent >= max_s:
                break
        return min(spent, max_s)

    def _greedy(self, candidates: Sequence[Candidate]) -> Iterator[tuple[int, float]]:
        """Endless: index of the best candidate, and the band's maximum once it is measured [Wb]."""
        rows, root = self._rows(candidates), self.root
        seconds = np.array([candidate.seconds for candidate in candidates])
        while True:
            best = int(np.argmax(_gains(rows @ root, self.reach @ root) / seconds))
            root = _root_after(root, rows[best])
            yield best, _NORMAL_95 * float(np.sqrt(_variance(self.reach @ root).max()))

    def _rows(self, candidates: Sequence[Candidate]) -> Array:
        """Effect of each mode on the candidates' measurements, in their standard deviations, shape (c, 7, k)."""
        assert self.problem.points is not None
        at = np.array([candidate.current_a for candidate in candidates])
        away = np.linalg.norm(at[:, None] - self.problem.points.current, axis=2)
        capture_s = np.array([candidate.capture_s for candidate in candidates])
        noise = self.noise[np.argmin(away, axis=1)] / capture_s[:, None, None]
        matrix = self.fit.inductance(at)[0][:, PAIRS]
        third = energy_rows(self.fit.spline, at, self.fit.angle_rad, 3) @ self.fit.coefficients
        expected = Inductances(at, matrix, third[:, TRIPLES], noise)
        errors = replace(self.problem.errors, points=None, paths=None)
        return replace(self.problem, points=expected, errors=errors).inductances()[0]


def injected_points(
    recording: RecordingReader, segments: Sequence[Segment], *, voltage_delay_samples: float
) -> tuple[Inductances, Array]:
    """Inductances at the injected points, and the duration of each capture [s].

    Raises
    ------
    NotMeasuredError
        Where too few of the segments show an injection's ripple.
    """

    def ripple(segment: Segment, capture: Capture) -> tuple[Ripple, float] | None:
        delay, angle = voltage_delay_samples, segment.rotor_angle_rad
        try:
            ripple_fit = demodulate(capture, angle, voltage_delay_samples=delay, where=segment.id)
        except NotMeasuredError:
            return None
        return ripple_fit, len(capture) / capture.sampling_frequency_hz

    results = [one for one in each_capture(recording, segments, ripple) if one is not None]
    if len(results) < _MIN_POINTS:
        problem = f"{len(results)} of {len(segments)} points show an injection's ripple, {_MIN_POINTS} are needed"
        raise NotMeasuredError(recording.manifest.name, "segments", problem)
    return invert([ripple_fit for ripple_fit, _ in results]), np.array([seconds for _, seconds in results])


def known_map(points: Inductances, capture_s: Array, rotor_angle_rad: float, reach_a: float) -> KnownMap:
    """Fit the energy to the injections so far.

    Parameters
    ----------
    points : Inductances
    capture_s : array, shape (n,)
        Duration of each capture.
    rotor_angle_rad : float
        Angle of the believed d axis from phase a.
    reach_a : float
        Radius of the target plane: currents up to this length.
    """
    problem, solution = behind_dead_time(pose(points, (), rotor_angle_rad, _CELLS))
    fit = finished(problem, solution)
    # Correlated errors of neighbours make its covariance wider than the solution's.
    widened = np.trace(fit.covariance) / max(float(np.square(problem.modes @ solution.root).sum()), 1e-300)
    zero, nodes = (energy_rows(problem.spline, at, 0.0, 1) for at in (np.zeros((1, 2)), _plane(reach_a)))
    return KnownMap(
        fit=fit,
        root=np.sqrt(widened) * solution.root,
        problem=problem,
        noise=points.covariance * capture_s[:, None, None],
        reach=np.asarray((nodes - zero) @ problem.modes),
    )


def _plane(reach_a: float) -> Array:
    """Nodes of the half of a disc of currents where i_q is positive, about equally dense, shape (m, 2) [A]."""
    out = []
    for ring in range(1, _RINGS + 1):
        angle = np.pi * (np.arange(3 * ring) + 0.5) / (3 * ring)
        out.append(reach_a * ring / _RINGS * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return np.concatenate(out)


def _variance(reach: Array) -> Array:
    """Variance of the flux vector at each node, shape (m,), from (modes' effect x root), shape (m, 2, r)."""
    return np.asarray(np.square(reach).sum(axis=(1, 2)))


def _gains(rows: Array, reach: Array) -> Array:
    """Reduction of the weighted variance at the nodes by each candidate, shape (c,); both factors times the root."""
    flat = (np.sqrt(_variance(reach))[:, None, None] * reach).reshape(-1, reach.shape[2])
    projection = flat @ rows.transpose(0, 2, 1)
    innovation = np.eye(rows.shape[1]) + rows @ rows.transpose(0, 2, 1)
    return np.asarray((projection * (projection @ np.linalg.inv(innovation))).sum(axis=(1, 2)))


def _root_after(root: Array, rows: Array) -> Array:
    """Root of the covariance after measuring these rows: each direction scaled by 1 / sqrt(1 + its information)."""
    _, size, along = np.linalg.svd(rows @ root, full_matrices=False)
    return np.asarray(root - (root @ along.T) * (1.0 - 1.0 / np.sqrt(1.0 + size**2)) @ along)
