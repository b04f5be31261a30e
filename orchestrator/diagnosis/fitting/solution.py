"""Least-squares solution for R_s and the map, in which the equations are linear, with all effects fixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orchestrator.analysis import known_resistance
from orchestrator.diagnosis.fitting.model import ColumnName, Fit, Linearisation, MapSpace, Model, SegmentRows
from orchestrator.diagnosis.fitting.priors import known_by
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.diagnosis.weak_form.segments import PreparedRecording
from orchestrator.numerics.types import Array


def solved(
    prepared: PreparedRecording,
    model: Model,
    linearisation: Linearisation,
    rows: Sequence[SegmentRows],
    parameters: Sequence[ColumnName],
    held: bool,
) -> Fit:
    """Solve for R_s and the map; with `held` they keep the model's values."""
    space, pieces = model.space, prepared.pieces
    width = 1 + space.directions.shape[1]
    normal, right = np.zeros((width, width)), np.zeros(width)
    normal[1:, 1:] = linearisation.gram
    for piece, segment_linearisation, row in zip(pieces, linearisation.pieces, rows, strict=True):
        if piece.held_out:
            continue
        e, r = row.white[:, 0], row.white[:, 1]
        normal[0, 0] += r @ r
        normal[0, 1:] += r @ segment_linearisation.white_basis
        right[0] += r @ e
        right[1:] += segment_linearisation.white_basis.T @ e
    normal[1:, 0] = normal[0, 1:]
    total = normal.copy()
    total[1:, 1:] += space.prior.T @ space.prior
    known = known_by(prepared.fleet) or known_resistance(prepared.manifest.motor)
    believed = 1.0 / known.std_ohm**2 if known is not None and known.is_measured else 0.0
    nominal = known.value_ohm if known is not None else 0.0
    total[0, 0] += believed
    right[0] -= believed * nominal
    # The equations are relative to the model's coefficients, the prior to the space's origin.
    free = free_coefficients(space, model.magnetics.coefficients)
    right[1:] += space.prior.T @ (space.prior @ free)
    solution = np.append(model.r_s, np.zeros(width - 1)) if held else -np.linalg.solve(total, right)
    effective = float(np.trace(np.linalg.solve(total, normal)))
    r_s, change = float(solution[0]), solution[1:]
    moved = space.directions @ change
    fitted = replace(model, r_s=r_s, magnetics=Magnetics(space.grid, model.magnetics.coefficients + moved))
    residual, volts = [], []
    for piece, segment_linearisation, row in zip(pieces, linearisation.pieces, rows, strict=True):
        residual.append(row.white[:, 0] + row.white[:, 1] * r_s + segment_linearisation.white_basis @ change)
        raw = row.known + row.resistance * r_s + segment_linearisation.basis @ moved
        volts.append(raw * piece.signals.sampling_frequency_hz / piece.windows.absolute_weight)
    training = [e for p, e in zip(pieces, residual, strict=True) if not p.held_out]
    informative = sum(p.windows.informative for p in pieces if not p.held_out)
    chi2 = float(sum(e @ e for e in training))
    log_det = sum(f.whitener.log_det for p, f in zip(pieces, linearisation.pieces, strict=True) if not p.held_out)
    priors = sum(a.prior_residual(n) ** 2 for a, n in model.free)
    rough = space.prior @ (free + change)
    return Fit(
        model=fitted,
        linearisation=linearisation,
        prepared=prepared,
        chi2=chi2,
        objective=chi2 + log_det + priors + float(rough @ rough) + believed * (r_s - nominal) ** 2,
        log_det=log_det,
        dof=max(informative - effective - len(model.free), 1.0),
        residual=tuple(residual),
        volts=tuple(volts),
        normal=total,
        columns=tuple(row.columns for row in rows),
        parameters=tuple(parameters),
        resistance=tuple(row.white[:, 1] for row in rows),
    )


def free_coefficients(space: MapSpace, coefficients: Array) -> Array:
    if space.directions.shape[1] == 0:
        return np.zeros(0)
    if space.is_free:
        return coefficients - space.origin
    return np.asarray(np.linalg.lstsq(space.directions, coefficients - space.origin, rcond=None)[0])
