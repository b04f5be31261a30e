"""Where currents rest: what a modulator's timer cannot resolve of a voltage that stands still errs all through.

A voltage that moves is dithered by its own course. Knows nothing of motors.
"""

from __future__ import annotations

import math

import numpy as np

from orchestrator.diagnosis.weak_form.segments import SegmentSignals
from orchestrator.numerics.types import Array
from protocols import RealArray, SegmentStage


def rests(piece: SegmentSignals, *, still: float = 0.02, certain: float = 4.0, least: int = 3) -> tuple[slice, ...]:
    """Samples of each stretch in which a segment's current stands still: all of a hold, the ends of a sweep's ramps.

    Parameters
    ----------
    still : float
        Step of the current from window to window, as a part of a ramp's, below which it stands, ...
    certain : float
        ... or standard deviations of the readings' noise in it, where that is more.
    least : int
        Windows that a stretch has at least.
    """
    if piece.stage is SegmentStage.RESISTANCE:
        return (slice(0, len(piece.signals.v_dc)),)
    if piece.stage is not SegmentStage.CLASSICAL:
        return ()
    step = max(round(piece.windows.step), 1)
    means = _block_means(piece.signals.i_ab, step)
    moved = np.hypot(*np.diff(means, axis=0).T)
    noise_a = math.sqrt(2.0 * float(np.trace(piece.scatter.covariance)) / (step * piece.averaged))
    stands = moved < max(still * float(moved.max(initial=0.0)), certain * noise_a)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stands, [False]]).astype(np.int8)))
    runs = zip(edges[::2], edges[1::2] + 1, strict=True)
    return tuple(slice(int(a) * step, int(b) * step) for a, b in runs if b - a >= least)


def _block_means(x: RealArray, size: int) -> Array:
    """Means of blocks of so many samples; what is left over at the end is left out."""
    blocks = len(x) // size
    return np.asarray(x[: blocks * size].reshape(blocks, size, -1).mean(axis=1))
