"""Inductances at one operating point from the ripple of a rotating injection, for one capture at a time.

While the rotor stands still, dpsi/dt = v - R_s i and i = grad H(psi). Around the centre of the ripple

    i~ = H2 psi~ + 1/2 H3 psi~^2 + 1/6 H4 psi~^3,        psi~ = P - R_s Q,

with P the zero-mean primitive of the voltage (F(Omega t) of Combes, Malrait, Martin, Rouchon, "Obtaining the
current-flux relations of the saturated PMSM by signal injection") and Q that of the current. The ripple is
regressed on P, on Q and on the products of psi~, over windows of whole injection periods, in each of which a
constant and a ramp are free. R in the products is the coefficient of Q, and they are taken about the mean flux of all
windows: with dead time the mean current moves as the ripple rotates. A first pass determines both where they matter.
So neither R_s nor a voltage bias enters, any waveform will do, and the regression separates the curvature over a finite
ripple from the Hessian. H3 is a by-product: it is the slope of the inductances, and half of it shifts the mean current
away from the current at the mean flux.
Where the voltage rotates at its own frequency, P and Q differ by a quarter of a period on both axes at once: Q then is
multiplied by a known resistance. Where R exceeds omega L, Q is computed from the current that the fit itself predicts:
a noisy current would bias the inductance (errors in variables: K. Steiglitz, L. E. McBride, "A
technique for the identification of linear systems", 1965).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orchestrator.analysis._phase_loss import NO_LOSS, PhaseLoss
from orchestrator.analysis._ripple_model import model_current
from orchestrator.analysis._ripple_regression import ONE_AXIS_ERROR, SymmetricFit, symmetric_regression
from orchestrator.numerics.types import Array
from protocols import Capture, NotMeasuredError

if TYPE_CHECKING:
    from orchestrator.analysis._ripple_moments import Moments

MODEL_PASSES = 5
"""Passes of the regression on the model's own current: two suffice for 1 %, from an error of 20 %."""
MIN_POWER_RATIO = 0.05
"""Minimum power of a ripple across its axis over that along it; a rotation by an eighth of a turn gives 0.05."""
MAX_CROSS_AXIS_RATIO = 0.3
"""Maximum of this ratio for a wave along one axis: a current controller's response with cross-coupling gives up to 0.13
on simulated machines."""
MIN_TURN_RAD = 0.2
"""Rotation from a capture's first third to its last above which a wave has no fixed axis."""
MIN_LINE_POWER_RATIO = 0.01
"""Power of the weaker of a wave's two lines over the stronger's below which the vector rotates (a single line)."""


@dataclass(frozen=True)
class Ripple:
    """The saliency of one operating point in the believed dq frame.

    Attributes
    ----------
    current_dq : array, shape (2,)
        Current at the centre of the flux ripple [A], where the derivatives are taken.
    mean_current_dq : array, shape (2,)
        Mean of the measured current [A].
    hessian : array, shape (2, 2)
        Second derivatives of the energy H(psi) [A/Wb], the inverse of the inductance matrix.
    third : array, shape (4,)
        Third derivatives H_111, H_112, H_122, H_222 [A/Wb^2].
    covariance : array, shape (7, 7)
        Covariance of (H_11, H_12, H_22, H_111, H_112, H_122, H_222), from the scatter of the residual.
    flux_rms_wb : float
        rms of the flux ripple.
    frequency_hz, amplitude_v : float
        Frequency and amplitude of the injection, measured in the voltage.
    decay_per_s : float
        Slowest decay rate of a transient, R_s / L [1/s], fitted to the ripple.
    samples : int
        Number of samples used.
    """

    current_dq: Array
    mean_current_dq: Array
    hessian: Array
    third: Array
    covariance: Array
    flux_rms_wb: float
    frequency_hz: float
    amplitude_v: float
    decay_per_s: float
    samples: int


def fixed_axis_rad(v_ab: NDArray[np.floating]) -> float | None:
    """Angle of the axis of a voltage ripple, in the frame of `v_ab` of shape (n, 2); None where it rotates."""
    third = len(v_ab) // 3
    thirds = [_axis_of(section) for section in (v_ab[:third], v_ab[-third:], v_ab)] if third > 1 else []
    if not thirds or thirds[-1][1] > MAX_CROSS_AXIS_RATIO:
        return None
    return None if axis_difference_rad(thirds[0][0], thirds[1][0]) > MIN_TURN_RAD else thirds[-1][0]


def axis_difference_rad(first_rad: float, second_rad: float) -> float:
    """Angle between two axes (without direction), 0 to pi / 2 [rad]."""
    return abs((first_rad - second_rad + 0.5 * math.pi) % math.pi - 0.5 * math.pi)


def _axis_of(v_ab: NDArray[np.floating]) -> tuple[float, float]:
    """Angle of a ripple's principal axis, and its power across that axis over the power along it."""
    (across, along), vectors = np.linalg.eigh(np.cov(np.asarray(v_ab, dtype=np.float64).T))
    return math.atan2(vectors[1, 1], vectors[0, 1]), across / along if along > 0.0 else 1.0


