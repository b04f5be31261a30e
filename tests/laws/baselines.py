"""What sequentially thresholded least squares finds of the same leftover, over monomials at the same places.

The library of terms that SINDy would be given: x, x|x|, x^3 of each signed quantity, x and x^2 of every other, at each
place and phase that the search knows, in the same weak form, with R_s and the map eliminated. The voltage's gain is
left out: without voltage, resistance and flux the equations hold exactly. Of the thresholds' sets of up to `MAX_TERMS`
terms, that of the least Bayesian information criterion is fitted to the whole recording (S. L. Brunton, J. L. Proctor,
J. N. Kutz, PNAS 113 (2016) 3932, doi:10.1073/pnas.1517384113).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis._prepare import open_for_diagnosis
from orchestrator.diagnosis.fitting.baseline import fit_baseline
from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.chords import fit_with_frozen_jacobian
from orchestrator.discovery.bases import CurveBasis
from orchestrator.discovery.hypotheses import PHASE_NAMES, Hypothesis, Ranges, SharedColumns, hypotheses, names
from orchestrator.discovery.laws import error_of
from orchestrator.discovery.ranking import scales_voltage
from orchestrator.numerics.types import Array
from protocols import RecordingReader, SignalBatch
from tests.blind.baselines import _fall, _solved

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

    def columns(self, x: Array, batch: SignalBatch, mean: bool) -> Array:
        u = x.ravel() / self.top
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


def thresholded_terms(recording: RecordingReader) -> Thresholded:
    """The terms beside R_s and the map of a recording."""
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
    offered = list(_thresholded(normal, right))
    if not offered:
        return Thresholded([], 0, None, time.process_time() - start)
    best = min(offered, key=lambda kept: len(kept) * np.log(fit.dof) - _fall(normal, right, kept))
    first = max(best, key=lambda k: _fall(normal, right, np.array([k])))
    sizes = _solved(normal, right, best)
    terms: dict[str, tuple[Hypothesis, dict[str, float]]] = {}
    for k, size in zip(best, sizes, strict=True):
        one, name = of[shown[k]]
        terms.setdefault(one.key, (one, {}))[1][name] = float(size) * one.size
    active = [
        EffectTerm(one.candidate(), {n: values.get(n, 0.0) for n in names(one)}, tuple(values))
        for one, values in terms.values()
    ]
    whole = fit_with_frozen_jacobian(setup.fitter, bare.model.with_active(active), rounds=1, tolerance=1e-3)
    after = error_of(whole)
    hypothesis = of[shown[first]][0]
    named = [hypothesis.place.name, hypothesis.quantity.name, PHASE_NAMES[hypothesis.phases]]
    return Thresholded(named, len(best), after, time.process_time() - start)


def _thresholded(normal: Array, right: Array) -> Iterator[NDArray[np.int64]]:
    """Sets of terms, each of one threshold: solve, drop what is smaller, and again until nothing is."""
    for least in np.geomspace(1e-3, 1e4, 60):
        kept = np.arange(len(right))
        while len(kept):
            large = np.abs(_solved(normal, right, kept)) >= least
            if large.all():
                break
            kept = kept[large]
        if 0 < len(kept) <= MAX_TERMS:
            yield kept


def _monomial(hypothesis: Hypothesis) -> Hypothesis:
    basis = hypothesis.basis
    assert isinstance(basis, CurveBasis)
    top = max(abs(basis.low), abs(basis.high))
    return replace(hypothesis, basis=Monomials(top, basis.parity))
