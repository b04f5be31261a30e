"""Contribution of each effect to the error and to the map, which decides whether it is a cause."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.scoring import without_effect
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.diagnosis.weak_form.windows import sum_intervals
from orchestrator.numerics.types import Array
from protocols import SegmentStage


@dataclass(frozen=True)
class Contribution:
    """Contribution of one effect, with R_s and the map refitted without it.

    Attributes
    ----------
    relative_to_error : float
        Its rms over that of the first model's error; the largest of holds, sweeps, means under injection, ripple.
    largest_in : str or None
        Kind of rows that `relative_to_error` is of: a stage, or ``ripple``; None where the first model has no error.
    relative_to_excitation : float
        Its rms over the rms voltage of the same kind of rows.
    relative_to_flux : float
        Its rms change of the flux at the measured currents, over the rated flux.
    relative_to_misfit : float
        Root of the rise of chi2 over the first model's excess chi2: unlike volts, comparable with what is left.
    """

    relative_to_error: float
    largest_in: str | None
    relative_to_excitation: float
    relative_to_flux: float
    relative_to_misfit: float

    @property
    def share(self) -> float:
        """Part of the first error that it takes away, in volts or in chi2, whichever shows it better."""
        return max(self.relative_to_error, self.relative_to_misfit)


def contributions(setup: DiagnosisSetup, first: Fit, last: Fit) -> dict[str, Contribution]:
    """Contribution of each active effect of the last fit."""
    fitter, errors = setup.fitter, _by_kind(first, first.volts)
    volts = _by_kind(last, _voltages(last))
    rated, points = rated_flux_wb(setup), mean_currents(last)
    flux = last.model.magnetics.flux_and_inductance(points)[0]
    misfit = max(first.chi2_per_dof - 1.0, np.finfo(float).tiny)
    found = {}
    for name in last.model.names:
        without = without_effect(fitter, last, name)
        change = [b - a for a, b in zip(last.volts, without.volts, strict=True)]
        sizes = _by_kind(last, change)
        moved = without.model.magnetics.flux_and_inductance(points)[0] - flux
        of_error = {kind: sizes[kind] / errors[kind] for kind in sizes if errors[kind] > 0.0}
        largest_in = max(of_error, key=lambda kind: of_error[kind], default=None)
        found[name] = Contribution(
            relative_to_error=0.0 if largest_in is None else of_error[largest_in],
            largest_in=largest_in,
            relative_to_excitation=max((sizes[kind] / volts[kind] for kind in sizes if volts[kind] > 0.0), default=0.0),
            relative_to_flux=float(np.sqrt(np.mean(np.sum((moved - moved.mean(axis=0)) ** 2, axis=1)))) / rated,
            relative_to_misfit=math.sqrt(max(without.chi2_per_dof - last.chi2_per_dof, 0.0) / misfit),
        )
    return found


def is_material(share: Contribution, fit: Fit) -> bool:
    """Whether an effect exceeds the materiality limits, regardless of the noise."""
    limits = fit.criteria.materiality
    return share.relative_to_flux > limits.material_flux or share.relative_to_excitation > limits.material_voltage


def excitation_v(fit: Fit) -> float:
    """rms of the impressed voltage over excited segments [V]."""
    kinds = _by_kind(fit, _voltages(fit))
    return max(kinds.values(), default=0.0)


def left_of_excitation(fit: Fit) -> float:
    """Residual beyond noise over the rms voltage: the largest of `left_by_kind`."""
    return max(left_by_kind(fit).values(), default=0.0)


def left_by_kind(fit: Fit) -> dict[str, float]:
    """Residual beyond noise over the rms voltage, of holds, sweeps, means under injection, and ripple.

    In held-out stages the uncertainty of R_s and the map counts as noise: between points the map is interpolated.
    """
    sigmas = _prediction_sigmas(fit)
    volts = _by_kind(fit, _voltages(fit))
    residual = _by_kind(fit, [v / sigma for v, sigma in zip(fit.volts, sigmas, strict=True)])
    chi = _by_kind(fit, [e / sigma for e, sigma in zip(fit.residual, sigmas, strict=True)])
    beyond = {k: rms * math.sqrt(max(1.0 - 1.0 / chi[k] ** 2, 0.0)) for k, rms in residual.items() if chi[k] > 0.0}
    return {kind: rms / volts[kind] for kind, rms in beyond.items() if volts[kind] > 0.0}


def held_out_covariance(fit: Fit) -> dict[int, Array]:
    """Covariance (rows, rows) of each held-out segment's residual by noise, R_s and the map; by the segment's index.

    The map's uncertainty matters between points and at its edge, where the smoothness prior determines it.
    """
    pieces = zip(fit.prepared.pieces, fit.resistance, fit.linearisation.pieces, strict=True)
    columns = {k: np.column_stack([r, x.white_basis]) for k, (p, r, x) in enumerate(pieces) if p.held_out}
    if not columns:
        return {}
    size = np.sqrt(np.diag(fit.normal))
    information, turn = np.linalg.eigh(fit.normal / np.outer(size, size))
    # A direction that nothing determines has an eigenvalue of rounding errors, of either sign.
    certain = np.sqrt(np.maximum(information, np.finfo(float).eps * information[-1]))
    roots = {k: (c / size) @ (turn / certain) for k, c in columns.items()}
    return {k: np.asarray(np.eye(len(root)) + root @ root.T) for k, root in roots.items()}


def _prediction_sigmas(fit: Fit) -> list[Array]:
    """Standard deviation of each segment's residuals over that by noise alone, shape (rows,) each."""
    covariances = held_out_covariance(fit)
    return [
        np.sqrt(np.diag(covariances[k])) if k in covariances else np.ones(len(e)) for k, e in enumerate(fit.residual)
    ]


