"""Search the nonlinear parameters of the energy fit: axis of symmetry, hysteresis, dead time, spline intervals.

An error of the believed rotor angle breaks the evenness in i_q; the maximum-likelihood angle restores it. With
hysteresis a small ripple moves the flux reversibly, by less than a sweep does: i = grad H(psi) plus stop operators of
psi (A. Visintin, "Differential Models of Hysteresis", Springer 1994), whose slopes, the same in all directions, add to
the Hessian that the ripple measures. The sweeps determine that addition. Both are used only where they are significant.
Dead time's share in the ripple and the number of intervals are those of the largest likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.analysis._energy_fit import (
    COARSE,
    EnergyFit,
    EnergyProblem,
    Errors,
    evidence,
    finished,
    pose,
    settled,
    smoothed,
)
from orchestrator.analysis._inductance_errors import DEAD_TIME_SHARE
from orchestrator.analysis._integration import Inductances
from orchestrator.analysis._sweep import FluxPath
from orchestrator.numerics.reml import Solution
from orchestrator.numerics.types import Array

Settled = tuple[EnergyProblem, Solution]


@dataclass(frozen=True)
class Criteria:
    """Search ranges and acceptance thresholds, calibrated on simulated motors.

    Attributes
    ----------
    points : int
        Number of injection points for the search; more points only take longer.
    min_sigmas : float
        Standard deviations from zero above which an angle or a stiffening is accepted.
    evidence : float
        Required growth of twice the logarithm of the likelihood for dead time or a finer spline to be used: a
        factor of twenty in the likelihood, "strong" evidence (doi:10.1080/01621459.1995.10476572).
    max_rad, min_rad : float
        Electrical angle of the axis of symmetry: search limit, and the smallest that matters to a map.
    max_stiffening, min_stiffening : float
        Addition of hysteresis to the ripple's Hessian, relative to the smallest Hessian: search limit, and the smallest
        that matters.
    stiffening_std : float
        Relative variation of the stiffening over ripples and currents.
    max_error_growth : float
        Largest factor on the errors of sweeps and ripples in the joint fit with hysteresis.
    max_intervals : int
        Largest number of a spline's intervals along an axis.
    """

    points: int = 120
    min_sigmas: float = 4.0
    evidence: float = 6.0
    max_rad: float = 0.12
    min_rad: float = 0.002
    max_stiffening: float = 0.3
    min_stiffening: float = 0.01
    stiffening_std: float = 0.15
    max_error_growth: float = 2.0
    max_intervals: int = 32


CRITERIA = Criteria()


def fit_energy(
    points: Inductances | None, paths: Sequence[FluxPath], *, rotor_angle_rad: Array | float = 0.0
) -> EnergyFit:
    """Fit one co-energy to inductances, their slopes and flux along paths; either may be absent.

    Parameters
    ----------
    points : Inductances or None
    paths : sequence of FluxPath
        Each known up to a constant.
    rotor_angle_rad : float, or array of shape (n,)
        Angle of the believed d axis from phase a, for all or each of the points: dead time acts along the phases.
    """
    few = _subset(points)
    angle, std = _angle(few, paths)
    posed = pose(points, paths, rotor_angle_rad).varied(angle_rad=angle)
    stiffening = _stiffening(points, paths, angle) if points is not None and paths else 0.0
    problem, solution = _finest(behind_dead_time(posed.varied(stiffening_per_h=stiffening)))
    fit = finished(problem, solution)
    if angle:
        fit = _widened(fit, problem, problem.varied(angle_rad=angle + std))
    if stiffening:
        # The stop operators' slopes may vary by this much over ripples and currents.
        fit = _widened(fit, problem, problem.varied(stiffening_per_h=(1.0 - CRITERIA.stiffening_std) * stiffening))
    return fit


def _widened(fit: EnergyFit, problem: EnergyProblem, other: EnergyProblem) -> EnergyFit:
    """The fit, with its difference from another fit added to the covariance."""
    aside = problem.modes @ smoothed(other).coefficients - fit.coefficients
    return replace(fit, covariance=fit.covariance + np.outer(aside, aside))


def behind_dead_time(problem: EnergyProblem) -> Settled:
    """The problem with dead time removed from the ripple, where the data support it."""
    plain = settled(problem)
    if problem.points is None:
        return plain
    tried = settled(problem.varied(errors=replace(problem.errors, inverter_step=DEAD_TIME_SHARE)))
    return tried if evidence(*tried) < evidence(*plain) - CRITERIA.evidence else plain


def _finest(coarse: Settled) -> Settled:
    """The problem with the number of intervals per axis that the data support."""
    best, cells = coarse, COARSE
    grows = True
    while grows:
        grows = False
        for finer in _finer(cells):
            start = best[0]
            posed = pose(start.points, start.paths, start.rotor_angle_rad, finer)
            trial = posed.varied(
                errors=start.errors, angle_rad=start.angle_rad, stiffening_per_h=start.stiffening_per_h
            )
            tried = settled(trial)
            if evidence(*tried) < evidence(*best) - CRITERIA.evidence:
                best, cells, grows = tried, finer, True
    return best


def _finer(cells: tuple[int, int]) -> Iterator[tuple[int, int]]:
    d, q = cells
    for finer in ((d, 4 * q // 3), (4 * d // 3, q)):
        if max(finer) <= CRITERIA.max_intervals:
            yield finer


def _subset(points: Inductances | None) -> Inductances | None:
    if points is None or len(points.current) <= CRITERIA.points:
        return points
    kept = np.linspace(0, len(points.current) - 1, CRITERIA.points).round().astype(int)
    return Inductances(points.current[kept], points.matrix[kept], points.slope[kept], points.covariance[kept])


def _angle(points: Inductances | None, paths: Sequence[FluxPath]) -> tuple[float, float]:
    """Angle of the axis of symmetry, zero where not significant, and its standard deviation [rad]."""
    problem = pose(points, paths)
    # Either kind of data determines it alone; both together may disagree for other reasons.
    problem = replace(problem, paths=()) if points is not None else problem

    def cost(angle: float) -> float:
        return smoothed(problem.varied(angle_rad=angle)).cost

    angle, curvature = _minimum(cost, (-CRITERIA.max_rad, CRITERIA.max_rad), 9, 1e-4)
    at_angle = settled(problem.varied(angle_rad=angle))
    std = float(max(at_angle[0].errors.scales) * np.sqrt(2.0 / max(curvature, 1e-300)))
    if abs(angle) <= max(CRITERIA.min_sigmas * std, CRITERIA.min_rad):
        return 0.0, std
    # The final angle uses the estimated sizes of the errors.
    return (angle, std) if evidence(*at_angle) < evidence(*settled(problem)) - CRITERIA.min_sigmas**2 else (0.0, std)


def _stiffening(points: Inductances, paths: Sequence[FluxPath], angle: float) -> float:
    subset = _subset(points)
    joint = pose(subset, paths).varied(angle_rad=angle)
    ripple, _ = settled(replace(joint, paths=()))
    swept, _ = settled(replace(joint, points=None))
    scales = (*ripple.errors.scales[:2], *swept.errors.scales[2:])
    errors = Errors(scales, ripple.errors.points, swept.errors.paths)
    softest = 1.0 / float(np.linalg.eigvalsh(points.matrix).max())
    joint.blocks()  # computes once the rows that all trials share
    ripple.blocks()

    def trial(share: float) -> EnergyProblem:
        return joint.varied(errors=errors, stiffening_per_h=share * softest)

    def cost(share: float) -> float:
        # A ripple distorted by dead time is no Hessian and fits any stiffening that makes it one: only the sweeps' part
        # of the cost counts.
        alone = ripple.varied(stiffening_per_h=share * softest)
        return smoothed(trial(share)).cost - smoothed(alone).cost

    share, curvature = _minimum(cost, (-0.1, CRITERIA.max_stiffening), 5, 1e-3)
    std = np.sqrt(2.0 / max(curvature, 1e-300))
    # With hysteresis a ripple moves the flux by less than a sweep, and the correction reconciles both.
    if share <= max(CRITERIA.min_sigmas * std, CRITERIA.min_stiffening):
        return 0.0
    reconciled, _ = settled(trial(share))
    return share * softest if max(np.divide(reconciled.errors.scales, scales)) < CRITERIA.max_error_growth else 0.0


def _minimum(
    cost: Callable[[float], float], bounds: tuple[float, float], coarse: int, step: float
) -> tuple[float, float]:
    """Minimiser of the cost, and the second derivative at it."""
    from scipy.optimize import minimize_scalar

    # Two grid passes: far from the solution the likelihood may have several maxima.
    low, high = bounds
    for _ in range(2):
        places = np.linspace(low, high, coarse)
        costs = [cost(float(x)) for x in places]
        best, width = int(np.argmin(costs)), float(places[1] - places[0])
        low, high = max(float(places[best]) - width, bounds[0]), min(float(places[best]) + width, bounds[1])
    result = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": step})
    x, lowest = min((float(result.x), float(result.fun)), (float(places[best]), costs[best]), key=lambda pair: pair[1])
    offset = 10.0 * step
    return x, max(cost(x - offset) + cost(x + offset) - 2.0 * lowest, 0.0) / offset**2
