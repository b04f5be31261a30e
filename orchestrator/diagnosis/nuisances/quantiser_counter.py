"""A modulator's timer that counts from where the carrier turns: one number tells its step and all its phases.

An edge of a leg at half the bus is a quarter of the carrier's period from either turn. In steps of the timer these are

    n = 1 / (4 f_pwm t_q),    rise = r - n,    fall = s + n    (mod 1),

with r and s what the counter does with a part of a step: 0 where it is cut off, 1/2 where it is rounded. Where one
comparison of an up-down counter makes both edges, both have the same phase,

    rise = fall = r - n    or    rise = fall = r + n    (mod 1),

as the leg is on below what is compared, or above. (The ePWM of TI's SPRU791, where n is whole, for the carrier is made
of the clock.) So phases at one PWM frequency tell the step to some millionths, and the phases at all others.
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
"""Of a step: by how much what two edges say of n may differ, each with a comparison of its own."""
MAX_PHASE_MISMATCH_OF_ONE_COMPARISON = 0.25
"""The same at one comparison: readings hardly tell two phases that are the same from two about them."""
SCAN_HALF_WIDTH_STEPS = 0.12
"""Of a step: how far about what they say on the mean n is looked for."""
SCAN_SPACING_STEPS = 0.02
"""Of a step, from one that is tried to the next, before a descent: commands jump."""
TOLERANCE_STEPS = 1e-4
"""Of a step."""
TWO_COMPARISONS = (-1, 1)
ONE_COMPARISON = (-1, -1), (1, 1)
"""The signs of n in the phases of the rising and of the falling edge."""


@dataclass(frozen=True)
class CounterModel:
    """Timers that count alike, by how many steps there are in a quarter of the carrier's period.

    Attributes
    ----------
    estimate : QuantiserEstimate
        From which differences are taken.
    pwm_hz : float
        Of that carrier.
    count : float
        As the phases there tell it.
    rise, fall : float
        What the counter does with a part of a step.
    ways : pair of -1 or 1
        The sign of n in either phase.
    """

    estimate: QuantiserEstimate
    pwm_hz: float
    count: float
    rise: float
    fall: float
    ways: tuple[int, int] = TWO_COMPARISONS

    def at(self, more: float) -> Array:
        """With so many steps more than the phases tell: what `QuantiserEstimate.moved` takes."""
        step_s = 1.0 / (4.0 * self.pwm_hz * (self.count + more))
        timer = self.estimate.timer
        phases = tuple(self._phases(p.pwm_frequency_hz, step_s) for p in timer.phases)
        return self.estimate.to(timer.model_copy(update={"step_s": step_s, "phases": phases}))

    def likeliest(self, cost: Callable[[Array], float]) -> Array:
        """Where a cost is least, near what the phases tell."""
        from scipy.optimize import minimize_scalar

        def there(more: float) -> float:
            return cost(self.at(more))

        best = min(
            np.arange(
                -SCAN_HALF_WIDTH_STEPS, SCAN_HALF_WIDTH_STEPS + 0.5 * SCAN_SPACING_STEPS, SCAN_SPACING_STEPS
            ).tolist(),
            key=there,
        )
        bounds = (best - SCAN_SPACING_STEPS, best + SCAN_SPACING_STEPS)
        found = minimize_scalar(there, bounds=bounds, method="bounded", options={"xatol": TOLERANCE_STEPS})
        return self.at(float(found.x) if found.fun < there(best) else best)

    def _phases(self, pwm_hz: float, step_s: float) -> TimerPhases:
        count, (rising, falling) = 1.0 / (4.0 * pwm_hz * step_s), self.ways
        rise, fall = (self.rise + rising * count) % 1.0, (self.fall + falling * count) % 1.0
        return TimerPhases(pwm_frequency_hz=pwm_hz, rise=rise, fall=fall)


def counter_models(estimate: QuantiserEstimate, x: Array) -> list[CounterModel]:
    """The timers that count, and have about the phases of the one at `x` where the readings tell them best.

    At a single PWM frequency only those of one comparison: for two, the phases are as well known without.
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
        apart = _nearest(by_rise - by_fall)
        if abs(apart) <= unlike:
            count = roughly + _nearest(by_fall + 0.5 * apart - roughly)
            found.append(CounterModel(estimate, best.pwm_frequency_hz, count, rise, fall, ways))
    return found


def _nearest(part: float) -> float:
    """From -1/2 to 1/2, whole numbers taken off."""
    return (part + 0.5) % 1.0 - 0.5
