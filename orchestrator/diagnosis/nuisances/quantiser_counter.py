"""A modulator's timer that counts from the carrier's turning points: one parameter determines step and all phases.

An edge of a leg at half the bus is a quarter of the carrier's period from a turning point. In timer steps this is

    n = 1 / (4 f_pwm t_q),    rise = r - n,    fall = s + n    (mod 1),

with r and s 0 for truncation and 1/2 for rounding of a part of a step. Where one comparison of an up-down counter makes
both edges, both have the same phase,

    rise = fall = r - n    or    rise = fall = r + n    (mod 1),

as the leg is on below or above the compare value (the ePWM of TI's SPRU791, where n is an integer, as the carrier is
derived from the clock). So phases at one PWM frequency determine the step to about 1e-6, and all other phases.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from orchestrator.diagnosis.nuisances.pwm_quantiser import QuantiserEstimate
from orchestrator.numerics.types import Array
from protocols import TimerPhases

ROUNDING_OFFSETS = (0.0, 0.5)
MAX_PHASE_MISMATCH = 0.1
"""Largest difference of n from the two edges' phases with separate comparisons, in steps."""
MAX_PHASE_MISMATCH_OF_ONE_COMPARISON = 0.25
"""The same with one comparison, where the readings hardly separate two equal phases, in steps."""
SCAN_HALF_WIDTH_STEPS = 0.12
"""Half width of the search range around the mean n, in steps."""
SCAN_SPACING_STEPS = 0.02
"""Spacing of the values tried before a descent, as rounding is discontinuous, in steps."""
TOLERANCE_STEPS = 1e-4
"""Tolerance of the descent, in steps."""
TWO_COMPARISONS = (-1, 1)
ONE_COMPARISON = (-1, -1), (1, 1)
"""The signs of n in the phases of the rising and of the falling edge."""


@dataclass(frozen=True)
class CounterModel:
    """Timers of one kind of counter, parametrised by the steps in a quarter of the carrier's period.

    Attributes
    ----------
    estimate : QuantiserEstimate
        Reference of the differences x.
    pwm_hz : float
        PWM frequency of that carrier.
    count : float
        Number of steps from the phases there.
    rise, fall : float
        r and s: 0 for truncation, 1/2 for rounding.
    ways : pair of -1 or 1
        Sign of n in each phase.
    """

    estimate: QuantiserEstimate
    pwm_hz: float
    count: float
    rise: float
    fall: float
    ways: tuple[int, int] = TWO_COMPARISONS

    def at(self, more: float) -> Array:
        """Argument of `QuantiserEstimate.moved` for `more` steps above `count`."""
        step_s = 1.0 / (4.0 * self.pwm_hz * (self.count + more))
        timer = self.estimate.timer
        phases = tuple(self._phases(p.pwm_frequency_hz, step_s) for p in timer.phases)
        return self.estimate.to(timer.model_copy(update={"step_s": step_s, "phases": phases}))

    def likeliest(self, cost: Callable[[Array], float]) -> Array:
        """Minimum of a cost near `count`."""
        from scipy.optimize import minimize_scalar

        def cost_at(more: float) -> float:
            return cost(self.at(more))

        best = min(
            np.arange(
                -SCAN_HALF_WIDTH_STEPS, SCAN_HALF_WIDTH_STEPS + 0.5 * SCAN_SPACING_STEPS, SCAN_SPACING_STEPS
            ).tolist(),
            key=cost_at,
        )
        bounds = (best - SCAN_SPACING_STEPS, best + SCAN_SPACING_STEPS)
        found = minimize_scalar(cost_at, bounds=bounds, method="bounded", options={"xatol": TOLERANCE_STEPS})
        return self.at(float(found.x) if found.fun < cost_at(best) else best)

    def _phases(self, pwm_hz: float, step_s: float) -> TimerPhases:
        count, (rising, falling) = 1.0 / (4.0 * pwm_hz * step_s), self.ways
        rise, fall = (self.rise + rising * count) % 1.0, (self.fall + falling * count) % 1.0
        return TimerPhases(pwm_frequency_hz=pwm_hz, rise=rise, fall=fall)


def counter_models(estimate: QuantiserEstimate, x: Array) -> list[CounterModel]:
    """Counter models that agree with the timer at `x` at the PWM frequency with the best-known phases.

    At a single PWM frequency only those with one comparison, as with two the model adds no constraint.
    """
    timer = estimate.moved(x)
    best = timer.phases[int(np.argmax(np.diag(estimate.curvature)[1:].reshape(-1, 2).sum(axis=1)))]
    roughly = 1.0 / (4.0 * best.pwm_frequency_hz * timer.step_s)
    kinds = [
        (part, part, ways, MAX_PHASE_MISMATCH_OF_ONE_COMPARISON) for part in ROUNDING_OFFSETS for ways in ONE_COMPARISON
    ]
    if len(timer.phases) > 1:
        kinds += [
            (rise, fall, TWO_COMPARISONS, MAX_PHASE_MISMATCH) for rise, fall in product(ROUNDING_OFFSETS, repeat=2)
        ]
    found = []
    for rise, fall, ways, unlike in kinds:
        by_rise, by_fall = ways[0] * (best.rise - rise), ways[1] * (best.fall - fall)
        difference = _nearest(by_rise - by_fall)
        if abs(difference) <= unlike:
            count = roughly + _nearest(by_fall + 0.5 * difference - roughly)
            found.append(CounterModel(estimate, best.pwm_frequency_hz, count, rise, fall, ways))
    return found


def _nearest(part: float) -> float:
    """A number reduced to -1/2 ... 1/2 modulo 1."""
    return (part + 0.5) % 1.0 - 0.5
