"""What others find of the same leftover: thresholded least squares, pySINDy's own, and symbolic regression by gplearn.

The library of terms that SINDy would be given: x, x|x|, x^3 of each signed quantity, x and x^2 of every other, at each
place and phase that the search knows, in the same weak form, with R_s and the map eliminated. The voltage's gain is
left out: without voltage, resistance and flux the equations hold exactly. Of the thresholds' sets of up to `MAX_TERMS`
terms, that of the least Bayesian information criterion is fitted to the whole recording (S. L. Brunton, J. L. Proctor,
J. N. Kutz, PNAS 113 (2016) 3932, doi:10.1073/pnas.1517384113). pySINDy and gplearn are used where they are installed.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, fit_baseline
from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.chords import fit_with_frozen_jacobian
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.discovery.bases import CurveBasis
from orchestrator.discovery.hypotheses import PHASE_NAMES, Hypothesis, Ranges, SharedColumns, hypotheses, names
from orchestrator.discovery.laws import error_of
from orchestrator.discovery.ranking import scales_voltage
from orchestrator.numerics.types import Array
from protocols import FluxbenchError, RecordingReader, SignalBatch
from tests.blind.baselines import _fall, _solved, thresholded
from tests.laws.symbolic import symbolic_law

MAX_TERMS = 10
"""Of a set."""


@dataclass(frozen=True)
class Monomials:
    """x, x|x|, x^3 where a curve is odd, x^2 and x^4 where it is even, else x and x^2, in units of the largest x."""

    top: float
    parity: str
    kind: str = "monomials"

    @property
    def size(self) -> int:
        return 3 if self.parity == "odd" else 2

    def design(self, x: Array) -> Array:
        return self._rows(x).T

    def columns(self, x: Array, batch: SignalBatch, mean: bool) -> Array:
        return self._rows(x.ravel())

    def _rows(self, x: Array) -> Array:
        u = x / self.top
        rows = {"odd": (u, u * np.abs(u), u**3), "even": (u**2, u**4), "none": (u, u**2)}[self.parity]
        return np.stack(rows)


@dataclass(frozen=True)
class Thresholded:
    """The terms that are kept.

    Attributes
    ----------
    first : list of str
        Place, quantity and phase of the term that alone makes chi2 fall most.
    terms : int
    after : float or None
        Held-out rms in units of its noise with all of them; None where no set is as small.
    cpu_s : float
    """

    first: list[str]
    terms: int
    after: float | None
    cpu_s: float


def thresholded_terms(recording: RecordingReader) -> dict[str, dict[str, Any]]:
    """What each method leaves beside R_s and the map of a recording: fields of `Thresholded`, and of `Symbolic`."""
    start = time.process_time()
    setup = open_for_diagnosis(recording)
    bare = fit_baseline(setup)
    fit = setup.part_fitter.fit(bare.model, relinearisations=0)
    every = [one for one in hypotheses(Ranges.in_fit(fit)) if not scales_voltage(one)]
    library = [_monomial(one) for one in every if type(one.basis) is CurveBasis]
    shared = SharedColumns()
    columns = [(one.candidate(shared).absent(), name) for one in library for name in names(one)]
    of = [(one, name) for one in library for name in names(one)]
    normal, right = setup.part_fitter.evaluate(fit.model, fit.linearisation, columns, known=fit).projected()
    shown = np.flatnonzero(np.diag(normal) > 0.0)
    normal, right = normal[np.ix_(shown, shown)], right[shown]
    noise = max((fit.chi2 - _fall(normal, right, np.arange(len(right)))) / fit.dof, 1.0)
    normal, right = normal / noise, right / noise
    of = [of[k] for k in shown]
    common = time.process_time() - start
    found: dict[str, dict[str, Any]] = {}
    for method, search in (("thresholded", _thresholded), ("pysindy", _by_pysindy)):
        start = time.process_time()
        sets = [kept for kept in search(normal, right) if 0 < len(kept) <= MAX_TERMS]
        if sets or method == "thresholded":
            chosen = _chosen(setup, bare, fit.dof, normal, right, of, sets)
            found[method] = asdict(replace(chosen, cpu_s=common + time.process_time() - start))
    if (symbolic := symbolic_law(bare)) is not None:
        found["gplearn"] = asdict(symbolic)
    return found


def _chosen(
    setup: DiagnosisSetup,
    bare: Fit,
    dof: float,
    normal: Array,
    right: Array,
    of: Sequence[tuple[Hypothesis, str]],
    sets: Sequence[NDArray[np.int64]],
) -> Thresholded:
    """The set of the least information criterion, fitted to the whole recording."""
    if not sets:
        return Thresholded([], 0, None, 0.0)
    best = min(sets, key=lambda kept: len(kept) * np.log(dof) - _fall(normal, right, kept))
    first = max(best, key=lambda k: _fall(normal, right, np.array([k])))
    terms: dict[str, tuple[Hypothesis, dict[str, float]]] = {}
    for k, size in zip(best, _solved(normal, right, best), strict=True):
        one, name = of[k]
        terms.setdefault(one.key, (one, {}))[1][name] = float(size) * one.size
    active = [
        EffectTerm(one.candidate(), {n: values.get(n, 0.0) for n in names(one)}, tuple(values))
        for one, values in terms.values()
    ]
    hypothesis = of[first][0]
    named = [hypothesis.place.name, hypothesis.quantity.name, PHASE_NAMES[hypothesis.phases]]
    try:
        whole = fit_with_frozen_jacobian(setup.fitter, bare.model.with_active(active), rounds=1, tolerance=1e-3)
    except FluxbenchError:
        # Powers of a reading that is corrected by itself may have no true current.
        return Thresholded(named, len(best), None, 0.0)
    return Thresholded(named, len(best), error_of(whole), 0.0)


def _thresholded(normal: Array, right: Array) -> Iterable[NDArray[np.int64]]:
    return thresholded(normal, right, 1e-3, 1e4)


def _by_pysindy(normal: Array, right: Array) -> Iterator[NDArray[np.int64]]:
    """The sets of pySINDy's optimiser, of columns with these products; none where it is not installed."""
    try:
        sindy = import_module("pysindy")
    except ImportError:
        return
    size = np.sqrt(np.diag(normal))
    values, turn = np.linalg.eigh(normal / np.outer(size, size))
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    columns, target = (turn * root).T, (turn / root).T @ (right / size)
    for least in np.geomspace(1e-3, 1e4, 60) * np.linalg.norm(target) / np.sqrt(len(target)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            optimiser = sindy.STLSQ(threshold=least, alpha=0.0, max_iter=50).fit(columns, target[:, None])
        yield np.flatnonzero(np.asarray(optimiser.coef_)[0])


def _monomial(hypothesis: Hypothesis) -> Hypothesis:
    basis = hypothesis.basis
    assert isinstance(basis, CurveBasis)
    top = max(abs(basis.low), abs(basis.high))
    return replace(hypothesis, basis=Monomials(top, basis.parity))
