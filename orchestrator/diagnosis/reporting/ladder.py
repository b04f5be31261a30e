"""From fits to what is reported: the ladder's rungs, effects with intervals, the fraction that is left."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from orchestrator.diagnosis.fitting.candidates import Active, value_at
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.fitting.simulation import current_rms
from orchestrator.diagnosis.selection.forward_search import Step
from orchestrator.diagnosis.uncertainty.intervals import coordinate_spread
from orchestrator.diagnosis.weak_form.segments import SegmentSignals
from orchestrator.numerics.types import Array
from protocols import FoundEffect, ParameterValue, Rung, Verdict


def training(piece: SegmentSignals) -> bool:
    return not piece.held_out


def held_out(piece: SegmentSignals) -> bool:
    return piece.held_out


def mean_rms_v(fit: Fit, use: Callable[[SegmentSignals], bool]) -> float | None:
    """rms of y_m / sum_k(w_mk Ts) over the windows that are means, carriers of the ripple aside [V]."""
    parts = [_means(p, e) for p, e in zip(fit.prepared.pieces, fit.volts, strict=True) if use(p)]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) if parts else None


def noise_rms_v(fit: Fit, use: Callable[[SegmentSignals], bool] = lambda _: True) -> float | None:
    """The same figure if only the sensors' noise were left [V]."""
    parts = []
    for piece, segment_frame in zip(fit.prepared.pieces, fit.frame.pieces, strict=True):
        if use(piece):
            scale = piece.signals.sampling_frequency_hz / piece.windows.absolute_weight()
            parts.append(_means(piece, segment_frame.whitener.variance * scale**2))
    return float(np.sqrt(np.mean(np.concatenate(parts)))) if parts else None


def _means(piece: SegmentSignals, rows: Array) -> Array:
    carriers = len(piece.windows.carriers)
    return rows.reshape(-1, carriers, 2)[:, 0].ravel()


def rung(step: Step) -> Rung:
    """One step of the ladder in numbers."""
    return Rung(
        added=step.added,
        chi2=step.fit.chi2_per_dof,
        rms_v=mean_rms_v(step.fit, training),
        heldout_rms_v=mean_rms_v(step.fit, held_out),
        current_rms_a=current_rms(step.fit),
    )


def left_fraction(before_chi2: float, after: Fit) -> float:
    """u = sqrt((chi2_after - 1) / (chi2_before - 1)); 0 where the first model already fits."""
    if before_chi2 <= after.criteria.selection.detected_chi2:
        return 0.0
    return math.sqrt(max(after.chi2_per_dof - 1.0, 0.0) / (before_chi2 - 1.0))


def verdict_of(before: Fit, after: Fit, effects: int) -> Verdict:
    """The verdict on what is left: it has to be small beside what was found, and small in itself.

    The fraction alone would forgive a large second error beside a huge first one. A wrong shape of the right effect
    leaves some of it, the more the stronger it shows; what is beyond that is another effect's.
    """
    limits = after.criteria.selection
    if after.chi2_per_dof <= limits.detected_chi2:
        return "explained" if effects else "clean"
    fraction = left_fraction(before.chi2_per_dof, after)
    if not effects or fraction > limits.mostly_explained or not small_remainder(before, after):
        return "unknown_remains"
    return "explained" if fraction <= limits.explained else "mostly_explained"


def small_remainder(before: Fit, after: Fit) -> bool:
    """Whether what is left may be due to the found effects' shape."""
    limits, first = after.criteria.selection, math.sqrt(max(before.chi2_per_dof - 1.0, 0.0))
    return after.chi2_per_dof - 1.0 <= max(limits.least_left, limits.shape_error * first)


def found_effects(
    fitter: Fitter, fit: Fit, evidence: Mapping[str, float | None], rivals: Mapping[str, Sequence[str]]
) -> tuple[FoundEffect, ...]:
    """The active effects with 95 % intervals; see `coordinate_spread`."""
    if not fit.model.active:
        return ()
    half = fit.criteria.uncertainty.interval * coordinate_spread(fitter, fit)
    effects, k = [], 0
    for active in fit.model.active:
        widths = dict(zip(active.free, half[k : k + len(active.free)], strict=True))
        k += len(active.free)
        effects.append(
            FoundEffect(
                name=active.name,
                parameters={n: _interval(active, n, float(widths[n])) for n in active.free},
                twins=tuple(rivals.get(active.name, ())),
                relative_size=active.relative_size,
                log_evidence=evidence.get(active.name, 0.0),
            )
        )
    return tuple(effects)


def _interval(active: Active, name: str, half: float) -> ParameterValue:
    p = active.candidate.named(name)
    x = active.coordinate(name)
    ends = sorted((value_at(p, x - half), value_at(p, x + half)))
    return ParameterValue(value=active.values[name], low=ends[0], high=ends[1], unit=p.unit)
