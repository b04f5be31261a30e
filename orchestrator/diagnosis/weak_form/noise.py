"""Noise of the current sensors: estimate, propagation through effects and weak form, and whitening.

Sensor noise enters interval k through both of its samples,

    xi_k = a_k n_k + b_k n_k+1,   a_k = L_k - R Ts/2 + Ts S_k,   b_k = -(L_k+1 + R Ts/2),

with S = d v_impressed / d i_measured by the effects (an inverter's slope near zero current multiplies noise by tens of
ohms; a sensor's own error changes its noise by a few percent, which is left out). Windows of one segment share
samples: the covariance of its rows is banded, and its Cholesky factor whitens them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.diagnosis.nuisances.spectral_lines import SpectralLine, added_noise, find_lines
from orchestrator.diagnosis.weak_form.equations import LocalMap
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.diagnosis.weak_form.sensor_scatter import Scatter
from orchestrator.diagnosis.weak_form.windows import function_weights
from orchestrator.numerics.frames import rotation
from orchestrator.numerics.quieting import quieted
from orchestrator.numerics.types import Array
from protocols import ModelNoise, SegmentStage

MIN_CORRELATION: float = 0.08
"""Correlation of successive readings below which they count as white noise."""

_MAX_CORRELATION = 0.98
"""Correlation beyond which noise and a moving current are not separable."""


_SIGNIFICANCE_SIGMAS = 3.0
"""Standard deviations from zero at which a correlation is significant."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise of the current readings, estimated from the recording.

    Attributes
    ----------
    covariance : array, shape (2, 2)
        Covariance of one reading of (i_alpha, i_beta) [A^2], from holds where available.
    ripple : array, shape (2, 2)
        Covariance under injection, from repeated periods; it includes jitter and PWM ripple [A^2].
    correlation : float
        Correlation of successive readings as a first-order process.
    lines : tuple of SpectralLine
        Disturbances at fixed frequencies.
    of_model : ModelNoise
        Model-error noise in addition to the readings'.
    """

    covariance: Array
    ripple: Array
    correlation: float
    lines: tuple[SpectralLine, ...] = ()
    of_model: ModelNoise = field(default_factory=ModelNoise)

    def of(self, piece: SegmentData) -> Array:
        """Covariance of one sample of a segment (a mean of several readings), assuming independent samples [A^2]."""
        covariance = self.ripple if piece.stage is SegmentStage.INJECTION else self.covariance
        return np.asarray(covariance / piece.averaged)

    def with_quiet_current(self, piece: SegmentData) -> SegmentData:
        """A hold with its noise-free current added; other segments are returned unchanged.

        A hold's long window averages the noise. In a sweep's short windows the noise passes through the inverter's
        characteristic, which the covariance includes.
        """
        if piece.stage is not SegmentStage.RESISTANCE:
            return piece
        quiet = quieted(np.asarray(piece.signals.i_ab, dtype=np.float64), np.sqrt(np.diag(self.of(piece))))
        return replace(piece, signals=replace(piece.signals, i_quiet_ab=quiet))

    def colour(self, piece: SegmentData) -> Array:
        """Power of the noise at each mode's frequency over that of white noise, shape (modes,)."""
        w, rho = piece.windows, self.correlation
        if len(w.modes) == 1 and self.lines:
            return np.array([self._steady(piece)])
        if rho == 0.0:
            return np.ones(len(w.modes))
        turn = 2.0 * np.pi * np.array(w.orders) / max(w.period, 1.0)
        return np.asarray((1.0 - rho**2) / (1.0 - 2.0 * rho * np.cos(turn) + rho**2))

    def _steady(self, piece: SegmentData) -> float:
        """Noise power in a test function over that of white noise: correlation, and switching ripple."""
        rho, s = self.correlation, piece.signals
        motor, variance = s.motor, 0.5 * float(np.trace(self.of(piece)))
        ohm = (motor.stator_resistance_ohm if motor else None) or 1.0
        henry = (motor.d_inductance_h if motor else None) or 0.01 * ohm
        fs, step = s.sampling_frequency_hz, piece.windows.step
        more = (added_noise(x, fs, piece.averaged, step, ohm, henry, variance) for x in self.lines if x.switching)
        return (1.0 + rho) / (1.0 - rho) + sum(more)


