"""What the energy fit has to know beforehand: axis of symmetry, kind of iron, dead time, and how fine a spline.

A rotor that is not where it is believed breaks the evenness in i_q; the angle that restores it is the one of the
largest likelihood. With hysteresis a small ripple moves the flux reversibly, by less than a sweep does: i = grad H(psi)
and stop operators of psi (A. Visintin, "Differential Models of Hysteresis", Springer 1994), whose slopes, the same in
all directions, add to the Hessian that the ripple sees. How much, the sweeps tell. Both are used only where the data
leave no doubt. Dead time's share in the ripple and the number of intervals are those of the largest likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

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
from orchestrator.analysis._integration import Inductances
from orchestrator.analysis._ripple_errors import SIZE
from orchestrator.analysis._sweep import FluxPath
from orchestrator.numerics.reml import Solution
from orchestrator.numerics.types import Array

Settled = tuple[EnergyProblem, Solution]

_MANY = 120  # points are enough to search with
_FURTHEST_RAD = 0.12
_LEAST_RAD = 0.002
_STIFFEST = 0.3  # of the least Hessian
_LEAST = 0.01
_SURE = 4.0  # standard deviations
_DOUBT = 0.15
_RECONCILED = 2.0  # growth of the errors' sizes that is granted to it
_BETTER = 6.0  # twice a logarithm of likelihood that makes something more complicated worth while
_FINEST = 32


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
    few = _some(points)
    angle, std = _angle(few, paths)
    posed = pose(points, paths, rotor_angle_rad).varied(angle_rad=angle)
    stiffening = _stiffening(points, paths, angle) if points is not None and paths else 0.0
    problem, solution = _finest(_behind_dead_time(posed.varied(stiffening_per_h=stiffening)))
    fit = finished(problem, solution)
    if angle:
        fit = _widened(fit, problem, problem.varied(angle_rad=angle + std))
    if stiffening:
        # How far the stop operators' slopes are the same at all ripples and currents is not known better than this.
        fit = _widened(fit, problem, problem.varied(stiffening_per_h=(1.0 - _DOUBT) * stiffening))
    return fit


def _widened(fit: EnergyFit, problem: EnergyProblem, other: EnergyProblem) -> EnergyFit:
    """The fit, not known better than by what it differs from another one."""
    aside = problem.modes @ smoothed(other).modes - fit.coefficients
    return replace(fit, covariance=fit.covariance + np.outer(aside, aside))


def _behind_dead_time(problem: EnergyProblem) -> Settled:
    """With dead time's share in the ripple taken out where the data ask for it."""
    plain = settled(problem)
    if problem.points is None:
        return plain
    tried = settled(problem.varied(errors=replace(problem.errors, dead_time=SIZE)))
    return tried if evidence(*tried) < evidence(*plain) - _BETTER else plain


def _finest(coarse: Settled) -> Settled:
    """With as many intervals on each axis as the data ask for."""
    best, cells = coarse, COARSE
    grows = True
    while grows:
        grows = False
        for finer in _finer(cells):
            start = best[0]
            posed = pose(start.points, start.paths, start.rotor_angle_rad, finer)
            same = posed.varied(errors=start.errors, angle_rad=start.angle_rad, stiffening_per_h=start.stiffening_per_h)
            tried = settled(same)
            if evidence(*tried) < evidence(*best) - _BETTER:
                best, cells, grows = tried, finer, True
    return best


def _finer(cells: tuple[int, int]) -> Iterator[tuple[int, int]]:
    d, q = cells
    for finer in ((d, 4 * q // 3), (4 * d // 3, q)):
        if max(finer) <= _FINEST:
            yield finer


def _some(points: Inductances | None) -> Inductances | None:
    if points is None or len(points.current) <= _MANY:
        return points
    kept = np.linspace(0, len(points.current) - 1, _MANY).round().astype(int)
    return Inductances(points.current[kept], points.matrix[kept], points.slope[kept], points.covariance[kept])


def _angle(points: Inductances | None, paths: Sequence[FluxPath]) -> tuple[float, float]:
    """Angle of the axis of symmetry, zero where it may be that, and its standard deviation."""
    problem = pose(points, paths)
    # Either kind shows it alone; together they might disagree about other things.
    problem = replace(problem, paths=()) if points is not None else problem

    def cost(angle: float) -> float:
        return smoothed(problem.varied(angle_rad=angle)).cost

    angle, curvature = _least(cost, (-_FURTHEST_RAD, _FURTHEST_RAD), 9, 1e-4)
    turned = settled(problem.varied(angle_rad=angle))
    std = float(max(turned[0].errors.scales) * np.sqrt(2.0 / max(curvature, 1e-300)))
    if abs(angle) <= max(_SURE * std, _LEAST_RAD):
        return 0.0, std
    # Errors as large as they turn out to be have the last word.
    return (angle, std) if evidence(*turned) < evidence(*settled(problem)) - _SURE**2 else (0.0, std)


def _stiffening(points: Inductances, paths: Sequence[FluxPath], angle: float) -> float:
    few = _some(points)
    both = pose(few, paths).varied(angle_rad=angle)
    ripple, _ = settled(replace(both, paths=()))
    swept, _ = settled(replace(both, points=None))
    scales = (*ripple.errors.scales[:2], *swept.errors.scales[2:])
    errors = Errors(scales, ripple.errors.points, swept.errors.paths)
    softest = 1.0 / float(np.linalg.eigvalsh(points.matrix).max())
    both.blocks()  # made here once, its rows are those of all that are tried

    def tried(share: float) -> EnergyProblem:
        return both.varied(errors=errors, stiffening_per_h=share * softest)

    share, curvature = _least(lambda x: smoothed(tried(x)).cost, (-0.1, _STIFFEST), 5, 1e-3)
    std = np.sqrt(2.0 / max(curvature, 1e-300))
    # A ripple that moves more than a sweep is no hysteresis, and neither is what this does not put right.
    if share <= max(_SURE * std, _LEAST):
        return 0.0
    reconciled, _ = settled(tried(share))
    return share * softest if max(np.divide(reconciled.errors.scales, scales)) < _RECONCILED else 0.0


def _least(
    cost: Callable[[float], float], bounds: tuple[float, float], coarse: int, step: float
) -> tuple[float, float]:
    """Place of the least cost, and the second derivative there."""
    from scipy.optimize import minimize_scalar

    # Twice on a grid: far from the answer the likelihood need not have one maximum only.
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
