"""Detect a rotor that turns in a locked-rotor stage, by rotating currents or by a back-EMF in a dq frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.importing._source import Numbers


@dataclass(frozen=True)
class _Criteria:
    """Thresholds for a rotating current."""

    part: int = 1 << 16
    """Samples per evaluation block: some seconds."""
    fewest_turns: float = 3.0
    """Fewer turns may be a hand-moved direction or a sweep."""
    steady: float = 0.3
    """Largest relative variation of a rotating current's length; a sweep passes zero."""
    one_way: float = 0.9
    """Smallest share of the rotation in one direction."""


_CRITERIA = _Criteria()


def turning(i_ab: Numbers, rate_hz: float) -> tuple[float, float] | None:
    """Turns and frequency [Hz] of currents (n, 2) that rotate as in a running machine; None where they do not.

    A running machine's current vector keeps its length and rotates one way, also at a drifting speed. An injection's
    ripple or a sweep pulsates along an axis. The search runs in blocks, since a motor may start within the segment.
    """
    blocks = (i_ab[start : start + _CRITERIA.part] for start in range(0, len(i_ab), _CRITERIA.part))
    return next((result for block in blocks if (result := _turning(block, rate_hz)) is not None), None)


def _turning(i_ab: Numbers, rate_hz: float) -> tuple[float, float] | None:
    z = i_ab[:, 0] + 1j * i_ab[:, 1]
    spectrum = np.abs(np.fft.fft(z - z.mean()))
    line = float(np.fft.fftfreq(z.size, 1.0 / rate_hz)[int(np.argmax(spectrum))])
    window = max(1, int(rate_hz / (16.0 * abs(line)))) if line else 1
    if z.size < 4 * window:
        return None
    # Means over a sixteenth of a turn remove ripple and noise, and keep the rotation.
    smooth = z[: z.size // window * window].reshape(-1, window).mean(axis=1)
    length = np.abs(smooth)
    steps = np.angle(smooth[1:] * np.conj(smooth[:-1]))
    turns = abs(float(np.sum(steps))) / (2.0 * np.pi)
    is_steady_direction = turns * 2.0 * np.pi > _CRITERIA.one_way * float(np.sum(np.abs(steps)))
    if (
        turns < _CRITERIA.fewest_turns
        or not is_steady_direction
        or float(np.std(length)) > _CRITERIA.steady * float(np.mean(length))
    ):
        return None
    return turns, turns * rate_hz / z.size


def beyond_resistance_v(i_ab: Numbers, v_ab: Numbers, ohm: float) -> float | None:
    """Mean voltage [V] beyond the resistive drop; None where it is no larger than that drop."""
    i, v = i_ab.mean(axis=0), v_ab.mean(axis=0)
    excess_v = float(np.hypot(*(v - ohm * i)))
    return excess_v if excess_v > 2.0 * ohm * float(np.hypot(*i)) else None