def sensor_noise(pieces: Sequence[SegmentData]) -> SensorNoise:
    """Noise of the current readings: medians over segments, which are robust against disturbances of some.

    From holds and gates-off readings; where there are none, from trapezoids, then from steps or injection.
    """
    of = {stage: [p.scatter for p in pieces if p.stage is stage] for stage in SegmentStage}
    steady = of[SegmentStage.RESISTANCE] + of[SegmentStage.GATES_OFF] or of[SegmentStage.CLASSICAL]
    steady = steady or _quietest([s for s in of[SegmentStage.STEPS] if np.isfinite(s.covariance).all()])
    repeated = [s for s in of[SegmentStage.INJECTION] if np.isfinite(s.covariance).all()]
    rho = _correlation(steady, of[SegmentStage.GATES_OFF])
    # The variance of second differences is 6 - 8 rho + 2 rho^2 times the readings', not 6.
    seen = (6.0 - 8.0 * rho + 2.0 * rho**2) / 6.0
    covariance = _typical(steady) / seen if steady else _typical(repeated) if repeated else 1e-12 * np.eye(2)
    holds = [p for p in pieces if p.stage is SegmentStage.RESISTANCE]
    rate = holds[0].signals.sampling_frequency_hz * holds[0].averaged if holds else 0.0
    off = [x.spectrum for x in of[SegmentStage.GATES_OFF]]
    lines = find_lines([p.scatter.spectrum for p in holds], off, rate)
    return SensorNoise(covariance, _typical(repeated) if repeated else covariance, rho, lines)


def _quietest(scatters: Sequence[Scatter]) -> list[Scatter]:
    """The smallest scatter of a logged axis, as the curvature of a fast current only adds to it."""
    whole = [s for s in scatters if np.linalg.eigvalsh(s.covariance)[0] > 1e-6 * float(np.trace(s.covariance))]
    even = [replace(s, covariance=float(np.trace(s.covariance)) * np.eye(2)) for s in scatters]
    return sorted(whole or even, key=lambda s: float(np.trace(s.covariance)))[:1]


def _typical(scatters: Sequence[Scatter]) -> Array:
    covariance = np.median([s.covariance for s in scatters], axis=0)
    return np.asarray(covariance + (1e-12 + 1e-6 * float(np.trace(covariance))) * np.eye(2))


def _correlation(steady: Sequence[Scatter], off: Sequence[Scatter]) -> float:
    """rho of the readings' noise as a first-order process; 0 where it may be chance."""
    # Current control responds to noise and correlates readings, so that gates-off readings are preferred. Where their
    # rho is insignificant (white noise has 1 / sqrt(n)) and nearer to zero than to that of the holds, it is zero.
    correlated, free = ([s for s in some if math.isfinite(s.correlation)] for some in (steady, off))
    rho = float(np.median([s.correlation for s in correlated])) if correlated else 0.0
    if abs(rho) < MIN_CORRELATION:
        return 0.0
    if free:
        held, rho = rho, float(np.median([s.correlation for s in free]))
        chance = 1.0 / math.sqrt(max(sum(s.readings for s in free), 1))
        if abs(rho) < _SIGNIFICANCE_SIGMAS * chance and abs(rho) < abs(rho - held):
            return 0.0
    return min(max(rho, -_MAX_CORRELATION), _MAX_CORRELATION)


def banded_covariance(
    piece: SegmentData, local: LocalMap, resistance: Array, noise: SensorNoise, r_s: float, slopes: Array | None
) -> Array:
    """Covariance of a segment's rows in LAPACK's lower banded form, shape (bandwidth + 1, rows).

    Parameters
    ----------
    resistance : array, shape (n,)
        Resistance of the corrected signals, in units of R_s.
    slopes : array, shape (n, 2, 2), optional
        d v_impressed / d i_measured in the believed frame [ohm].
    """
    w = piece.windows
    angle = float(piece.segment.rotor_angle_rad)
    turn = rotation(-angle)
    sums = _pair_sums(
        local.inductance,
        np.ascontiguousarray(resistance),
        slopes if slopes is not None else np.zeros((0, 2, 2)),
        np.asarray(np.linalg.cholesky(turn @ noise.of(piece) @ turn.T), dtype=np.float64),
        r_s,
        1.0 / piece.signals.sampling_frequency_hz,
        w.step,
        w.test_functions,
        w.bins,
        w.n_bins,
    )
    shifted = np.stack([np.roll(w.modes, -d, axis=1) for d in (-1, 0, 1)])
    # A fixed order is nearly optimal for all sizes, and a search for one takes as long as the products.
    order = ["einsum_path", (0, 1), (0, 1)]
    blocks = np.einsum("hb,dgb,jtbdxy->jthxgy", w.modes, shifted, sums, optimize=order)
    size = 2 * len(w.modes)
    root = np.repeat(np.sqrt(noise.colour(piece)), 2)
    blocks = blocks.reshape(w.test_functions, 2, size, size) * np.outer(root, root)
    return _banded(blocks if w.unread is None else _decoupled(blocks, w.unread))


