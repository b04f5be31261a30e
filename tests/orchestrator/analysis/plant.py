"""A motor for tests of the analysis: integrates dpsi/dt = v - R_s i for many operating points side by side.

Its own few lines, sharing nothing with what they test. Vectors are rows of (points, 2) arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocols import Capture

Array = NDArray[np.float64]
CurrentOf = Callable[[Array], Array]

SAMPLING_HZ = 10_000.0
L_D, L_Q, R_S = 0.043, 0.069, 4.3


def linear_current(psi: Array, l_d: float = L_D, l_q: float = L_Q) -> Array:
    """grad H for constant inductances, no magnet."""
    out: Array = psi / np.array([l_d, l_q])
    return out


def saturated_current(psi: Array) -> Array:
    """grad H of H = x^2/2L_d + y^2/2L_q + 9 x^3 + 6 x y^2 + 40 x^4 + 40 x^2 y^2 + 50 y^4, even in y."""
    # Some hundred thousand times in a suite: products, for numpy's powers take five times as long.
    x, y = psi[..., 0], psi[..., 1]
    xx, yy = x * x, y * y
    out: Array = np.empty_like(psi)
    out[..., 0] = x * (1 / L_D + 27 * x + 160 * xx + 80 * yy) + 6 * yy
    out[..., 1] = y * (1 / L_Q + 12 * x + 80 * xx + 200 * yy)
    return out


def saturated_hessian(psi: Array) -> Array:
    """Its second derivatives, shape (..., 2, 2)."""
    x, y = psi[..., 0], psi[..., 1]
    dd = 1 / L_D + 54 * x + 12 * 0 * y + 480 * x**2 + 80 * y**2
    dq = 12 * y + 160 * x * y
    qq = 1 / L_Q + 12 * x + 80 * x**2 + 600 * y**2
    return np.stack([np.stack([dd, dq], -1), np.stack([dq, qq], -1)], -2)


def flux_for(current: Array, current_of: CurrentOf) -> Array:
    """Flux at given currents, by Newton's method with differences."""
    psi: Array = np.array(current, dtype=np.float64) * np.array([L_D, L_Q]) * 0.7
    for _ in range(40):
        miss = current - current_of(psi)
        columns = [(current_of(psi + e) - current_of(psi - e)) / 2e-6 for e in 1e-6 * np.eye(2)]
        psi = psi + 0.8 * np.linalg.solve(np.stack(columns, axis=-1), miss[..., None])[..., 0]
    return psi


@dataclass
class Run:
    """Samples of all points: arrays of shape (time, points, 2), dq frame."""

    i_dq: Array
    v_dq: Array
    psi_dq: Array


def rotated(x: Array, angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * x[..., 0] - s * x[..., 1], s * x[..., 0] + c * x[..., 1]], axis=-1)


def integrate_motor(
    voltage: Callable[[int, Array], Array],
    psi: Array,
    steps: int,
    current_of: CurrentOf,
    *,
    resistance: float = R_S,
    substeps: int = 1,
    acts: Callable[[Array, Array], Array] = lambda v, _i: v,
) -> Run:
    """March `steps` samples on with the classical Runge-Kutta method, the voltage held over each.

    `voltage` gives the commanded voltage from the sample's number and its current, `acts` what of it the
    motor gets at a current.
    """
    h = 1.0 / SAMPLING_HZ / substeps
    i_out, v_out, psi_out = (np.empty((steps, *psi.shape)) for _ in range(3))
    i = current_of(psi)
    for k in range(steps):
        v = voltage(k, i)
        i_out[k], v_out[k], psi_out[k] = i, v, psi

        def rate(now: Array, v: Array = v) -> Array:
            return acts(v, now) - resistance * now

        for _ in range(substeps):
            a = rate(i)
            b = rate(current_of(psi + 0.5 * h * a))
            c = rate(current_of(psi + 0.5 * h * b))
            d = rate(current_of(psi + h * c))
            psi = psi + h / 6.0 * (a + 2.0 * (b + c) + d)
            i = current_of(psi)
    return Run(i_out, v_out, psi_out)


def injection_voltage(
    base: Array, amplitude: float, frequency: float, rotation: float, waveform: str = "square"
) -> Callable[[int, Array], Array]:
    """A rotating wave on constant voltages, (points, 2)."""

    def voltage(k: int, _i: Array) -> Array:
        t = k / SAMPLING_HZ
        phase = frequency * t + 1e-9
        wave = (1.0 if phase % 1.0 < 0.5 else -1.0) if waveform == "square" else np.sin(2 * np.pi * phase)
        turn = 2 * np.pi * rotation * t
        return base + amplitude * wave * np.array([np.cos(turn), np.sin(turn)])

    return voltage


def capture_of(
    run: Run,
    point: int,
    *,
    angle: float = 0.0,
    start_s: float = 0.0,
    noise_a: float = 0.0,
    delay: int = 0,
    seed: int = 1,
) -> Capture:
    """One point as a capture; a delay of n samples moves the commands n rows ahead of what acted."""
    random = np.random.default_rng(seed + point)
    i = rotated(run.i_dq[:, point], angle)
    v = rotated(run.v_dq[:, point], angle)
    if delay:
        v = np.concatenate([v[delay:], np.repeat(v[-1:], delay, axis=0)])
    return Capture(
        start_s=start_s,
        sampling_frequency_hz=SAMPLING_HZ,
        i_ab=i + noise_a * random.normal(size=i.shape),
        v_ab=v,
        v_dc=np.full(len(i), 540.0),
    )
