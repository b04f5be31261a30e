"""What the energy fit has to know beforehand: the axis of symmetry, and whether ripple and sweeps saw the same iron.

A rotor that is not where it is believed breaks the evenness in i_q; the angle that restores it is the one of the
largest likelihood. With hysteresis a small ripple moves the flux reversibly, by less than a sweep does: i = grad H(psi)
and stop operators of psi (A. Visintin, "Differential Models of Hysteresis", Springer 1994), whose slopes, the same in
all directions, add to the Hessian that the ripple sees. How much, the sweeps tell. Both are used only where the data
leave no doubt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.analysis._energy_fit import EnergyFit, EnergyProblem, finished, pose, settled, smoothed
from orchestrator.analysis._integration import Inductances
from orchestrator.analysis._sweep import FluxPath

Array = NDArray[np.float64]

_MANY = 120  # points are enough to search with
_FURTHEST_RAD = 0.12
_LEAST_RAD = 0.002
_STIFFEST = 0.3  # of the least Hessian
_LEAST = 0.01
_SURE = 4.0  # standard deviations
_DOUBT = 0.15
_RECONCILED = 2.0  # growth of the errors' sizes that is granted to it


def fit_energy(points: Inductances | None, paths: Sequence[FluxPath]) -> EnergyFit:
    """Fit one co-energy to inductances, their slopes and flux along paths; either may be absent.

    Parameters
    ----------
    points : Inductances or None
    paths : sequence of FluxPath
        Each known up to a constant.
    """
    few = _some(points)
    angle = _angle(few, paths)
    posed = replace(pose(points, paths), angle_rad=angle)
    stiffening = _stiffening(points, paths, angle) if points is not None and paths else 0.0
    problem, solution = settled(replace(posed, stiffening_per_h=stiffening))
    fit = finished(problem, solution)
    if stiffening == 0.0:
        return fit
    # How far the stop operators' slopes are the same at all ripples and currents is not known better than this.
    other = smoothed(replace(problem, stiffening_per_h=(1.0 - _DOUBT) * stiffening))
    aside = other.coefficients - solution.coefficients
    return replace(fit, covariance=fit.covariance + np.outer(aside, aside))


def _some(points: Inductances | None) -> Inductances | None:
    if points is None or len(points.current) <= _MANY:
        return points
    kept = np.linspace(0, len(points.current) - 1, _MANY).round().astype(int)
    return Inductances(points.current[kept], points.matrix[kept], points.slope[kept], points.covariance[kept])


def _angle(points: Inductances | None, paths: Sequence[FluxPath]) -> float:
    problem = pose(points, paths)
    # Either kind shows it alone; together they might disagree about other things.
    problem = replace(problem, paths=()) if points is not None else problem

    def cost(angle: float) -> float:
        return smoothed(replace(problem, angle_rad=angle)).cost

    angle, curvature = _least(cost, (-_FURTHEST_RAD, _FURTHEST_RAD), 9, 1e-4)
    scale = max(settled(replace(problem, angle_rad=angle))[0].scales)
    std = scale * np.sqrt(2.0 / max(curvature, 1e-300))
    return angle if abs(angle) > max(_SURE * std, _LEAST_RAD) else 0.0


def _stiffening(points: Inductances, paths: Sequence[FluxPath], angle: float) -> float:
    few = _some(points)
    both = replace(pose(few, paths), angle_rad=angle)
    ripple, _ = settled(replace(both, paths=()))
    swept, _ = settled(replace(both, points=None))
    scales = (ripple.scales[0], ripple.scales[1], swept.scales[2])
    softest = 1.0 / float(np.linalg.eigvalsh(points.matrix).max())

    def tried(share: float) -> EnergyProblem:
        return replace(both, scales=scales, stiffening_per_h=share * softest)

    share, curvature = _least(lambda x: smoothed(tried(x)).cost, (-0.1, _STIFFEST), 5, 1e-3)
    std = np.sqrt(2.0 / max(curvature, 1e-300))
    # A ripple that moves more than a sweep is no hysteresis, and neither is what this does not put right.
    if share <= max(_SURE * std, _LEAST):
        return 0.0
    reconciled, _ = settled(tried(share))
    return share * softest if max(np.divide(reconciled.scales, scales)) < _RECONCILED else 0.0


def _least(
    cost: Callable[[float], float], bounds: tuple[float, float], coarse: int, step: float
) -> tuple[float, float]:
    """Place of the least cost, and the second derivative there."""
    from scipy.optimize import minimize_scalar

    places = np.linspace(*bounds, coarse)
    best = float(places[int(np.argmin([cost(float(x)) for x in places]))])
    width = places[1] - places[0]
    near = (max(best - width, bounds[0]), min(best + width, bounds[1]))
    found = minimize_scalar(cost, bounds=near, method="bounded", options={"xatol": step})
    x, low = float(found.x), float(found.fun)
    aside = 10.0 * step
    return x, max(cost(x - aside) + cost(x + aside) - 2.0 * low, 0.0) / aside**2