def _decoupled(blocks: Array, axis: int) -> Array:
    """The blocks with one axis' rows uncorrelated with the other's, and with its variances."""
    blocks = blocks.copy()
    mine, other = np.arange(axis, blocks.shape[-1], 2), np.arange(1 - axis, blocks.shape[-1], 2)
    blocks[:, :, mine, :] = 0.0
    blocks[:, :, :, mine] = 0.0
    blocks[:, 0, mine, mine] = blocks[:, 0, other, other]
    return blocks


def _banded(blocks: Array) -> Array:
    """Block-tridiagonal (test_functions, 2, size, size), diagonal and next block, to lower banded form."""
    test_functions, _, size, _ = blocks.shape
    out = np.zeros((2 * size, test_functions, size))
    for column in range(size):
        out[: size - column, :, column] = blocks[:, 0, column, column:].T
        # blocks[j, 1] couples test functions j (rows) and j + 1 (columns): its transpose is below the diagonal.
        out[size - column : 2 * size - column, :-1, column] = blocks[:-1, 1, column, :].T
    return out.reshape(2 * size, test_functions * size)


@dataclass(frozen=True)
class Whitener:
    """Transforms rows of one segment to independent unit noise.

    Attributes
    ----------
    variance : array, shape (rows,)
        Variance of every row before whitening.
    factor : array, shape (bandwidth + 1, rows)
        Cholesky factor of the banded covariance, without common errors, in LAPACK's lower banded form.
    log_det : float
        Log determinant of the whole covariance.
    directions : array, shape (rows, few)
        Orthonormal directions of common errors, whitened.
    less : array, shape (few,)
        Scale along each direction minus one.
    """

    variance: Array
    factor: Array
    log_det: float
    directions: Array
    less: Array

    @classmethod
    def of(cls, covariance: Array, common: Array | None = None) -> Whitener:
        """A whitener for a covariance and common errors.

        Parameters
        ----------
        covariance : array, shape (bandwidth + 1, rows)
            Covariance of the rows in LAPACK's lower banded form.
        common : array, shape (rows, few), optional
            Change of the rows by one standard deviation of each common error. With U whitened, (1 + U U^T)^-1/2
            differs from one only along the few directions of U.
        """
        factor = _factored(covariance)
        log_det = 2.0 * float(np.log(factor[0]).sum())
        directions, less = np.zeros((covariance.shape[1], 0)), np.zeros(0)
        if common is not None:
            directions, sizes, _ = np.linalg.svd(_independent(factor, common), full_matrices=False)
            less = 1.0 / np.sqrt(1.0 + sizes**2) - 1.0
            log_det += float(np.log1p(sizes**2).sum())
        return cls(covariance[0].copy(), factor, log_det, directions, less)

    def __call__(self, rows: Array) -> Array:
        """Whiten (rows,) or (rows, columns)."""
        white = _independent(self.factor, rows)
        if self.less.size:
            white += self.directions @ (self.less * (self.directions.T @ white).T).T
        return white


def _independent(factor: Array, rows: Array) -> Array:
    """Rows whitened by the banded covariance's factor."""
    from scipy.linalg.lapack import dtbtrs

    if rows.size == 0:
        # LAPACK's wrapper fails on a matrix without columns.
        return rows.copy()
    solved, info = dtbtrs(factor, rows if rows.ndim == 2 else rows[:, None], uplo="L")
    if info != 0:
        raise ArithmeticError("the noise covariance is singular")
    return np.asarray(solved if rows.ndim == 2 else solved[:, 0])


