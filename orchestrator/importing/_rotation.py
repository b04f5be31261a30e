"""Does the rotor turn where it is to be locked? Told by currents that turn, or by a back-EMF in a dq frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.importing._source import Numbers


@dataclass(frozen=True)
class _Criteria:
    """From when on currents turn."""

    part: int = 1 << 16
    """Samples that are looked at together: some seconds."""
    fewest_turns: float = 3.0
    """Less may be a direction that was moved by hand, or a sweep's."""
    steady: float = 0.3
    """A turning current's length varies by less than this share: a sweep's goes through zero."""
    one_way: float = 0.9
    """Share of all turning that goes the same way."""


_CRITERIA = _Criteria()


def turning(i_ab: Numbers, rate_hz: float) -> tuple[float, float] | None:
    """Turns and frequency [Hz] of currents (n, 2) that turn as a running machine's do; None where they do not.

    A steady sinusoid in the phases, also of a speed that drifts: the vector keeps its length and goes one way. What
    pulsates along an axis, an injection's ripple or a sweep, does not. Looked for in parts, for a motor may be started.
    """
    parts = (i_ab[start : start + _CRITERIA.part] for start in range(0, len(i_ab), _CRITERIA.part))
    return next((found for part in parts if (found := _turning(part, rate_hz)) is not None), None)


def _turning(i_ab: Numbers, rate_hz: float) -> tuple[float, float] | None:
    z = i_ab[:, 0] + 1j * i_ab[:, 1]
    spectrum = np.abs(np.fft.fft(z - z.mean()))
    line = float(np.fft.fftfreq(z.size, 1.0 / rate_hz)[int(np.argmax(spectrum))])
    window = max(1, int(rate_hz / (16.0 * abs(line)))) if line else 1
    if z.size < 4 * window:
        return None
    # Means over a sixteenth of a turn: ripple and noise are gone, the turning is not.
    smooth = z[: z.size // window * window].reshape(-1, window).mean(axis=1)
    length = np.abs(smooth)
    steps = np.angle(smooth[1:] * np.conj(smooth[:-1]))
    turns = abs(float(np.sum(steps))) / (2.0 * np.pi)
    one_way = turns * 2.0 * np.pi > _CRITERIA.one_way * float(np.sum(np.abs(steps)))
    if (
        turns < _CRITERIA.fewest_turns
        or not one_way
        or float(np.std(length)) > _CRITERIA.steady * float(np.mean(length))
    ):
        return None
    return turns, turns * rate_hz / z.size


def beyond_resistance_v(i_ab: Numbers, v_ab: Numbers, ohm: float) -> float | None:
    """The mean voltage [V] that a resistance does not take; None where that is no more than it takes."""
    i, v = i_ab.mean(axis=0), v_ab.mean(axis=0)
    left = float(np.hypot(*(v - ohm * i)))
    return left if left > 2.0 * ohm * float(np.hypot(*i)) else None
