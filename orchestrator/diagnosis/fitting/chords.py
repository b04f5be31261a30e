"""Descent with many parameters of which few move: columns are kept from step to step while they keep their promise.

A column costs as much as the residual itself, and all effects together have dozens. Decides nothing.
"""

from __future__ import annotations

from orchestrator.diagnosis.fitting.fit import LEAST_GAIN, Fitter
from orchestrator.diagnosis.fitting.gauss_newton import bounded_step, moved_by
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.formatting.quantities import number

LEAST_JOINT_GAIN: float = 2.0
"""Fall of the objective below which a round of all effects together is not worth its cost, that of a whole fit of
one: one nat."""
MAX_CHORD_STEP: float = 1.0
"""How far a shape moves in one step along kept columns, in standard deviations of its prior."""
GOOD_CHORD_REDUCTION_RATIO: float = 0.5
"""Ratio of actual to predicted reduction from which the next step may use the same columns and be wider."""
CHORD_STEP_FACTOR: float = 0.3
"""Factor by which the next step is shorter after one below that ratio."""
LEAST_CHORD_STEP: float = 0.01
"""Step below which no further one is tried, in standard deviations of the prior."""


def fit_with_frozen_jacobian(
    fitter: Fitter, model: Model, *, rounds: int, tolerance: float, known: Fit | None = None
) -> Fit:
    """Fit R_s, the map and every free parameter, from where the model stands.

    Parameters
    ----------
    known : Fit, optional
        Of much the same model: what has not moved since is taken from there.
    rounds : int
        How often columns and frame are made anew.
    tolerance : float
        Gain of a round, as a part of the excess chi2, below which the fit ends.
    """
    radius = widest = MAX_CHORD_STEP
    if known is not None and known.model.space is not model.space:
        known = None
    # Columns may be a little off; a frame that is older than its map leads away from where the fit was.
    best = fitter.renewed(model, known.frame if known else None, known=known)
    for _ in range(rounds if model.free else 0):
        fitter.under_way(f"{len(model.active)} effects together: chi2 {number(best.chi2_per_dof)}")
        least_gain = LEAST_JOINT_GAIN + tolerance * max(best.chi2 - best.dof, 0.0)
        trial, radius = _frozen_steps(fitter, best, min(radius, widest), least_gain, widest)
        if trial is best:
            break
        renewed = fitter.renewed(trial.model, best.frame, known=trial)
        gain = best.objective - renewed.objective
        if gain < 0.0:
            # The frame does not follow as far; nor would it when the same steps were made again.
            widest = CHORD_STEP_FACTOR * min(radius, widest)
            if widest < LEAST_CHORD_STEP:
                break
            continue
        best = renewed
        if gain < least_gain:
            break
    return best


def trial_step(fitter: Fitter, model: Model, known: Fit) -> Fit:
    """Where the columns of an earlier fit lead a model much like that fit's: nothing is made anew that it has."""
    best = fitter.evaluate(model, known.frame, known=known)
    return _frozen_steps(fitter, best, MAX_CHORD_STEP, LEAST_GAIN, MAX_CHORD_STEP)[0]


def _frozen_steps(fitter: Fitter, best: Fit, radius: float, least_gain: float, widest: float) -> tuple[Fit, float]:
    """As many steps along the columns as keep their promise, the last that gained at all, and the radius then."""
    while radius >= LEAST_CHORD_STEP:
        move, predicted = bounded_step(best, best.projected(), radius)
        if predicted < least_gain:
            break
        # Amplitudes, too: a loop that is wider than a ripple is no multiple of one that is narrower.
        part = min(radius, 1.0)
        predicted *= part * (2.0 - part)
        trial = fitter.evaluate(moved_by(best.model, part * move), best.frame, known=best, renew=False)
        reduction_ratio = (best.objective - trial.objective) / predicted
        if reduction_ratio > GOOD_CHORD_REDUCTION_RATIO:
            best, radius = trial, min(2.0 * radius, widest)
            continue
        radius *= CHORD_STEP_FACTOR
        if reduction_ratio > 0.0:
            return trial, radius
    return best, radius
