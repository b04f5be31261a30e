"""Descent with frozen Jacobians: columns are reused for several steps while the predicted reductions are reached.

A column costs as much as the residual itself, and all effects together have dozens.
"""

from __future__ import annotations

from orchestrator.diagnosis.fitting.fit import MIN_GAIN, Fitter
from orchestrator.diagnosis.fitting.gauss_newton import bounded_step, moved_by
from orchestrator.diagnosis.fitting.model import Fit, Model
from orchestrator.formatting.quantities import number, plural

MIN_JOINT_GAIN: float = 2.0
"""Fall of the objective below which a round with all effects ends; a round costs as much as a fit of one effect."""
MAX_CHORD_STEP: float = 1.0
"""Largest change of a shape in one step with frozen columns, in standard deviations of its prior."""
GOOD_CHORD_REDUCTION_RATIO: float = 0.5
"""Ratio of actual to predicted reduction from which the next step reuses the columns and may be longer."""
CHORD_STEP_FACTOR: float = 0.3
"""Factor on the step length after a step below that ratio."""
MIN_CHORD_STEP: float = 0.01
"""Step length below which the descent ends, in standard deviations of the prior."""


def fit_with_frozen_jacobian(
    fitter: Fitter, model: Model, *, rounds: int, tolerance: float, known: Fit | None = None
) -> Fit:
    """Fit R_s, the map and every free parameter, starting at the model's values.

    Parameters
    ----------
    known : Fit, optional
        Fit of a similar model, whose columns are reused where they have not changed.
    rounds : int
        Number of relinearisations, each with new columns.
    tolerance : float
        Fall of the objective in a round over the excess chi2, below which the fit ends.
    """
    radius = widest = MAX_CHORD_STEP
    if known is not None and known.model.space is not model.space:
        known = None
    # Slightly old columns do no harm; a linearisation older than its map leads away from the minimum.
    best = fitter.relinearise(model, known.linearisation if known else None, known=known)
    for _ in range(rounds if model.free else 0):
        fitter.under_way(f"{plural(len(model.active), 'effect')} together: chi2 {number(best.chi2_per_dof)}")
        min_gain = MIN_JOINT_GAIN + tolerance * max(best.chi2 - best.dof, 0.0)
        trial, radius = _frozen_steps(fitter, best, min(radius, widest), min_gain, widest)
        if trial is best:
            break
        renewed = fitter.relinearise(trial.model, best.linearisation, known=trial)
        gain = best.objective - renewed.objective
        if gain < 0.0:
            # The linearisation does not hold that far; repeating the steps would not help.
            widest = CHORD_STEP_FACTOR * min(radius, widest)
            if widest < MIN_CHORD_STEP:
                break
            continue
        best = renewed
        if gain < min_gain:
            break
    return best


def trial_step(fitter: Fitter, model: Model, known: Fit) -> Fit:
    """Improve a model similar to an earlier fit's with that fit's columns and linearisation."""
    best = fitter.evaluate(model, known.linearisation, known=known)
    return _frozen_steps(fitter, best, MAX_CHORD_STEP, MIN_GAIN, MAX_CHORD_STEP)[0]


def _frozen_steps(fitter: Fitter, best: Fit, radius: float, min_gain: float, widest: float) -> tuple[Fit, float]:
    """Steps with frozen columns while predictions hold; returns the best fit and the trust radius."""
    while radius >= MIN_CHORD_STEP:
        move, predicted = bounded_step(best, best.projected(), radius)
        if predicted < min_gain:
            break
        # Amplitudes are damped too: hysteresis loops do not scale with an amplitude.
        part = min(radius, 1.0)
        predicted *= part * (2.0 - part)
        trial = fitter.evaluate(moved_by(best.model, part * move), best.linearisation, known=best, renew=False)
        reduction_ratio = (best.objective - trial.objective) / predicted
        if reduction_ratio > GOOD_CHORD_REDUCTION_RATIO:
            best, radius = trial, min(2.0 * radius, widest)
            continue
        radius *= CHORD_STEP_FACTOR
        if reduction_ratio > 0.0:
            return trial, radius
    return best, radius
