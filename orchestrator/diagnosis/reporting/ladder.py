"""Steps of the ladder: the error of each fit in volts, and the error that noise alone would cause."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.fitting.simulation import current_rms
from orchestrator.diagnosis.selection.search_state import AcceptedModel
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.types import Array
from protocols import Rung


def training(piece: SegmentData) -> bool:
    return not piece.held_out


def held_out(piece: SegmentData) -> bool:
    return piece.held_out


def mean_rms_v(fit: Fit, use: Callable[[SegmentData], bool]) -> float | None:
    """rms of y_m / sum_k(w_mk Ts) over the windows of order zero, without modes of the ripple [V]."""
    parts = [_means(p, e) for p, e in zip(fit.prepared.pieces, fit.volts, strict=True) if use(p)]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) if parts else None


def noise_rms_v(fit: Fit, use: Callable[[SegmentData], bool] = lambda _: True) -> float | None:
    """`mean_rms_v` for sensor noise alone [V]."""
    parts = []
    for piece, segment_linearisation in zip(fit.prepared.pieces, fit.linearisation.pieces, strict=True):
        if use(piece):
            scale = piece.signals.sampling_frequency_hz / piece.windows.absolute_weight
            parts.append(_means(piece, segment_linearisation.whitener.variance * scale**2))
    return float(np.sqrt(np.mean(np.concatenate(parts)))) if parts else None


def _means(piece: SegmentData, rows: Array) -> Array:
    modes = len(piece.windows.modes)
    return rows.reshape(-1, modes, 2)[:, 0].ravel()


def current_error(fit: Fit) -> float | None:
    """rms error of the simulated current over the current's range; None without excitation."""
    low, high, q = fit.prepared.current_range
    rms = current_rms(fit)
    return None if rms is None else rms / max(high - low, 2.0 * q)


def rung(step: AcceptedModel) -> Rung:
    """Numbers of one step of the ladder."""
    return Rung(
        added=step.added,
        chi2=step.fit.chi2_per_dof,
        rms_v=mean_rms_v(step.fit, training),
        heldout_rms_v=mean_rms_v(step.fit, held_out),
        current_rms_a=current_rms(step.fit),
        effects=step.fit.model.names,
    )


def kept_rungs(setup: DiagnosisSetup, steps: Sequence[AcceptedModel]) -> tuple[Rung, ...]:
    """Ladder steps of models evaluated as saved, so that a comparison with the file reproduces them."""
    return tuple(rung(AcceptedModel(step.added, setup.fitter.hold(step.fit.model))) for step in steps)
