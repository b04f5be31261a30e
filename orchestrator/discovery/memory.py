"""Memory of a quantity along time: in each segment its slope, a lag and a play; over the experiment, heat that cools.

The play follows its input at a distance of at most its radius, whatever the rate (A. Visintin, "Differential Models of
Hysteresis", Springer 1994, doi:10.1007/978-3-662-11557-2). Sums of plays of several radii are a Prandtl-Ishlinskii
model; sums of lags of several time constants are a relaxation spectrum.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.typing import NDArray

from orchestrator.numerics.frames import to_phases
from orchestrator.numerics.types import Array
from protocols import RealArray, SignalBatch, Signals


def lagged(x: RealArray, time_constant_s: float, signals: Signals | SignalBatch) -> Array:
    """First-order lag of each column of x (n, m), exact for straight lines between samples; it begins at rest."""
    starts, rates = _layout(signals)
    return _lagged(_columns(x), starts, time_constant_s * rates)


def play(x: RealArray, radius: float, signals: Signals | SignalBatch) -> Array:
    """Play of phase quantities x (n, 3) that follow the phase currents: a segment's began where the current came from.

    Before a segment, x is taken as proportional to the current; without a history the play begins at x.
    """
    starts, _ = _layout(signals)
    x = _columns(x)
    memory = x[starts[:-1]].copy()
    for k, path in _ways(x, starts, signals):
        memory[k] = _played(path, np.array([0, len(path)]), radius, path[:1])[-1]
    return _played(x, starts, radius, memory)


def _ways(x: Array, starts: NDArray[np.int64], signals: Signals | SignalBatch) -> Iterator[tuple[int, Array]]:
    """For each segment with a history its number, and the way of x to where it begins, (points, 3)."""
    segments = signals.segments if isinstance(signals, SignalBatch) else (signals,)
    i_abc = to_phases(signals.i_ab)
    for k, segment in enumerate(segments):
        if segment.came_from_ab is None or len(segment.came_from_ab) == 0:
            continue
        at = slice(int(starts[k]), int(starts[k + 1]))
        power = np.sum(i_abc[at] ** 2)
        slope = float(np.sum(x[at] * i_abc[at]) / power) if power > 0.0 else 0.0
        yield k, x[starts[k]] + slope * (to_phases(segment.came_from_ab) - i_abc[starts[k]])


def unknown_memory(x: RealArray, radius: float, signals: Signals | SignalBatch) -> Array:
    """Change of a play by one standard deviation of what it remembers at a segment's beginning, (n, 3).

    Between two segments the current is not recorded, and may have swung over by more than the radius: then the play
    is anywhere within it.
    """
    starts, _ = _layout(signals)
    x = _columns(x)
    ends = [_played(x, starts, radius, x[starts[:-1]] + side * radius) for side in (1.0, -1.0)]
    return np.asarray((ends[0] - ends[1]) / math.sqrt(12.0), dtype=np.float64)


def fading_memory(x: RealArray, time_constant_s: float, signals: Signals | SignalBatch) -> Array:
    """Change of a lag by one standard deviation of what it remembers at a segment's beginning, (n, 3).

    How long the current had been there is not recorded: of its last way, any part may be left, and fades.
    """
    starts, rates = _layout(signals)
    x = _columns(x)
    out = np.zeros_like(x)
    for k, path in _ways(x, starts, signals):
        after_s = np.arange(starts[k + 1] - starts[k]) / rates[k]
        out[starts[k] : starts[k + 1]] = (path[-1] - x[starts[k]]) * np.exp(-after_s / time_constant_s)[:, None]
    return np.asarray(out / math.sqrt(3.0), dtype=np.float64)


def cooled(heat_j: RealArray, time_constant_s: float, signals: Signals | SignalBatch) -> Array:
    """Heat left of what was dissipated so far, W' = P - W / tau, shape (n,); all of it where no history is known."""
    starts, _ = _layout(signals)
    segments = signals.segments if isinstance(signals, SignalBatch) else (signals,)
    out = np.array(heat_j, dtype=np.float64)
    known: dict[int, Array] = {}
    for k, segment in enumerate(segments):
        losses = segment.losses
        if losses is None:
            continue
        if id(losses) not in known:
            time_s, power_w = np.asarray(losses.time_s, np.float64), np.asarray(losses.power_w, np.float64)
            known[id(losses)] = _left(time_s, power_w, time_constant_s)
        at = slice(int(starts[k]), int(starts[k + 1]))
        out[at] = np.interp(segment.time_s, losses.time_s, known[id(losses)])
    return out


def slopes(x: RealArray, signals: Signals | SignalBatch) -> Array:
    """Mean slope of each column of x (n, m) over the interval before each sample; a segment's first is its second's."""
    starts, rates = _layout(signals)
    out = np.diff(_columns(x), axis=0, prepend=x[:1])
    first = starts[:-1]
    out[first] = out[np.minimum(first + 1, starts[1:] - 1)]
    return np.asarray(out * np.repeat(rates, np.diff(starts))[:, None], dtype=np.float64)


def earlier(x: RealArray, signals: Signals | SignalBatch) -> Array:
    """Each column of x (n, m) one sample earlier; a segment's first is its own."""
    starts, _ = _layout(signals)
    x = _columns(x)
    out = np.concatenate([x[:1], x[:-1]])
    out[starts[:-1]] = x[starts[:-1]]
    return out


def _layout(signals: Signals | SignalBatch) -> tuple[NDArray[np.int64], Array]:
    """Bounds of the segments' samples (segments + 1,) and their sampling frequencies (segments,)."""
    if isinstance(signals, SignalBatch):
        return signals.starts, np.asarray(signals.sampling_frequency_hz, dtype=np.float64)
    return np.array([0, len(signals.v_dc)], dtype=np.int64), np.array([signals.sampling_frequency_hz])


def _columns(x: RealArray) -> Array:
    return np.ascontiguousarray(x if x.ndim == 2 else x[:, None], dtype=np.float64)


@njit(cache=True, nogil=True)
def _lagged(x: Array, starts: NDArray[np.int64], samples: Array) -> Array:
    """By each segment's time constant in samples."""
    out = np.empty_like(x)
    for s in range(starts.shape[0] - 1):
        decay = math.exp(-1.0 / samples[s])
        for m in range(x.shape[1]):
            before = x[starts[s], m]
            y = before
            for k in range(starts[s], starts[s + 1]):
                # Under a straight line it follows at this distance, once what it began with has decayed.
                behind = samples[s] * (x[k, m] - before)
                y = x[k, m] - behind + (y - before + behind) * decay
                before = x[k, m]
                out[k, m] = y
    return out


@njit(cache=True, nogil=True)
def _played(x: Array, starts: NDArray[np.int64], radius: float, memory: Array) -> Array:
    out = np.empty_like(x)
    for s in range(starts.shape[0] - 1):
        for m in range(x.shape[1]):
            y = memory[s, m]
            for k in range(starts[s], starts[s + 1]):
                y = min(max(y, x[k, m] - radius), x[k, m] + radius)
                out[k, m] = y
    return out


@njit(cache=True, nogil=True)
def _left(time_s: Array, power_w: Array, time_constant_s: float) -> Array:
    """Exact for a power that is constant from each time to the next."""
    out = np.zeros(time_s.shape[0])
    for k in range(1, time_s.shape[0]):
        decay = math.exp(-(time_s[k] - time_s[k - 1]) / time_constant_s)
        out[k] = out[k - 1] * decay + power_w[k - 1] * time_constant_s * (1.0 - decay)
    return out
