"""How far the delivered map may be off: what noise, R_s and the effects' own uncertainty make of it together."""

from __future__ import annotations

import math

import numpy as np

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.weak_form.magnetics import Magnetics
from orchestrator.numerics.types import Array


def map_band_wb(fit: Fit, i_dq: Array) -> float:
    """Half width of the flux's 95 % band, rms over some currents and both axes [Wb].

    The covariance of (R_s, map) with the effects' free coordinates eliminated, noise as large as it turned out to be.
    """
    space, count = fit.model.space, len(fit.model.free)
    if space.directions.shape[1] == 0:
        return 0.0
    width = fit.normal.shape[0]
    cross, own = np.zeros((width, count)), np.eye(count)
    for p, f, d, r in zip(fit.prepared.pieces, fit.frame.pieces, fit.columns, fit.resistance, strict=True):
        if p.held_out:
            continue
        cross[0] += r @ d[:, :count]
        cross[1:] += f.white_basis.T @ d[:, :count]
        own += d[:, :count].T @ d[:, :count]
    precision = (fit.normal - cross @ np.linalg.solve(own, cross.T)) / max(fit.chi2_per_dof, 1.0)
    covariance = np.linalg.inv(precision)[1:, 1:]
    rows = flux_rows(fit, i_dq)
    variance = np.einsum("ij,jk,ik->i", rows, covariance, rows)
    return fit.criteria.uncertainty.interval * math.sqrt(float(np.mean(np.maximum(variance, 0.0))))


def flux_rows(fit: Fit, i_dq: Array) -> Array:
    """Flux at some currents by the map's free numbers, less its mean, shape (2 n, free)."""
    grid, rows = fit.model.space.grid, []
    for direction in fit.model.space.directions.T:
        flux = Magnetics(grid, direction).flux_and_inductance(i_dq)[0]
        rows.append((flux - flux.mean(axis=0)).ravel())
    return np.stack(rows, axis=1)
