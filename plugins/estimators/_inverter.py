"""The inverter's voltage loss at a constant current: the regression that gives R_s.

    v = R_s i + V_f T s(i_abc / i_th) + v_0

V_f is one voltage for each PWM frequency (dead time grows with it). s goes from -1 to 1 with each phase's current; its
abruptness is fitted, since an error of its shape biases R_s. T maps phases to (alpha, beta). R_s drifts linearly plus a
random walk of estimated variance; the estimate is its mean over the instants of strong currents.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.numerics.frames import from_phases, to_phases
from orchestrator.numerics.random_walk import Walk, no_walk, random_walk
from orchestrator.numerics.types import Array
from protocols import InverterLoss

THRESHOLD_RATIOS = 2e-3, 0.2
"""Range of the step's threshold over the largest current."""
ABRUPTNESS_STEP = 0.2
"""Finite-difference step of the abruptness."""
THRESHOLD_STD_STEPS = math.log(THRESHOLD_RATIOS[1] / THRESHOLD_RATIOS[0]) / (2.0 * math.log(1.05) * math.sqrt(12.0))
"""Standard deviation of a log-uniform threshold in this range, in units of the 10 % step of `_shape_gradients`."""


def step_ab(i_ab: Array, threshold_a: float, abruptness: float = 0.0) -> Array:
    """T s(i_abc / i_th), shape (n, 2): the voltage vector of a loss of one volt per phase.

    s(x) = tanh(sinh(k x) / k) with k the abruptness, its inverse tanh(asinh(k x) / k) where that is negative: from
    x / sqrt(1 + x^2) at k = -1 over tanh at k = 0 to steps that are complete at a finite current.
    """
    x = to_phases(i_ab) / threshold_a
    if abruptness > 0.0:
        x = np.sinh(np.clip(abruptness * x, -30.0, 30.0)) / abruptness
    elif abruptness < 0.0:
        x = np.arcsinh(abruptness * x) / abruptness
    return from_phases(np.tanh(x))


@dataclass(frozen=True)
class VoltageFit:
    """Result of the regression.

    Attributes
    ----------
    resistance_ohm, std_ohm, freedom
        Mean of R_s over the instants of strong currents, with its standard deviation and degrees of freedom.
    drift_ohm_per_s : float
        Linear drift of R_s over the holds.
    error_v : dict
        V_f by PWM frequency; empty where too few different currents were held to identify it.
    threshold_a, abruptness : float
        Shape of the step s.
    bias_v : array, shape (2,)
    noise_v : float
        Standard deviation of a held voltage's residual.
    loss_covariance : array, shape (k, k)
        Covariance of bias (2, where estimated), V_f and the step's two parameters: the readings' common error.
    biased : bool
        Whether the bias was estimated.
    unlike_step_v : float
        rms residual of the held voltages with the best step, where no step fits: no loss is then subtracted
        (`error_v` is empty). Zero where a step fits.
    with_step_ohm : float
        R_s with the best step subtracted, where none fits; the true value lies between this and `resistance_ohm`.
    """

    resistance_ohm: float
    std_ohm: float
    freedom: int
    drift_ohm_per_s: float
    error_v: dict[float, float]
    threshold_a: float
    abruptness: float
    bias_v: Array
    noise_v: float
    loss_covariance: Array
    biased: bool
    unlike_step_v: float = 0.0
    with_step_ohm: float = 0.0

    def resistive(self, i_ab: Array, v_ab: Array, pwm_hz: float) -> Array:
        """Voltage minus the inverter's loss, shape (n, 2)."""
        out: Array = v_ab - self.lost(i_ab, pwm_hz)
        return out

    def lost(self, i_ab: Array, pwm_hz: float) -> Array:
        """Inverter's voltage loss at these currents, shape (n, 2) [V]."""
        volts, shape = self._volts(pwm_hz), (self.threshold_a, self.abruptness)
        out: Array = self.bias_v + (volts * step_ab(i_ab, *shape) if volts else np.zeros_like(i_ab))
        return out

    def losses(self) -> Iterator[InverterLoss]:
        """V_f of each PWM frequency, with its standard deviation."""
        std = np.sqrt(np.maximum(np.diag(self.loss_covariance), 0.0))[2 if self.biased else 0 :].tolist()
        for (pwm_hz, volts), spread in zip(self.error_v.items(), std, strict=False):
            yield InverterLoss(pwm_frequency_hz=pwm_hz, phase_v=volts, std_v=spread)

    def lost_std(self, i_ab: Array, pwm_hz: float, along: Array) -> float:
        """Standard deviation of the mean of `lost` over the currents, along a unit vector [V]."""
        rows = [*np.eye(2)] if self.biased else []
        if self.error_v:
            volts, nearest = self._volts(pwm_hz), self._nearest(pwm_hz)
            step = step_ab(i_ab, self.threshold_a, self.abruptness).mean(axis=0)
            rows += [step if f == nearest else np.zeros(2) for f in self.error_v]
            rows += [volts * g.mean(axis=0) for g in _shape_gradients(i_ab, self.threshold_a, self.abruptness)]
        if not rows:
            return 0.0
        gradient: Array = np.array(rows) @ along
        return float(np.sqrt(max(float(gradient @ self.loss_covariance @ gradient), 0.0)))

    def _nearest(self, pwm_hz: float) -> float | None:
        return min(self.error_v, key=lambda f: abs(f - pwm_hz), default=None)

    def _volts(self, pwm_hz: float) -> float:
        nearest = self._nearest(pwm_hz)
        return 0.0 if nearest is None else self.error_v[nearest]


