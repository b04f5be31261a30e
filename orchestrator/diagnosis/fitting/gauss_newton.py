"""Gauss-Newton steps of the free standardised parameters, within their bounds and a trust radius.

Columns are frozen: they are reused for several steps while the predicted reductions are reached.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import lsq_linear

from orchestrator.diagnosis.fitting.candidates import EffectTerm, standardised
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.numerics.types import Array
from protocols import ParameterRole

MAX_POWER_EXPONENT = 1.25
"""Largest exponent with which an amplitude follows a shape; at one their quotient stays constant."""


MAX_STEP: float = 1.0
"""Largest change of a shape in one step, in standard deviations of its prior."""
GOOD_REDUCTION_RATIO: float = 0.5
"""Ratio of actual to predicted reduction from which the next step reuses the columns and may be longer."""
STEP_FACTOR: float = 0.3
"""Factor on the step length after a step below that ratio."""
MIN_STEP: float = 0.01
"""Step length below which the descent ends, in standard deviations of the prior."""


def frozen_steps(
    best: Fit,
    evaluate: Callable[[Model, Fit], Fit],
    min_gain: float,
    radius: float = MAX_STEP,
    widest: float = MAX_STEP,
) -> tuple[Fit, float]:
    """Steps with the columns of a fit while the predicted reductions are reached; the best fit, and the trust radius.

    A column costs as much as the residual itself, and all effects together have dozens.

    Parameters
    ----------
    evaluate : callable
        The residual of a model, with the columns and the linearisation of a fit.
    min_gain : float
        Predicted fall of the objective below which no step is made.
    """
    while radius >= MIN_STEP:
        move, predicted = bounded_step(best, best.projected(), radius)
        if predicted < min_gain:
            break
        # Amplitudes are damped too: hysteresis loops do not scale with an amplitude.
        part = min(radius, 1.0)
        predicted *= part * (2.0 - part)
        trial = evaluate(moved_by(best.model, part * move), best)
        reduction_ratio = (best.objective - trial.objective) / predicted
        if reduction_ratio > GOOD_REDUCTION_RATIO:
            best, radius = trial, min(2.0 * radius, widest)
            continue
        radius *= STEP_FACTOR
        if reduction_ratio > 0.0:
            return trial, radius
    return best, radius


def bounded_step(fit: Fit, system: tuple[Array, Array], radius: float) -> tuple[Array, float]:
    """Best step within the bounds, with shapes limited to a trust radius, and its predicted reduction.

    Amplitudes, in which the residual is nearly linear, are not limited by the radius (bounded least squares;
    P. B. Stark, R. L. Parker, Computational Statistics 10 (1995) 129).
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


def _by_powers(item: EffectTerm, moved: EffectTerm, steps: Mapping[str, float]) -> EffectTerm:
    """The moved effect, its amplitudes scaled by a power of a shape up to `MAX_POWER_EXPONENT`."""
    shapes = [n for n in item.candidate.of_role(ParameterRole.SHAPE) if n in steps]
    widest = max((math.log(moved.values[n] / item.values[n]) for n in shapes), key=abs, default=0.0)
    for name in item.candidate.amplitudes:
        x, step = item.standardised_value(name), steps.get(name, 0.0)
        if x and 0.0 < step / x * widest <= MAX_POWER_EXPONENT * widest**2:
            moved = moved.moved(name, x * math.exp(step / x))
    return moved
