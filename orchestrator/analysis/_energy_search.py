"""Search the nonlinear parameters of the energy fit: axis of symmetry, hysteresis, dead time, spline intervals.

A rotor that is not where it is believed breaks the evenness in i_q; the angle that restores it is the one of the
largest likelihood. With hysteresis a small ripple moves the flux reversibly, by less than a sweep does: i = grad H(psi)
and stop operators of psi (A. Visintin, "Differential Models of Hysteresis", Springer 1994), whose slopes, the same in
all directions, add to the Hessian that the ripple sees. How much, the sweeps tell. Both are used only where the data
leave no doubt. Dead time's share in the ripple and the number of intervals are those of the largest likelihood.
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
    sure : float
        Standard deviations from zero above which an angle or a stiffening is accepted.
    evidence : float
        By how much twice the logarithm of the likelihood has to grow for dead time or a finer spline to be used: a
        factor of twenty in the likelihood, "strong" evidence (doi:10.1080/01621459.1995.10476572).
    furthest_rad, least_rad : float
        Electrical angle of the axis of symmetry: the largest that is looked for, and the least
        that matters to a map.
    stiffest, least_stiffening : float
        By how much hysteresis stiffens the ripple's Hessian, relative to the least Hessian: the most that is looked
        for, and the least that matters.
    stiffening_doubt : float
        Share of it by which it may differ from ripple to ripple and from current to current.
    reconciled : float
        Factor that sweeps' and ripples' errors may grow by when hysteresis puts both together.
    finest : int
        Most intervals of a spline along an axis.
    """

    points: int = 120
    sure: float = 4.0
    evidence: float = 6.0
    furthest_rad: float = 0.12
    least_rad: float = 0.002
    stiffest: float = 0.3
    least_stiffening: float = 0.01
    stiffening_doubt: float = 0.15
    reconciled: float = 2.0
    finest: int = 32


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
        Of the believed d axis from phase a's, of all or of each of the points: dead time acts along the phases.
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
        # How far the stop operators' slopes are the same at all ripples and currents is not known better than this.
        fit = _widened(fit, problem, problem.varied(stiffening_per_h=(1.0 - CRITERIA.stiffening_doubt) * stiffening))
    return fit


def _widened(fit: EnergyFit, problem: EnergyProblem, other: EnergyProblem) -> EnergyFit:
    """The fit, with its difference from another fit added to the covariance."""
    aside = problem.modes @ smoothed(other).modes - fit.coefficients
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
            same = posed.varied(errors=start.errors, angle_rad=start.angle_rad, stiffening_per_h=start.stiffening_per_h)
            tried = settled(same)
            if evidence(*tried) < evidence(*best) - CRITERIA.evidence:
                best, cells, grows = tried, finer, True
    return best


def _finer(cells: tuple[int, int]) -> Iterator[tuple[int, int]]:
    d, q = cells
    for finer in ((d, 4 * q // 3), (4 * d // 3, q)):
        if max(finer) <= CRITERIA.finest:
            yield finer


def _subset(points: Inductances | None) -> Inductances | None:
    if points is None or len(points.current) <= CRITERIA.points:
        return points
    kept = np.linspace(0, len(points.current) - 1, CRITERIA.points).round().astype(int)
    return Inductances(points.current[kept], points.matrix[kept], points.slope[kept], points.covariance[kept])


def _angle(points: Inductances | None, paths: Sequence[FluxPath]) -> tuple[float, float]:
    """Angle of the axis of symmetry, zero where it may be that, and its standard deviation."""
    problem = pose(points, paths)
    # Either kind shows it alone; together they might disagree about other things.
    problem = replace(problem, paths=()) if points is not None else problem

    def cost(angle: float) -> float:
        return smoothed(problem.varied(angle_rad=angle)).cost

    angle, curvature = _least(cost, (-CRITERIA.furthest_rad, CRITERIA.furthest_rad), 9, 1e-4)
    turned = settled(problem.varied(angle_rad=angle))
    std = float(max(turned[0].errors.scales) * np.sqrt(2.0 / max(curvature, 1e-300)))
    if abs(angle) <= max(CRITERIA.sure * std, CRITERIA.least_rad):
        return 0.0, std
    # The final angle uses the estimated sizes of the errors.
    return (angle, std) if evidence(*turned) < evidence(*settled(problem)) - CRITERIA.sure**2 else (0.0, std)


def _stiffening(points: Inductances, paths: Sequence[FluxPath], angle: float) -> float:
    few = _subset(points)
    both = pose(few, paths).varied(angle_rad=angle)
    ripple, _ = settled(replace(both, paths=()))
    swept, _ = settled(replace(both, points=None))
    scales = (*ripple.errors.scales[:2], *swept.errors.scales[2:])
    errors = Errors(scales, ripple.errors.points, swept.errors.paths)
    softest = 1.0 / float(np.linalg.eigvalsh(points.matrix).max())
    both.blocks()  # computes once the rows that all trials share
    ripple.blocks()

    def tried(share: float) -> EnergyProblem:
        return both.varied(errors=errors, stiffening_per_h=share * softest)

    def cost(share: float) -> float:
        # A ripple that dead time bends is no Hessian, and would have any stiffening that makes it one: what counts is
        # what the sweeps say after it.
        alone = ripple.varied(stiffening_per_h=share * softest)
        return smoothed(tried(share)).cost - smoothed(alone).cost

    share, curvature = _least(cost, (-0.1, CRITERIA.stiffest), 5, 1e-3)
    std = np.sqrt(2.0 / max(curvature, 1e-300))
    # With hysteresis a ripple moves the flux by less than a sweep, and the correction reconciles both.
    if share <= max(CRITERIA.sure * std, CRITERIA.least_stiffening):
        return 0.0
    reconciled, _ = settled(tried(share))
    return share * softest if max(np.divide(reconciled.errors.scales, scales)) < CRITERIA.reconciled else 0.0


def _least(
    cost: Callable[[float], float], bounds: tuple[float, float], coarse: int, step: float
) -> tuple[float, float]:
    """Minimiser of the cost, and the second derivative there."""
    from scipy.optimize import minimize_scalar

    # Two grid passes: far from the solution the likelihood may have several maxima.
    low, high = bounds
    for _ in range(2):
        places = np.linspace(low, high, coarse)
        costs = [cost(float(x)) for x in places]
        best, width = int(np.argmin(costs)), float(places[1] - places[0])
        low, high = max(float(places[best]) - width, bounds[0]), min(float(places[best]) + width, bounds[1])
    found = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": step})
    x, least = min((float(found.x), float(found.fun)), (float(places[best]), costs[best]), key=lambda one: one[1])
    aside = 10.0 * step
    return x, max(cost(x - aside) + cost(x + aside) - 2.0 * least, 0.0) / aside**2