def _shape_gradients(i_ab: Array, threshold: float, abruptness: float) -> list[Array]:
    """Change of the step for 10 % of its threshold and for `ABRUPTNESS_STEP`, shape (n, 2) each."""
    return [
        step_ab(i_ab, 1.05 * threshold, abruptness) - step_ab(i_ab, threshold / 1.05, abruptness),
        step_ab(i_ab, threshold, abruptness + 0.5 * ABRUPTNESS_STEP)
        - step_ab(i_ab, threshold, abruptness - 0.5 * ABRUPTNESS_STEP),
    ]


@dataclass(frozen=True)
class _HoldRegression:
    """Regression of held voltages: columns of R_s, its drift and the bias, extended by those of the inverter."""

    i_ab: Array
    target: Array
    columns: list[Array]
    pwm_rows: list[Array]
    """Indicator of the rows of each PWM frequency, shape (2n,)."""
    walk: Walk

    def design(self, shape: tuple[float, float]) -> Array:
        if not self.pwm_rows:
            return np.stack(self.columns, axis=1)
        step = step_ab(self.i_ab, *shape).ravel()
        return np.stack([*self.columns, *(step * rows for rows in self.pwm_rows)], axis=1)

    def misfit(self, shape: tuple[float, float]) -> float:
        return self.walk.solve(self.design(shape), self.target)[0]

    def best_shape(self, largest: float, abruptness: Sequence[float]) -> tuple[float, float]:
        """Threshold and abruptness with the smallest residual."""
        if not self.pwm_rows:
            return 1.0, 0.0
        return min(((self._best_threshold(largest, k), k) for k in abruptness), key=self.misfit)

    def residual_beside_step_v(self, shape: tuple[float, float]) -> float:
        """Rms residual beside the step, the drift and a full matrix between voltage and current [V].

        The matrix accounts for unequal sensor gains, which do not contradict a step.
        """
        alpha, beta = self.i_ab.T
        matrix = [np.stack(pair, axis=1).ravel() for pair in ((alpha, -beta), (beta, alpha), (-beta, alpha))]
        design = np.column_stack([self.design(shape), *matrix])
        size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        solution, _, rank, _ = np.linalg.lstsq(design / size, self.target, rcond=1e-9)
        residual = self.target - (design / size) @ solution
        return math.sqrt(float(residual @ residual) / max(len(residual) - int(rank), 1))

    def _best_threshold(self, largest: float, abruptness: float) -> float:
        from scipy.optimize import minimize_scalar

        thresholds = np.geomspace(*THRESHOLD_RATIOS, 24) * largest
        coarse = float(min(thresholds, key=lambda t: self.misfit((float(t), abruptness))))
        bracket = (coarse / 1.3, coarse * 1.3)
        return float(minimize_scalar(lambda t: self.misfit((t, abruptness)), bounds=bracket, method="bounded").x)


