"""One Gauss-Newton step of the free standardised parameters within their bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from orchestrator.diagnosis.fitting.candidates import EffectTerm, standardised
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.numerics.types import Array
from protocols import ParameterRole

MAX_POWER_EXPONENT = 1.25
"""Largest exponent with which an amplitude follows a shape; at one their quotient stays constant."""


def newton_step(
    fit: Fit, system: tuple[Array, Array], damping: float, which: NDArray[np.bool_] | None = None
) -> tuple[Array, float]:
    """Step of all free coordinates (or of some) with map and R_s eliminated, and its predicted reduction.

    Damping is Levenberg and Marquardt's (doi:10.1137/0111030), relative to each coordinate's curvature. A parameter
    that would leave its bound is held there, and the others are solved for without it.
    """
    free = fit.model.free
    x = np.array([a.standardised_value(n) for a, n in free])
    normal, gradient = system
    count = len(x)
    slope = gradient[:count] + _prior_residuals(fit)
    curvature = normal[:count, :count] + np.eye(count)
    curvature += damping * np.diag(np.diag(curvature))
    moving = np.flatnonzero(which) if which is not None else np.arange(count)
    move = np.zeros(count)
    while moving.size:
        move[:] = 0.0
        move[moving] = np.linalg.solve(curvature[np.ix_(moving, moving)], -slope[moving])
        stuck = np.array([is_stuck(*free[k], float(x[k] + move[k])) for k in moving])
        if not stuck.any():
            break
        moving = moving[~stuck]
        move[:] = 0.0
    return move, -float(slope @ move)


def bounded_step(fit: Fit, system: tuple[Array, Array], radius: float) -> tuple[Array, float]:
    """Best step within the bounds, with shapes limited to a trust radius, and its predicted reduction.

    Amplitudes, in which the residual is nearly linear, are not limited by the radius (bounded least squares).
    """
    free = fit.model.free
    x = np.array([a.standardised_value(n) for a, n in free])
    normal, gradient = system
    count = len(x)
    slope, curvature = gradient[:count] + _prior_residuals(fit), normal[:count, :count] + np.eye(count)
    lows, highs = np.array([reach(a, n) for a, n in free]).T - x
    shapes = np.array([n not in a.candidate.amplitudes for a, n in free])
    lows[shapes], highs[shapes] = np.maximum(lows[shapes], -radius), np.minimum(highs[shapes], radius)
    # Rounding in the elimination of the map may leave a negative diagonal for a column that the map can replace.
    values, vectors = np.linalg.eigh(curvature)
    root = np.sqrt(np.maximum(values, 1.0))[:, None] * vectors.T
    target = -(vectors.T @ slope) / np.sqrt(np.maximum(values, 1.0))
    # A coordinate at its bound needs a nonempty interval for the solver.
    lows, highs = np.minimum(lows, -1e-12), np.maximum(highs, 1e-12)
    move = lsq_linear(root, target, (lows, highs), method="bvls").x
    return move, -float(2.0 * slope @ move + move @ curvature @ move)


def _prior_residuals(fit: Fit) -> Array:
    return np.array([a.prior_residual(n) for a, n in fit.model.free])


def reach(active: EffectTerm, name: str) -> tuple[float, float]:
    """Bounds of a parameter's standardised value."""
    p = active.candidate.named(name)
    if p.role is ParameterRole.SHAPE:
        return -math.inf, math.inf
    ends = standardised(p, p.low), standardised(p, p.high)
    return min(ends), max(ends)


def is_stuck(active: EffectTerm, name: str, wanted: float) -> bool:
    """Whether a bound prevents a wanted step, up to rounding."""
    moved = active.moved(name, wanted).standardised_value(name) - active.standardised_value(name)
    return abs(moved) <= 1e-6 * abs(wanted - active.standardised_value(name))


def moved_by(model: Model, move: Array) -> Model:
    """The model with every free coordinate moved; an amplitude follows a power of a shape that moves with it.

    A heat capacity whose time constant exceeds the recording, or iron that hardly saturates, determines only the
    quotient of both: along that curved valley the exponent is one.
    """
    active, k = [], 0
    for item in model.active:
        steps = dict(zip(item.free, move[k : k + len(item.free)].tolist(), strict=True))
        k += len(item.free)
        moved = item
        for name, step in steps.items():
            moved = moved.moved(name, item.standardised_value(name) + step)
        active.append(_by_powers(item, moved, steps))
    return model.with_active(active)


def midway(one: Model, other: Model) -> Model:
    """The model half way from one to another with the same map space; an effect that `one` lacks is half as large."""
    before = {a.name: a for a in one.active}
    active = []
    for term in other.active:
        start, moving = before.get(term.name), term.free
        if start is None:
            start, moving = term.candidate.absent(), term.candidate.amplitudes
        for name in moving:
            term = term.moved(name, 0.5 * (start.standardised_value(name) + term.standardised_value(name)))
        active.append(term)
    coefficients = 0.5 * (one.magnetics.coefficients + other.magnetics.coefficients)
    magnetics = replace(other.magnetics, coefficients=coefficients)
    return replace(other, magnetics=magnetics, r_s=0.5 * (one.r_s + other.r_s), active=tuple(active))


def _by_powers(item: EffectTerm, moved: EffectTerm, steps: Mapping[str, float]) -> EffectTerm:
    """The moved effect, its amplitudes scaled by a power of a shape up to `MAX_POWER_EXPONENT`."""
    shapes = [n for n in item.candidate.of_role(ParameterRole.SHAPE) if n in steps]
    widest = max((math.log(moved.values[n] / item.values[n]) for n in shapes), key=abs, default=0.0)
    for name in item.candidate.amplitudes:
        x, step = item.standardised_value(name), steps.get(name, 0.0)
        if x and 0.0 < step / x * widest <= MAX_POWER_EXPONENT * widest**2:
            moved = moved.moved(name, x * math.exp(step / x))
    return moved