def _factored(covariance: Array) -> Array:
    """Cholesky factor of a covariance in lower banded form; off-diagonals shrink where it is indefinite."""
    from scipy.linalg import cholesky_banded

    banded = covariance.copy()
    banded[0] *= 1.0 + 1e-9
    for shared in (1.0, 0.9, 0.7, 0.4):
        banded[1:] = shared * covariance[1:]
        try:
            return np.asarray(cholesky_banded(banded, lower=True, check_finite=False))
        except np.linalg.LinAlgError:
            continue
    banded[1:] = 0.0
    return np.asarray(cholesky_banded(banded, lower=True, check_finite=False))


@njit(cache=True, nogil=True)
def _pair_sums(
    inductance: Array,
    resistance: Array,
    voltage_slope: Array,
    sensor_factor: Array,
    r_s: float,
    ts: float,
    step: float,
    test_functions: int,
    bins: NDArray[np.int64],
    n_bins: int,
) -> Array:
    """sum_k g_mk Sigma g_m'k^T by bins, shape (test_functions, same/next function, bins, bin -1/0/+1, 2, 2)."""
    n = inductance.shape[0]
    out = np.zeros((test_functions, 2, n_bins, 3, 2, 2))
    function = np.empty(4, dtype=np.int64)
    slot = np.empty(4, dtype=np.int64)
    g = np.empty((4, 2, 2))
    a = np.empty((2, 2))
    b = np.empty((2, 2))
    last_j = 0
    last_w0 = 0.0
    last_w1 = 0.0
    for k in range(n):
        ohm = 0.5 * ts * r_s * resistance[k]
        a[0, 0] = inductance[k, 0] - ohm
        a[0, 1] = inductance[k, 1]
        a[1, 0] = inductance[k, 1]
        a[1, 1] = inductance[k, 2] - ohm
        b[0, 0] = -inductance[k, 0] - ohm
        b[0, 1] = -inductance[k, 1]
        b[1, 0] = -inductance[k, 1]
        b[1, 1] = -inductance[k, 2] - ohm
        if voltage_slope.shape[0] > 0:
            for x in range(2):
                for y in range(2):
                    a[x, y] += ts * voltage_slope[k, x, y]
        j = 0
        w0 = 0.0
        w1 = 0.0
        if k < n - 1:
            j, w0, w1 = function_weights(k, step, test_functions)
        used = 0
        if k > 0 and k < n - 1 and j == last_j and bins[k] == bins[k - 1]:
            for side in range(2):
                now = w0 if side == 0 else w1
                was = last_w0 if side == 0 else last_w1
                if now == 0.0 and was == 0.0:
                    continue
                function[used], slot[used] = j + side, bins[k]
                for x in range(2):
                    for y in range(2):
                        g[used, x, y] = now * a[x, y] + was * b[x, y]
                used += 1
        else:
            for side in range(4):
                weight = w0 if side == 0 else (w1 if side == 1 else (last_w0 if side == 2 else last_w1))
                if weight == 0.0 or (side >= 2 and k == 0):
                    continue
                function[used] = j + side if side < 2 else last_j + side - 2
                slot[used] = bins[k] if side < 2 else bins[k - 1]
                for x in range(2):
                    for y in range(2):
                        g[used, x, y] = weight * (a[x, y] if side < 2 else b[x, y])
                used += 1
        last_j, last_w0, last_w1 = j, w0, w1
        for e in range(used):
            for x in range(2):
                p0, p1 = g[e, x, 0], g[e, x, 1]
                for y in range(2):
                    g[e, x, y] = p0 * sensor_factor[0, y] + p1 * sensor_factor[1, y]
        for e in range(used):
            for f in range(used):
                t = function[f] - function[e]
                if t < 0 or t > 1:
                    continue
                d = slot[f] - slot[e]
                if d > 1:
                    d -= n_bins
                elif d < -1:
                    d += n_bins
                if d < -1 or d > 1:
                    continue
                for x in range(2):
                    for y in range(2):
                        out[function[e], t, slot[e], d + 1, x, y] += g[e, x, 0] * g[f, y, 0] + g[e, x, 1] * g[f, y, 1]
    return out