def injection_frequency(v_ab: NDArray[np.floating], sampling_frequency_hz: float, where: str = "capture") -> float:
    """Frequency of a (rotating) periodic wave on a constant voltage [Hz].

    A wave of frequency f whose axis rotates at r has its strongest lines at +f + r and -f + r in the
    spectrum of v_alpha + j v_beta, so half their distance is f at any r. A vector that rotates at f has only one line.

    Raises
    ------
    NotMeasuredError
        Where the voltage has no such wave.
    """
    v_ab = v_ab[:16_384]  # a power of two that resolves the line as sharply as the ripple's own window
    vectors = np.ascontiguousarray(v_ab, dtype=np.float64).view(np.complex128)[:, 0]
    n = len(vectors)
    if n < 16:
        raise NotMeasuredError(where, "v_alpha, v_beta", f"{n} samples are too few to find an injection in")
    turning = np.fft.fft((vectors - vectors.mean()) * _hann(n))
    spectrum = turning.real**2 + turning.imag**2
    largest = max(1.0, float(np.abs(v_ab).max()))
    if spectrum.max() <= (1e-9 * largest * n) ** 2:
        raise NotMeasuredError(where, "v_alpha, v_beta", "no injected voltage was found")
    # The second half begins with the line at minus one bin.
    (ahead, power_ahead), (behind, power_behind) = (_peak(x) for x in (spectrum[: n // 2], spectrum[: n // 2 : -1]))
    (weaker, line), (stronger, other) = sorted([(power_ahead, ahead), (power_behind, behind + 1.0)])
    cycles = other if weaker < MIN_LINE_POWER_RATIO * stronger else 0.5 * (line + other)
    return cycles * sampling_frequency_hz / n


@lru_cache(maxsize=4)
def _hann(n: int) -> Array:
    """Hann window of n samples, cached for all captures of one length."""
    window = np.hanning(n)
    window.flags.writeable = False
    return window


def _peak(spectrum: Array) -> tuple[float, float]:
    """Frequency of the highest line in bins (parabola through the logarithms), and its power."""
    k = int(np.argmax(spectrum))
    if not 0 < k < len(spectrum) - 1:
        return float(k), float(spectrum[k])
    a, b, c = np.log(spectrum[k - 1 : k + 2] + 1e-300)
    return k + (0.5 * float((a - c) / (a - 2 * b + c)) if a - 2 * b + c else 0.0), float(spectrum[k])


def demodulate(
    capture: Capture,
    rotor_angle_rad: float,
    *,
    voltage_delay_samples: float = 0.0,
    discard_s: float | None = None,
    time_constant_s: float | None = None,
    loss: PhaseLoss = NO_LOSS,
    more_captures: Sequence[Capture] = (),
    resistance_ohm: float | None = None,
    where: str = "capture",
) -> Ripple:
    """Find the Hessian of the energy from the ripple of one injection capture, or of several of one operating point.

    Parameters
    ----------
    capture : Capture
    rotor_angle_rad : float
        Believed electrical angle of the d axis.
    voltage_delay_samples : float
        n, where v[k] acts from t_k + n Ts; need not be whole.
    discard_s : float, optional
        Time left out at the start, where the switched-on wave leaves a decaying offset. By default five
        time constants, at most a third of the capture.
    time_constant_s : float, optional
        L / R_s, for that default. Without it, it is estimated from the ripple.
    loss : PhaseLoss
        Known voltage error of the inverter. It follows the ripple where a phase current passes zero, and the inductance
        then looks too large along that phase's axis.
    more_captures : sequence of Capture
        Same point and frequency, injected along other axes: a wave with a fixed axis shows only that axis.
    resistance_ohm : float, optional
        Known resistance; required where the voltage rotates at its own frequency, as resistance and inductances are
        then not separable.
    where : str
        Name of the segment, for errors.

    Raises
    ------
    NotMeasuredError
        Where no injection is found, its axis does not rotate, or it lasts for too few periods.
    """
    captures = (capture, *more_captures)
    frequency = injection_frequency(capture.v_ab, capture.sampling_frequency_hz, where)
    if discard_s is None and time_constant_s is None:
        whole = _demodulated(
            captures, rotor_angle_rad, voltage_delay_samples, 0, frequency, loss, resistance_ohm, where
        )
        time_constant_s = 1.0 / whole.decay_per_s
    duration_s = min(len(one) for one in captures) / capture.sampling_frequency_hz
    if discard_s is None:
        discard_s = min(5.0 * (time_constant_s or 0.0), duration_s / 3.0)
    skip = round(discard_s * capture.sampling_frequency_hz)
    return _demodulated(captures, rotor_angle_rad, voltage_delay_samples, skip, frequency, loss, resistance_ohm, where)


def _demodulated(
    captures: Sequence[Capture],
    angle: float,
    delay: float,
    skip: int,
    frequency: float,
    loss: PhaseLoss,
    resistance_ohm: float | None,
    where: str,
) -> Ripple:
    # numba is imported on use, which keeps the import of this module fast
    from orchestrator.analysis._ripple_moments import pooled, ripple_moments

    rate = captures[0].sampling_frequency_hz
    first = max(skip, math.ceil(delay))
    available = min(len(capture) for capture in captures) - first
    width = _window(rate / frequency, available)
    if available < width:
        problem = f"{width} samples ({width * frequency / rate:.0f} periods) are needed, {available} are there"
        raise NotMeasuredError(where, "samples", problem)
    decaying: list[Array | None] = [None] * len(captures)

    def regress(drop_ohm: Array, centre: Array, inductance: Array) -> tuple[Moments, SymmetricFit]:
        moments = pooled(
            [
                ripple_moments(
                    capture.i_ab,
                    capture.v_ab,
                    sampling_s=1.0 / rate,
                    angle_rad=angle,
                    delay=delay,
                    first=first,
                    width=width,
                    drop_ohm=drop_ohm,
                    centre_i=centre,
                    inductance_h=inductance,
                    loss=loss,
                    decaying_i_ab=model_i_ab,
                )
                for capture, model_i_ab in zip(captures, decaying, strict=True)
            ]
        )
        across, along = np.linalg.eigvalsh(moments.normal[:2, :2])
        if across < MIN_POWER_RATIO * along:
            raise NotMeasuredError(where, "v_alpha, v_beta", ONE_AXIS_ERROR)
        freedom = moments.samples - 2 * moments.windows
        fit = symmetric_regression(moments.normal, freedom, 1.0 / rate, where, resistance_ohm)
        if not np.linalg.matrix_rank(fit.hessian, hermitian=True) == 2:
            raise NotMeasuredError(where, "i_alpha, i_beta", "the current does not follow the injection on both axes")
        return moments, fit

    drop_ohm, inductance, centre = np.zeros((2, 2)), np.zeros((2, 2)), np.zeros(2)
    for _ in range(2):
        moments, fit = regress(drop_ohm, centre, inductance)
        ripple_wb = math.sqrt((moments.normal[0, 0] + moments.normal[1, 1]) / moments.samples)
        # With a slow decay R Q is negligible in the products of the ripple ...
        slow = np.linalg.norm(fit.decay_per_s, 2) < 0.3 * frequency
        inductance = np.linalg.inv(fit.hessian).astype(np.float64)
        # ... and with a nearly constant mean current so is the centre's movement.
        still = np.linalg.norm(inductance @ moments.mean_i_rms) < 0.05 * ripple_wb
        if slow and still:
            break
        drop_ohm = np.zeros((2, 2)) if slow else inductance @ fit.decay_per_s
        centre = moments.mean_i
    if np.linalg.norm(fit.decay_per_s, 2) > 2.0 * math.pi * frequency:
        # R exceeds omega L: Q is nearly P / R, and the small difference is buried in its noise.
        measured, model = (moments, fit), fit
        for _ in range(MODEL_PASSES):
            if np.linalg.eigvals(model.decay_per_s).real.min() <= 0.0:  # the voltage is of other rows than the current
                moments, fit = measured
                break
            decaying = [model_current(capture, angle, delay, model, loss) for capture in captures]
            moments, fit = regress(inductance @ fit.decay_per_s, centre, inductance)
            inductance = np.linalg.inv(fit.hessian).astype(np.float64)
            # Half of each step: full steps oscillate.
            hessian, decay_per_s = fit.hessian + model.hessian, fit.decay_per_s + model.decay_per_s
            model = replace(fit, hessian=0.5 * hessian, decay_per_s=0.5 * decay_per_s)
    s, t = moments.mean_squares, fit.third
    shift = 0.5 * np.array([s[0] * t[0] + 2 * s[1] * t[1] + s[2] * t[2], s[0] * t[1] + 2 * s[1] * t[2] + s[2] * t[3]])
    return Ripple(
        current_dq=moments.mean_i - shift,
        mean_current_dq=moments.mean_i,
        hessian=fit.hessian,
        third=fit.third,
        covariance=fit.covariance,
        flux_rms_wb=ripple_wb,
        frequency_hz=frequency,
        amplitude_v=math.sqrt(moments.mean_v2),
        decay_per_s=max(float(np.linalg.eigvals(fit.decay_per_s).real.min()), 1e-3),
        samples=moments.samples,
    )


def _window(period: float, max_samples: int, min_periods: int = 4) -> int:
    """Samples of the shortest window of four or more periods, nearly whole; at most `max_samples`, where possible."""
    # In four a ramp is nearly orthogonal to the ripple.
    max_periods = min(10 * min_periods, math.floor(max_samples / period))
    periods = np.arange(min_periods, max(max_periods, min_periods) + 1)
    misalignment = np.abs(periods * period - np.round(periods * period)) / periods
    return round(float(periods[int(np.argmax(misalignment <= max(1e-3, misalignment.min())))] * period))
