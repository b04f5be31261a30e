"""The classical method as printed: R_s = v/i at constant current, and integration of the voltage.

    psi(t) = psi(0) + integral of (v - R_s i) dt

over ten periods, averaged over points of equal current, without an inverter model. (Combes, Malrait, Martin, Rouchon,
section "Classical method".)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.analysis import FluxPath, trace_sweep
from orchestrator.numerics.frames import to_dq
from protocols import Capture, NotMeasuredError, Segment


@dataclass(frozen=True)
class SweptPath:
    """One sweep, evaluated as printed.

    Attributes
    ----------
    axis : {"d", "q", "dq"}
    held_a : float
    resistance_ohm : float
        v/i over the dwells of this sweep.
    path : FluxPath
        Flux, zero where the swept current is zero; `tied` shifts paths that do not pass zero current.
    """

    axis: str
    held_a: float
    resistance_ohm: float
    path: FluxPath


def swept_path(
    segment: Segment, capture: Capture, *, closed: bool = False, levels: int = 61, blocks: int = 20_000
) -> SweptPath:
    """Evaluate one sweep, averaged at `levels` currents along it.

    Parameters
    ----------
    segment : Segment
    capture : Capture
    closed : bool
        Whether a flux difference after a whole number of periods is removed as drift, linear in time; the paper does
        not mention this.
    levels : int
    blocks : int
        Number of blocks to which the capture is averaged first; several are needed per level.

    Raises
    ------
    NotMeasuredError
        Without a dwell at constant current.
    """
    trace = trace_sweep(capture, segment.rotor_angle_rad, where=segment.id, blocks=blocks)
    if not trace.dwells:
        raise NotMeasuredError(segment.id, "i_alpha, i_beta", "the current never rests here, and R_s is v/i of rests")
    i, v = (np.array([getattr(one, name) for one in trace.dwells]) for name in ("i_ab", "v_ab"))
    ohm = float((v * i).sum() / (i * i).sum())
    flux = trace.impulse - ohm * trace.charge
    if closed:
        flux = flux - np.outer(trace.time, (flux[-1] - flux[0]) / (trace.time[-1] - trace.time[0]))
    axis = str(segment.settings["swept_axis"])
    held = 0.0 if axis == "dq" else float(segment.settings.get("held_a", 0.0))
    ends = to_dq(i, segment.rotor_angle_rad) @ trace.axis
    at = np.linspace(ends.min(), ends.max(), levels)
    level = np.rint((trace.travel - at[0]) / (at[1] - at[0])).astype(int)
    rows = np.column_stack([trace.i, flux])
    means = np.array([rows[level == k].mean(axis=0) for k in range(levels) if (level == k).any()])
    zero = [np.interp(0.0, means[:, :2] @ trace.axis, column) for column in means[:, 2:].T]
    return SweptPath(axis, held, ohm, FluxPath(means[:, :2], means[:, 2:] - zero, np.zeros(2)))


def tied(sweeps: Sequence[SweptPath]) -> list[FluxPath]:
    """All paths with zero flux at zero current; other paths start at their crossing with one through zero."""
    through_zero = {one.axis: one.path for one in sweeps if one.held_a == 0.0}
    out = []
    for one in sweeps:
        if one.held_a == 0.0:
            out.append(one.path)
            continue
        other = through_zero.get("q" if one.axis == "d" else "d")
        if other is not None:
            across = other.current[:, "dq".index("q" if one.axis == "d" else "d")]
            start = np.array([np.interp(one.held_a, across, psi) for psi in other.psi.T])
            out.append(FluxPath(one.path.current, one.path.psi + start, one.path.std))
    return out
