"""Where the model's form is what errs: its error as noise, as large for each kind of stage and mode as it turned out.

A knee of another shape leaves ten times the readings' noise in one mode of the ripple and none in another. One figure
for all would trust the former too much and the latter too little. With rows of unit noise, e their residual and H what
the fit takes of them, the variance of a group of n rows is

    s = e^T e / (n - tr H)

(D. A. Harville, J. Am. Stat. Assoc. 72 (1977), doi:10.2307/2286796, section 5: restricted likelihood's fixed point).
"""

from __future__ import annotations

import numpy as np

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.weak_form.noise import kind_of
from orchestrator.numerics.types import Array
from protocols import ModelNoise


def with_model_error(noise: ModelNoise, fit: Fit) -> ModelNoise:
    """The noise that a fit was made with, its variances as large as the fit's residual says, or the readings' own."""
    inverse = np.linalg.inv(fit.system()[0])
    squares: dict[str, Array] = {}
    rows: dict[str, Array] = {}
    pieces = (p for p in fit.prepared.pieces if not p.held_out)
    for piece, (linear, columns, e) in zip(pieces, fit.training(), strict=True):
        told = np.column_stack([linear, columns])
        taken = np.einsum("rx,xy,ry->r", told, inverse, told, optimize=True)
        kind, modes = kind_of(piece), len(piece.windows.carriers)
        squares[kind] = squares.get(kind, 0.0) + _by_mode(e**2, modes)
        rows[kind] = rows.get(kind, 0.0) + _by_mode(1.0 - taken, modes)
    factors = {}
    for kind, sums in squares.items():
        known = np.array(noise.variance_factors.get(kind, np.ones(len(sums))))
        factors[kind] = tuple(float(x) for x in np.maximum(known * sums / np.maximum(rows[kind], 1.0), 1.0))
    return noise.model_copy(update={"variance_factors": factors})


def _by_mode(values: Array, modes: int) -> Array:
    """Sums of rows (hats * modes * 2,) by mode, shape (modes,)."""
    return np.asarray(values.reshape(-1, modes, 2).sum(axis=(0, 2)))
