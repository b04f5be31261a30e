"""What an inverter takes from the voltage at a constant current: the regression that R_s is told from.

    v = R_s i + V_f T s(i_abc / i_th) + v_0

V_f is one voltage for each PWM frequency (dead time grows with it), s goes from -1 to 1 with each phase's current, more
or less abruptly (R_s would err by what its shape errs), T maps phases to (alpha, beta). Nothing here knows what a
recording is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TO_PHASES = np.array([[1.0, 0.0], [-0.5, np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)]])
_TO_AB = 2.0 / 3.0 * _TO_PHASES.T


_ABRUPTNESS = (-1.0, -0.5, 0.0, 0.4, 0.7, 1.0, 1.4)


def step_ab(i_ab: Array, threshold_a: float, abruptness: float = 0.0) -> Array:
    """T s(i_abc / i_th), shape (n, 2): what one volt a phase does.

    s(x) = tanh(sinh(k x) / k) with k the abruptness, its inverse tanh(asinh(k x) / k) where that is negative: from
    x / sqrt(1 + x^2) at k = -1 over tanh at k = 0 to steps that are complete at a finite current.
    """
    x = i_ab @ _TO_PHASES.T / threshold_a
    if abruptness > 0.0:
        x = np.sinh(np.clip(abruptness * x, -30.0, 30.0)) / abruptness
    elif abruptness < 0.0:
        x = np.arcsinh(abruptness * x) / abruptness
    out: Array = np.tanh(x) @ _TO_AB.T
    return out


@dataclass(frozen=True)
class VoltageFit:
    """Result of the regression.

    Attributes
    ----------
    resistance_ohm, std_ohm, freedom
        R_s with its standard deviation and degrees of freedom.
    drift_ohm_per_s : float
        How R_s changes over the holds.
    error_v : dict
        V_f by PWM frequency; empty where too few different currents were held to tell it.
    threshold_a, abruptness : float
        Of the step.
    bias_v : array, shape (2,)
    """

    resistance_ohm: float
    std_ohm: float
    freedom: int
    drift_ohm_per_s: float
    error_v: dict[float, float]
    threshold_a: float
    abruptness: float
    bias_v: Array

    def resistive(self, i_ab: Array, v_ab: Array, pwm_hz: float) -> Array:
        """Voltage without the inverter's share, shape (n, 2)."""
        nearest = min(self.error_v, key=lambda f: abs(f - pwm_hz), default=None)
        error = self.error_v[nearest] * step_ab(i_ab, self.threshold_a, self.abruptness) if nearest is not None else 0.0
        out: Array = v_ab - self.bias_v - error
        return out


def fit_voltage(i_ab: Array, v_ab: Array, time_s: Array, pwm_hz: Array) -> VoltageFit:
    """Regress held voltages on held currents.

    Parameters
    ----------
    i_ab, v_ab : array, shape (n, 2)
    time_s, pwm_hz : array, shape (n,)

    Where different currents are few the model shrinks: no drift, no inverter, at last no bias.
    """
    from scipy.optimize import minimize_scalar

    length = np.linalg.norm(i_ab, axis=1)
    sizes = len(np.unique(np.round(length / max(length.max(), 1e-12), 2)))
    frequencies = sorted(set(pwm_hz.tolist())) if sizes >= 3 and len(i_ab) >= 6 else []
    both_ways = len(i_ab) >= 2 and bool((i_ab @ i_ab[int(np.argmax(length))] < 0).any())
    late = time_s - time_s.mean()
    columns = [i_ab.ravel()]
    if len(i_ab) >= 6 and np.ptp(late) > 0:
        columns.append((i_ab * late[:, None]).ravel())
    drifts = len(columns) > 1
    if both_ways:
        columns += [np.tile(e, len(i_ab)) for e in np.eye(2)]
    thresholds = np.geomspace(2e-3, 0.2, 24) * length.max() if frequencies else np.ones(1)

    def solve(threshold: float, abruptness: float) -> tuple[float, Array, Array]:
        step = step_ab(i_ab, threshold, abruptness)
        steps = [(step * (pwm_hz == f)[:, None]).ravel() for f in frequencies]
        design = np.stack([*columns, *steps], axis=1)
        answer = np.linalg.lstsq(design, v_ab.ravel(), rcond=None)[0]
        return float(((v_ab.ravel() - design @ answer) ** 2).sum()), answer, design

    def best_threshold(abruptness: float) -> float:
        coarse = float(min(thresholds, key=lambda t: solve(float(t), abruptness)[0]))
        near = (coarse / 1.3, coarse * 1.3)
        return float(minimize_scalar(lambda t: solve(t, abruptness)[0], bounds=near, method="bounded").x)

    threshold, abruptness = 1.0, 0.0
    if frequencies:
        shapes = [(best_threshold(k), k) for k in _ABRUPTNESS]
        threshold, abruptness = min(shapes, key=lambda shape: solve(*shape)[0])
    squares, answer, design = solve(threshold, abruptness)
    if frequencies:
        # The shape was fitted as well; its share in the errors is that of two more columns.
        sides = [((1.05 * threshold, abruptness), (threshold / 1.05, abruptness))]
        sides.append(((threshold, abruptness + 0.1), (threshold, abruptness - 0.1)))
        aside = [(solve(*up)[2] - solve(*down)[2]) @ answer for up, down in sides]
        design = np.column_stack([design, *aside])
    freedom = max(design.shape[0] - design.shape[1], 1)
    variance = squares / freedom * np.linalg.pinv(design.T @ design)[0, 0]
    bias = answer[1 + drifts : 3 + drifts] if both_ways else np.zeros(2)
    return VoltageFit(
        resistance_ohm=float(answer[0]),
        std_ohm=float(np.sqrt(variance)),
        freedom=freedom,
        drift_ohm_per_s=float(answer[1]) if drifts else 0.0,
        error_v=dict(zip(frequencies, answer[len(columns) :].tolist(), strict=True)),
        threshold_a=threshold,
        abruptness=abruptness,
        bias_v=bias,
    )
