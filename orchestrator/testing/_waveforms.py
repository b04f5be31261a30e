"""The kit's own reading of waveforms: frames, trapezoids, rotating injection.

Shares no code with drives or estimators on purpose: else the kit would only prove that a piece of
code equals itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from protocols import Trapezoid

Floats = NDArray[np.floating]


def complex_dq(x_ab: Floats, rotor_angle_rad: float) -> NDArray[np.complexfloating]:
    """Stator vectors (n, 2) as complex numbers d + jq of the frame at `rotor_angle_rad`."""
    return np.asarray((x_ab[:, 0] + 1j * x_ab[:, 1]) * np.exp(-1j * rotor_angle_rad))


def trapezoid_reference(excitation: Trapezoid, rows: int, sampling_frequency_hz: float) -> NDArray[np.complexfloating]:
    """The current vector d + jq that a `Trapezoid` asks for, at its own sampling instants."""
    phase = np.arange(rows) / sampling_frequency_hz / excitation.period_s % 1.0
    wave = np.interp(phase, [0.0, 0.125, 0.375, 0.625, 0.875, 1.0], [0.0, 1.0, 1.0, -1.0, -1.0, 0.0])
    swept = excitation.amplitude_a * wave
    if excitation.swept_axis == "d":
        return np.asarray(swept + 1j * excitation.held_a)
    if excitation.swept_axis == "q":
        return np.asarray(excitation.held_a + 1j * swept)
    return np.asarray(swept * (1 + 1j) / np.sqrt(2.0))


@dataclass(frozen=True)
class FoundInjection:
    """A rotating periodic voltage as its two strongest spectral lines tell it."""

    frequency_hz: float
    rotation_hz: float
    amplitude_v: float
    direction_rad: float
    """Direction of the injected vector at row 0, against alpha."""


def find_injection(
    v_ab: Floats, sampling_frequency_hz: float, waveform: Literal["square", "sine"], samples_per_period: int
) -> FoundInjection:
    """Read amplitude, frequency, rotation and direction off the captured voltage.

    ``A exp(j(2 pi r t + phi)) f(t)`` has, for a real wave f of fundamental F at frequency f_0, its
    strongest lines at r + f_0 (value ``A exp(j phi) F``) and r - f_0 (``A exp(j phi) conj(F)``):
    half their distance is f_0, their middle is r, and their product tells A and phi without the
    sampling instant within a period.

    Parameters
    ----------
    v_ab : (n, 2)
        Captured voltage [V], a whole number of injection periods.
    samples_per_period : int
        Rows in one period of the requested wave; gives F of the sampled wave.
    """
    n = len(v_ab)
    v = v_ab[:, 0] + 1j * v_ab[:, 1]
    lines = np.fft.fft(v - v.mean()) / n
    frequencies = np.fft.fftfreq(n, 1.0 / sampling_frequency_hz)
    forward = int(np.argmax(np.where(frequencies > 0, np.abs(lines), 0.0)))
    backward = int(np.argmax(np.where(frequencies < 0, np.abs(lines), 0.0)))
    phase = 2j * np.pi * np.arange(samples_per_period) / samples_per_period
    first_half = np.arange(samples_per_period) < samples_per_period // 2
    wave = np.where(first_half, 1.0, -1.0) if waveform == "square" else np.sin(phase.imag)
    fundamental = np.mean(wave * np.exp(-phase))
    squared = lines[forward] * lines[backward] / abs(fundamental) ** 2
    vector = np.sqrt(squared)
    if (lines[forward] / (vector * fundamental)).real < 0.0:
        vector = -vector
    return FoundInjection(
        frequency_hz=float(frequencies[forward] - frequencies[backward]) / 2.0,
        rotation_hz=float(frequencies[forward] + frequencies[backward]) / 2.0,
        amplitude_v=float(abs(vector)),
        direction_rad=float(np.angle(vector)),
    )


def ripple_follows_flux(v_ab: Floats, i_ab: Floats, samples_per_period: int) -> float:
    """Correlation (-1..1) of the current's ripple with the integral of the voltage's, period by period."""
    periods = len(v_ab) // samples_per_period
    v, i = (
        (x[: periods * samples_per_period, 0] + 1j * x[: periods * samples_per_period, 1]).reshape(periods, -1)
        for x in (v_ab, i_ab)
    )
    v = v - v.mean(axis=1, keepdims=True)
    flux = np.cumsum(v, axis=1) - v  # the current of a row is sampled before its voltage acts
    flux = flux - flux.mean(axis=1, keepdims=True)
    ripple = i - i.mean(axis=1, keepdims=True)
    scale = np.sqrt(np.sum(np.abs(flux) ** 2) * np.sum(np.abs(ripple) ** 2))
    return float(np.sum(ripple * flux.conj()).real / scale) if scale > 0 else 0.0


def folded(x_ab: Floats, turns_per_row: float, samples_per_period: int, copies: int = 10) -> Floats:
    """One period of an injection's ripple, as it looks from its rotating direction: the mean over all, some times over.

    A whole turn averages out what an anisotropic winding adds in the opposite direction, and the noise.
    """
    periods = len(x_ab) // samples_per_period
    n = np.arange(periods * samples_per_period)
    x = (x_ab[n, 0] + 1j * x_ab[n, 1] - np.mean(x_ab[n, 0] + 1j * x_ab[n, 1])) * np.exp(-2j * np.pi * turns_per_row * n)
    period = np.tile(x.reshape(periods, samples_per_period).mean(axis=0), copies)
    return np.stack([period.real, period.imag], axis=1)


def share_at_the_end_of_the_scale(i_ab: Floats, close: float = 0.002) -> tuple[float, str]:
    """The largest share of rows within `close` of the range from an end of it, and of which quantity.

    A ripple that rotates stands still nowhere; readings that stop at an end do.
    """
    a, b = i_ab.T
    phases = {"phase a": a, "phase b": -0.5 * a + np.sqrt(0.75) * b, "phase c": -0.5 * a - np.sqrt(0.75) * b}
    shares = []
    for name, x in {**phases, "beta": b, "the vector": np.hypot(a, b)}.items():
        near = close * np.ptp(x)
        ends = (x >= x.max() - near, x <= x.min() + near)
        shares.append((max(float(np.mean(end)) for end in ends[: 1 if name == "the vector" else 2]), name))
    return max(shares)


def angle_between(a_rad: float, b_rad: float) -> float:
    """Size of the smallest turn from one angle to the other [rad]."""
    return float(abs(np.angle(np.exp(1j * (a_rad - b_rad)))))
