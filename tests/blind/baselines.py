"""What simpler searches name on the same recording: all of them linear, over the same columns.

The error of the saturated model is explained by the amplitudes of the whole library, one step from absent; R_s and
the map follow: y = X x + noise, as large as the best of all explanations leaves it. Each search offers sets of columns,
and takes that of the least Bayesian information criterion, chi2 + k log n.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.candidates import observable_effects, scaled_library
from orchestrator.diagnosis.selection.first_models import first_steps
from orchestrator.diagnosis.selection.scoring import linear_view
from orchestrator.numerics.types import Array
from protocols import Effect, RecordingReader

Places = NDArray[np.int64]
THRESHOLDS = 25


def baselines(recording: RecordingReader, library: Sequence[Effect]) -> dict[str, list[str]]:
    """Names by method, those first that make chi2 fall most."""
    setup = open_for_diagnosis(recording)
    every = scaled_library(library, setup.prepared.manifest)
    candidates = observable_effects(every, [p.signals for p in setup.prepared.pieces])
    bare = first_steps(setup, "saturated", {c.name: c for c in candidates})[-1].fit
    fit = setup.part_fitter.fit(bare.model, relinearisations=0)
    view = linear_view(setup.part_fitter, fit, candidates)
    # What only a second angle would show is no column of one.
    shown = np.flatnonzero(np.diag(view.normal) > 0.0)
    names = [view.columns[k][0].name for k in shown]
    normal, right, rows = view.normal[np.ix_(shown, shown)], view.right[shown], fit.dof
    noise = max((fit.chi2 - _fall(normal, right, np.arange(len(names)))) / fit.dof, 1.0)
    normal, right = normal / noise, right / noise
    found = {}
    for method, search in METHODS.items():
        offered = [np.zeros(0, dtype=np.int64), *search(normal, right)]
        best = min(offered, key=lambda s: len(s) * np.log(rows) - _fall(normal, right, s))
        alone = {
            name: _fall(normal, right, best[[names[k] == name for k in best]]) for name in {names[k] for k in best}
        }
        found[method] = sorted(alone, key=lambda name: -alone[name])
    return found


def thresholded(normal: Array, right: Array, low: float = 1e-4, high: float = 1.0) -> Iterable[Places]:
    """Sequentially thresholded least squares (doi:10.1073/pnas.1517384113), a set for each threshold."""
    for least in np.geomspace(low, high, THRESHOLDS):
        kept = np.arange(len(right))
        while len(kept):
            large = np.abs(_solved(normal, right, kept)) >= least
            if large.all():
                break
            kept = kept[large]
        yield kept


def forward(normal: Array, right: Array) -> Iterable[Places]:
    """The column that makes chi2 fall most, again and again."""
    kept: list[int] = []
    while len(kept) < len(right):
        rest = [k for k in range(len(right)) if k not in kept]
        kept.append(max(rest, key=lambda k: _fall(normal, right, np.array([*kept, k]))))
        yield np.array(kept)


def lasso(normal: Array, right: Array) -> Iterable[Places]:
    """The LASSO's path (doi:10.1111/j.2517-6161.1996.tb02080.x) by coordinate descent, columns of unit length."""
    length = np.sqrt(np.diag(normal))
    gram, pull = normal / np.outer(length, length), right / length
    x = np.zeros(len(pull))
    for penalty in np.geomspace(1.0, 1e-5, 40) * np.abs(pull).max():
        for _ in range(300):
            before = x.copy()
            for k in range(len(x)):
                slope = pull[k] + gram[k] @ x - x[k]
                x[k] = -np.sign(slope) * max(abs(slope) - penalty, 0.0)
            if np.abs(x - before).max() <= 1e-6 * max(float(np.abs(x).max()), 1e-12):
                break
        yield np.flatnonzero(x).astype(np.int64)


METHODS: dict[str, Callable[[Array, Array], Iterable[Places]]] = {
    "thresholded least squares": thresholded,
    "forward search": forward,
    "LASSO": lasso,
}


def _solved(normal: Array, right: Array, kept: Places) -> Array:
    block = normal[np.ix_(kept, kept)] + np.eye(len(kept))
    return np.asarray(-np.linalg.solve(block, right[kept]))


def _fall(normal: Array, right: Array, kept: Places) -> float:
    """Of chi2, where these columns are there."""
    return float(-right[kept] @ _solved(normal, right, kept)) if len(kept) else 0.0