def _jumps(time_s: Array, long_gap: float) -> list[Array]:
    """Step columns at long gaps between holds, which decouple the drift before a gap from that after it."""
    gaps = np.diff(np.sort(time_s))
    long = np.flatnonzero(gaps > long_gap * np.median(gaps))
    return [(time_s > np.sort(time_s)[k]).astype(np.float64) for k in long[: len(time_s) // 6]]


def fit_voltage(
    i_ab: Array,
    v_ab: Array,
    time_s: Array,
    pwm_hz: Array,
    heat: Array | None = None,
    *,
    own_std_v: float = 0.0,
    strong_current_ratio: float = 0.2,
    long_gap: float = 8.0,
    unlike_share: float = 0.01,
    unlike_stds: float = 4.0,
    abruptness: Sequence[float] = (-1.0, -0.5, 0.0, 0.4, 0.7, 1.0, 1.4),
) -> VoltageFit:
    """Regress held voltages on held currents.

    Parameters
    ----------
    i_ab, v_ab : array, shape (n, 2)
    time_s, pwm_hz : array, shape (n,)
    heat : array, shape (n,), optional
        Heat that the currents have brought into the winding, in any unit: R_s may rise with it.
    own_std_v : float
        Standard deviation of a held voltage by its noise [V].
    strong_current_ratio : float
        Current over the largest one, below which a hold does not count towards the mean R_s.
    long_gap : float
        Gap over the median time between holds from which on R_s may jump (the winding cools).
    unlike_share, unlike_stds : float
        The step is rejected where the rms residual exceeds both this share of the largest resistive voltage and this
        multiple of `own_std_v`.
    abruptness : sequence of float
        Values of the step's abruptness that are tried, closer than noise can resolve.

    With fewer different currents the model is reduced: no drift, no inverter, at last no bias.
    """
    length = np.linalg.norm(i_ab, axis=1)
    largest = float(length.max())
    strong = length > strong_current_ratio * largest
    sizes = len(np.unique(np.round(length / max(largest, 1e-12), 2)))
    frequencies = sorted(set(pwm_hz.tolist())) if sizes >= 3 and len(i_ab) >= 6 else []
    is_biased = len(i_ab) >= 2 and bool((i_ab @ i_ab[int(np.argmax(length))] < 0).any())
    offset_s = time_s - time_s[strong].mean()
    columns = [i_ab.ravel()]
    drifts = len(i_ab) >= 6 and np.ptp(offset_s) > 0
    if drifts:
        drift_terms = [offset_s, *([] if heat is None else [heat]), *_jumps(time_s, long_gap)]
        columns += [(i_ab * (one - one[strong].mean())[:, None]).ravel() for one in drift_terms]
    loss_start = len(columns)
    if is_biased:
        columns += [np.tile(e, len(i_ab)) for e in np.eye(2)]
    model = _HoldRegression(
        i_ab=i_ab,
        target=v_ab.ravel(),
        columns=columns,
        pwm_rows=[np.repeat(pwm_hz == f, 2).astype(np.float64) for f in frequencies],
        walk=no_walk(v_ab.size),
    )
    shape = model.best_shape(largest, abruptness)
    residual_v = model.residual_beside_step_v(shape) if frequencies else 0.0
    with_step_ohm = float(model.walk.solve(model.design(shape), model.target)[1][0])
    unlike = residual_v > max(unlike_share * largest * abs(with_step_ohm), unlike_stds * own_std_v)
    if unlike:
        # A random walk of R_s would absorb the residual and give a narrow interval about a wrong R_s.
        frequencies, model, shape = [], replace(model, pwm_rows=[]), (1.0, 0.0)
    elif drifts:
        model = replace(model, walk=random_walk(offset_s, i_ab, strong).likeliest(model.design(shape), model.target))
        shape = model.best_shape(largest, abruptness)
        model = replace(model, walk=model.walk.likeliest(model.design(shape), model.target))
    squares, solution = model.walk.solve(model.design(shape), model.target)
    # The step's shape was fitted as well: two more columns account for its error.
    errors_v = zip(solution[len(columns) :], model.pwm_rows, strict=True)
    volts = sum((v * rows for v, rows in errors_v), np.zeros(v_ab.size))
    gradients = [volts * gradient.ravel() for gradient in _shape_gradients(i_ab, *shape)] if frequencies else []
    design = np.column_stack([model.design(shape), *gradients])
    freedom = max(round(design.shape[0] - design.shape[1] - model.walk.freedom), 1)
    variance = squares / max(design.shape[0] - design.shape[1], 1)
    # With hardly any inverter loss the readings do not determine its shape: a prior does.
    known = np.zeros(design.shape[1])
    if gradients:
        known[-2:] = (
            variance / np.array([THRESHOLD_STD_STEPS, np.ptp(abruptness) / (ABRUPTNESS_STEP * math.sqrt(12.0))]) ** 2
        )
    covariance = variance * model.walk.covariance(design, known)
    losses = slice(loss_start, None)
    return VoltageFit(
        resistance_ohm=float(solution[0]),
        std_ohm=float(np.sqrt(max(covariance[0, 0], 0.0))),
        freedom=freedom,
        drift_ohm_per_s=float(solution[1]) if drifts else 0.0,
        error_v=dict(zip(frequencies, solution[len(columns) :].tolist(), strict=True)),
        threshold_a=shape[0],
        abruptness=shape[1],
        bias_v=solution[loss_start : loss_start + 2] if is_biased else np.zeros(2),
        noise_v=float(np.sqrt(variance)),
        loss_covariance=covariance[losses, losses],
        biased=is_biased,
        unlike_step_v=residual_v if unlike else 0.0,
        with_step_ohm=with_step_ohm if unlike else 0.0,
    )
