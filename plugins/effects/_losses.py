"""Temperature-like quantities driven by the losses of the whole experiment, at the samples of a batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from orchestrator.numerics.types import Array, Indices
from plugins.effects._vectors import Starts, doubles
from protocols import LossHistory, SignalBatch


def along_losses(
    batch: SignalBatch, warm: Callable[[LossHistory], Array], otherwise: Callable[[], Array | float]
) -> Array:
    """A function of the loss history at each sample, shape (N,).

    Parameters
    ----------
    warm : callable
        Its values at the times of a history; interpolated linearly, constant beyond.
    otherwise : callable
        Value for segments without a history, (N,) or a number; not called where all have one.
    """
    out = np.empty(batch.samples)
    # Segments of one recording share one history.
    sharing: dict[int, list[int]] = {}
    for k, segment in enumerate(batch.segments):
        sharing.setdefault(id(segment.losses), []).append(k)
    if id(None) in sharing:
        out[:] = otherwise()
    for which in map(np.array, sharing.values()):
        losses = batch.segments[which[0]].losses
        if losses is not None:
            curve = (doubles(losses.time_s), doubles(warm(losses)))
            _read(out, batch.starts, which, doubles(batch.start_s), doubles(batch.sampling_frequency_hz), *curve)
    return out


@njit(cache=True, nogil=True)
def _read(
    out: Array, starts: Starts, which: Indices, start_s: Array, rate_hz: Array, time_s: Array, values: Array
) -> None:
    """Values at increasing times, read at the samples of some segments into `out` (N,)."""
    end = time_s.shape[0] - 1
    for s in which:
        m, low, high = -1, -np.inf, time_s[0]
        before, slope = values[0], 0.0
        for k in range(starts[s], starts[s + 1]):
            now = start_s[s] + (k - starts[s]) / rate_hz[s]
            if now >= high:
                # The number of times that are not later.
                m = np.searchsorted(time_s, now, side="right") - 1
                before, low = values[m], time_s[m]
                high = time_s[m + 1] if m < end else np.inf
                slope = (values[m + 1] - before) / (high - low) if m < end else 0.0
            out[k] = before + slope * (now - low) if m >= 0 else before
