"""Multi-step prediction: the current simulated from the commanded voltage alone, compared with the measured one."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.weak_form.equations import local_map
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.tensor_spline import derivatives_at
from orchestrator.numerics.types import Array
from protocols import SegmentStage

MAX_SIMULATED_S: float = 1.0
"""Simulated duration of each segment [s]: many time constants, and both signs of a trapezoid."""

STEP_OF_DECAY = 0.2
"""Largest integration step in time constants of the winding; a mean of ten readings may span two of them."""


def simulated_current(fit: Fit, index: int, samples: int | None = None) -> tuple[Array, Array]:
    """Predicted and measured magnetising current of one piece in the true frame, each (n, 2) [A].

    dpsi/dt = v - R_s i from the first measured current on, with the effects' corrections of voltage, resistance and
    angle evaluated on the recording. Neither current includes iron-loss current.
    """
    piece = fit.prepared.pieces[index]
    corrected = fit.corrected(index)
    batch, base = fit.linearisation.base_of(index)
    local = local_map(batch, corrected, fit.model.magnetics)
    i_dq = local.i_dq
    n = min(len(i_dq), samples or len(i_dq))
    angle = np.asarray(corrected.theta_rad, dtype=np.float64)[:n]
    grid = fit.model.magnetics.grid
    numbers, _ = grid.layout
    ts = 1.0 / piece.signals.sampling_frequency_hz
    resistance = np.ascontiguousarray(corrected.resistance_ohm[:n]) * (fit.model.r_s / base.resistance_ohm[0])
    inductances = local.inductance[:, [0, 2]]
    min_inductance = 0.2 * float(np.median(inductances))
    decay = ts * float(resistance.max()) / max(float(inductances.min()), min_inductance)
    predicted = _simulate(
        np.ascontiguousarray(corrected.v_ab[:n]),
        np.ascontiguousarray((corrected.i_ab - corrected.i_m_ab)[:n]),
        resistance,
        np.ascontiguousarray(angle),
        i_dq[:n],
        fit.model.magnetics.patches,
        numbers,
        ts,
        parts_of(decay),
        min_inductance,
        np.array([grid.low, grid.high, grid.reach]),
    )
    return predicted, i_dq[:n]


def parts_of(decay: float) -> int:
    """Integration steps per sample, for a sample of so many time constants."""
    return max(1, math.ceil(decay / STEP_OF_DECAY))


def current_rms(fit: Fit, use: Callable[[SegmentData], bool] = lambda _: True) -> float | None:
    """rms of predicted minus measured current over some pieces [A]; None where there are none."""
    total, count = 0.0, 0
    for index, piece in enumerate(fit.prepared.pieces):
        if piece.stage is SegmentStage.GATES_OFF or not use(piece):
            continue
        longest = round(MAX_SIMULATED_S * piece.signals.sampling_frequency_hz)
        stage_share = 3 if piece.stage is SegmentStage.RESISTANCE else 1
        predicted, measured = simulated_current(fit, index, longest // stage_share)
        total += float(np.sum((predicted - measured) ** 2))
        count += predicted.size
    return math.sqrt(total / count) if count else None


@njit(cache=True, nogil=True)
def _simulate(
    v_ab: Array,
    extra_ab: Array,
    resistance: Array,
    angle: Array,
    measured: Array,
    patches: Array,
    numbers: Array,
    ts: float,
    parts: int,
    min_inductance: float,
    box: Array,
) -> Array:
    """Integrate psi with several steps per sample, each followed by one Newton step for the current."""
    # Beyond the map's box (lowest and highest i_d, highest i_q) its edge's inductances hold; far outside, the current
    # is held.
    reach = 5.0 * max(-box[0], box[1], box[2])
    n = v_ab.shape[0]
    out = np.empty((n, 2))
    i_d = measured[0, 0]
    i_q = measured[0, 1]
    psi_d = 0.0
    psi_q = 0.0
    h = ts / parts
    for step in range((n - 1) * parts + 1):
        k = step // parts
        i_d = min(max(i_d, -reach), reach)
        i_q = min(max(i_q, -reach), reach)
        edge_d = min(max(i_d, box[0]), box[1])
        edge_q = min(max(i_q, -box[2]), box[2])
        pd, pq, ldd, ldq, lqq = derivatives_at(edge_d, edge_q, patches, numbers)
        det = ldd * lqq - ldq * ldq
        if ldd < min_inductance or lqq < min_inductance or det < 0.25 * ldd * lqq:
            # A map that is not convex here cannot be inverted; its inductance is limited from below.
            ldd = max(ldd, min_inductance)
            lqq = max(lqq, min_inductance)
            ldq = 0.0
            det = ldd * lqq
        pd += ldd * (i_d - edge_d) + ldq * (i_q - edge_q)
        pq += ldq * (i_d - edge_d) + lqq * (i_q - edge_q)
        if step == 0:
            psi_d = pd
            psi_q = pq
        # Correct the explicit guess's flux error with the local inductance.
        i_d += (lqq * (psi_d - pd) - ldq * (psi_q - pq)) / det
        i_q += (ldd * (psi_q - pq) - ldq * (psi_d - pd)) / det
        i_d = min(max(i_d, -reach), reach)
        i_q = min(max(i_q, -reach), reach)
        if step % parts == 0:
            out[k, 0] = i_d
            out[k, 1] = i_q
        if k == n - 1:
            break
        co = math.cos(angle[k])
        si = math.sin(angle[k])
        va = v_ab[k, 0] - resistance[k] * extra_ab[k, 0]
        vb = v_ab[k, 1] - resistance[k] * extra_ab[k, 1]
        vd = co * va + si * vb
        vq = -si * va + co * vb
        ed = vd - resistance[k] * i_d
        eq = vq - resistance[k] * i_q
        gd = h * (lqq * ed - ldq * eq) / det
        gq = h * (ldd * eq - ldq * ed) / det
        # Heun: the resistive drop at the middle of the step.
        dd = h * (ed - 0.5 * resistance[k] * gd)
        dq = h * (eq - 0.5 * resistance[k] * gq)
        if abs(i_d) < reach and abs(i_q) < reach:
            psi_d += dd
            psi_q += dq
        i_d += (lqq * dd - ldq * dq) / det
        i_q += (ldd * dq - ldq * dd) / det
    return out