def gates_off_error(fit: Fit) -> dict[str, float | None]:
    """The fields of a `VerdictRecord` on the model's error with the gates off: R_s times the current's, its chance.

    Empty where there are no such readings.
    """
    residuals = [e for p, e in zip(fit.prepared.pieces, fit.residual, strict=True) if _without_current(p)]
    if not residuals:
        return {}
    together = np.concatenate(residuals)
    excited = [v for v in _by_kind(fit, _voltages(fit)).values() if v > 0.0]
    return {
        "gates_off_v": fit.rms_v(_without_current) or 0.0,
        "gates_off_probability": float(chdtrc(len(together), float(together @ together))),
        "least_excitation_v": min(excited, default=None),
    }


def _without_current(piece: SegmentData) -> bool:
    return piece.stage is SegmentStage.GATES_OFF


def mean_currents(fit: Fit) -> Array:
    """Mean current of every segment in the true rotor frame, shape (segments, 2)."""
    return np.stack([i_dq.mean(axis=0) for i_dq in fit.true_currents()])


def rated_flux_wb(setup: DiagnosisSetup) -> float:
    """The magnet's flux, or that of the rated current where the nameplate has none [Wb]."""
    return max(setup.fitter.pm_flux_wb, setup.l_d_h * setup.current_a, setup.l_q_h * setup.current_a)


def _by_kind(fit: Fit, values: Sequence[Array]) -> dict[str, float]:
    """rms of the segments' rows by kind: holds, sweeps, means under injection, ripple."""
    parts: dict[str, list[Array]] = {}
    for piece, rows in zip(fit.prepared.pieces, values, strict=True):
        if piece.stage is SegmentStage.GATES_OFF:
            continue
        carried = rows.reshape(-1, len(piece.windows.modes), 2)
        parts.setdefault(piece.stage.value, []).append(carried[:, 0].ravel())
        if carried.shape[1] > 1:
            parts.setdefault("ripple", []).append(carried[:, 1:].ravel())
    return {kind: float(np.sqrt(np.mean(np.concatenate(rows) ** 2))) for kind, rows in parts.items()}


def _voltages(fit: Fit) -> list[Array]:
    """The impressed voltage in the units of the rows, per segment, shape (rows,)."""
    rows = []
    for piece in fit.prepared.pieces:
        w = piece.windows
        sums = sum_intervals(np.ascontiguousarray(piece.signals.v_ab[:-1]), w.step, w.test_functions, w.bins, w.n_bins)
        rows.append(w.combine(sums) / w.absolute_weight)
    return rows
