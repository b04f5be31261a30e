"""A capture of voltage steps as running integrals over short blocks, whose length scales with the steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.frames import to_dq
from orchestrator.numerics.types import Array
from protocols import Capture, NotMeasuredError

STEP_KNOTS: Array = np.array([0.02, 0.06, 0.15])
"""Knots of the inverter's error in units of the largest current: steps pass zero too fast to resolve more."""


@dataclass(frozen=True)
class StepTrace:
    """One capture of voltage steps, averaged over short blocks, dq frame.

    Attributes
    ----------
    where : str
        Name of the segment.
    i : array, shape (n, 2)
        Current [A].
    impulse, charge, lag : array, shape (n, 2)
        Integrals of voltage [Vs] and current [As]; change of the voltage's integral per sample of delay [Vs].
    losses : array, shape (n, k, 2)
        Voltage integral per volt of inverter error at each knot [s].
    time : array, shape (n,)
        [s].
    stretch : array of int, shape (n,)
        Number of each block's stretch.
    swing : float
        Blocks from one reversal of the voltage to the next.
    volts : float
        Median length of the voltage vector [V].
    """

    where: str
    i: Array
    impulse: Array
    charge: Array
    lag: Array
    losses: Array
    time: Array
    stretch: NDArray[np.int64]
    swing: float
    volts: float


def trace_steps(
    capture: Capture,
    angle_rad: float,
    *,
    delay: float,
    knots_a: Array,
    where: str,
    max_blocks: int = 1500,
    blocks_a_swing: int = 24,
    swings_a_stretch: int = 6,
) -> StepTrace:
    """Average a capture over blocks whose length scales with the time between two reversals of the voltage.

    Parameters
    ----------
    delay : float
        v[k] acts from t_k + `delay` Ts.
    knots_a : array, shape (k,)
        Knots of the inverter's error over the phase current [A].
    max_blocks : int
        Blocks that are kept, in whole stretches spread evenly.

    Raises
    ------
    NotMeasuredError
        Where the voltage reverses less than twice: a loop to both limits and back.
    """
    # numba stays out of an import that only wants the names
    from orchestrator.analysis._block_means import block_means
    from orchestrator.analysis._phase_loss_kernels import shape_integrals

    step, reversals = 1.0 / capture.sampling_frequency_hz, count_reversals(np.asarray(capture.v_ab, dtype=np.float64))
    if reversals < 2:
        raise NotMeasuredError(where, "v_alpha, v_beta", "the voltage does not reverse: expected steps to and fro")
    swing = len(capture) / (reversals + 1)
    block = max(1, int(swing / blocks_a_swing))

    def means(delay_samples: float) -> tuple[Array, Array, Array]:
        return block_means(capture.i_ab, capture.v_ab, sampling_s=step, delay=delay_samples, block=block)

    current, charge, impulse = means(delay)
    lag = 2.0 * (means(delay + 0.5)[2] - impulse)
    count = len(current)
    losses = shape_integrals(capture.i_ab, knots_a, step, block, count)
    stretch = (np.arange(count) / (swings_a_stretch * swing / block)).astype(np.int64)
    selected = _spread(stretch, max_blocks)
    sizes = np.linalg.norm(np.asarray(capture.v_ab, dtype=np.float64), axis=1)
    return StepTrace(
        where=where,
        i=to_dq(current[selected], angle_rad),
        impulse=to_dq(impulse[selected], angle_rad),
        charge=to_dq(charge[selected], angle_rad),
        lag=to_dq(lag[selected], angle_rad),
        losses=to_dq(losses[selected].reshape(-1, 2), angle_rad).reshape(-1, len(knots_a), 2),
        time=((np.arange(count, dtype=np.float64) + 0.5) * (block * step))[selected],
        stretch=stretch[selected],
        swing=swing / block,
        # A log may consist mostly of the time before or between steps.
        volts=float(np.median(sizes[sizes >= 0.5 * sizes.max()])),
    )


def count_reversals(v_ab: Array, share: float = 0.5) -> int:
    """Number of voltage jumps above a share of the largest jump; voltage of shape (n, 2)."""
    jumps = np.linalg.norm(np.diff(v_ab, axis=0), axis=1)
    return int((jumps > share * jumps.max(initial=1e-300)).sum())


def _spread(stretch: NDArray[np.int64], max_blocks: int) -> NDArray[np.bool_]:
    count = int(stretch[-1]) + 1
    count_kept = max(1, min(count, max_blocks * count // len(stretch)))
    return np.isin(stretch, np.linspace(0, count - 1, count_kept).round())
