"""Laws fitted by the diagnosis' own fitter: flexible ones, and written ones loaded from their text.

What is fitted is what is written: the text is loaded as a file of effects, and its class is the effect that is fitted.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, MachineScale, scaled_library
from orchestrator.diagnosis.fitting.chords import fit_with_frozen_jacobian
from orchestrator.diagnosis.fitting.fit import Fitter
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.reporting.ladder import held_out
from orchestrator.diagnosis.selection.scoring import log_evidence
from orchestrator.discovery.bases import Basis, CurveBasis, LineBasis
from orchestrator.discovery.forms import FormFit, without_gauge
from orchestrator.discovery.hypotheses import Hypothesis, term_of
from orchestrator.discovery.law import POWER_BOUNDS, WIDTH_OF_UNIT, Law, Line, Parameter, Table
from orchestrator.discovery.places import READING, of_three_sensors
from orchestrator.discovery.quantities import PHASE_CURRENT
from orchestrator.discovery.ranking import MAX_CHANGE_OF_RESISTANCE, Score, scales_voltage
from orchestrator.discovery.writing import NamedLaw, source_of
from orchestrator.numerics.types import Array
from orchestrator.registry.plugins import load_effects_file
from protocols import Effect

FLEXIBLE_ROUNDS: int = 2
"""Relinearisations of a flexible law's fit."""
TABLE_POINTS: int = 32
"""Points of a table."""


@dataclass(frozen=True)
class FittedLaw:
    """A law in a fit of the whole recording.

    Attributes
    ----------
    law : Law or None
        None for a flexible law.
    hypothesis : Hypothesis
    fit : Fit
        With the law, R_s, map and all effects fitted; the law is the last term.
    """

    law: Law | None
    hypothesis: Hypothesis
    fit: Fit

    @property
    def term(self) -> EffectTerm:
        return self.fit.model.active[-1]

    @property
    def chi2(self) -> float:
        """Per degree of freedom, of the fitted stages."""
        return self.fit.chi2_per_dof

    @property
    def error(self) -> float:
        """rms of the held-out residual, in units of its noise; of the fitted one where nothing is held out."""
        return error_of(self.fit)

    def log_evidence(self, noise: float) -> float:
        return log_evidence(self.fit, noise)


def error_of(fit: Fit) -> float:
    """rms of the held-out residual, in units of its noise; of the fitted one where nothing is held out."""
    chi2 = fit.chi2_of(held_out)
    return float(np.sqrt(fit.chi2_per_dof if chi2 is None else chi2))


def keeps_scale(fitted: FittedLaw, before: Fit) -> bool:
    """Whether a law leaves the equations their size; one of the voltage's gain may make all of them vanish."""
    moved = abs(fitted.fit.model.r_s - before.model.r_s)
    return not scales_voltage(fitted.hypothesis) or moved <= MAX_CHANGE_OF_RESISTANCE * abs(before.model.r_s)


def fit_flexible(fitter: Fitter, fit: Fit, score: Score) -> FittedLaw:
    """A flexible law beside a model, with the prior width that the ranking found."""
    hypothesis = replace(score.hypothesis, size=max(score.width, 1e-3 * score.hypothesis.size))
    # From zero the first step moves all that is fitted along with the law: a level that an effect of the model
    # compensates would be far off otherwise.
    term = term_of(hypothesis, np.zeros(len(score.coefficients)))
    # A flexible law is linear in its coefficients but for the map's curvature: its columns hold for several steps.
    grown = fit.model.with_active([*fit.model.active, term])
    fitted = fit_with_frozen_jacobian(fitter, grown, rounds=FLEXIBLE_ROUNDS, tolerance=1e-4, known=fit)
    return FittedLaw(None, hypothesis, fitted)


def score_of(flexible: FittedLaw) -> Score:
    """A flexible law as fitted, with the covariance of its coefficients; a sensor's odd error over the true current."""
    term, fit = flexible.term, flexible.fit
    count = len(term.free)
    noise = max(fit.chi2_per_dof, 1.0)
    widths = np.array([term.candidate.named(n).prior_width for n in term.free])
    covariance = fit.covariance(noise)[-count:, -count:] * np.outer(widths, widths)
    coefficients = np.array([term.values[n] for n in term.free])
    hypothesis = flexible.hypothesis
    if hypothesis.place is READING and hypothesis.quantity is PHASE_CURRENT:
        basis, coefficients = _over_true_current(hypothesis.basis, coefficients)
        hypothesis = replace(hypothesis, basis=basis)
    return Score(hypothesis, 0.0, fit.chi2, coefficients, covariance, 0.0, float(widths[0]))


def _over_true_current(basis: Basis, coefficients: Array) -> tuple[CurveBasis, Array]:
    """A sensor's error over the true current, of a curve over the reading: x = r - y(r)."""
    assert isinstance(basis, CurveBasis)
    reading = basis.grid(12 * basis.cells)
    error = basis.design(reading) @ coefficients
    if basis.parity != "odd":
        # The readings of both signs belong to different true currents.
        return basis, coefficients
    true = reading - error
    over = replace(basis, high=float(true.max()))
    return over, np.asarray(np.linalg.lstsq(over.design(true), error, rcond=None)[0], dtype=np.float64)


def table_of(score: Score) -> Table | None:
    """A flexible curve as a table; None of a law with memory."""
    basis = score.hypothesis.basis
    if not isinstance(basis, CurveBasis):
        return None
    x = basis.grid(TABLE_POINTS)
    y = without_gauge(score.hypothesis, x, basis.design(x) @ score.coefficients)
    top, size = float(np.abs(x).max()), float(np.abs(y).max())
    return Table(x / top, y / size, top, size, basis.parity) if size > 0.0 and top > 0.0 else None


def line_of(score: Score) -> Line | None:
    """A flexible line as it is written; None of another law."""
    basis = score.hypothesis.basis
    if not isinstance(basis, LineBasis):
        return None
    return Line(tuple(map(float, score.coefficients)), basis.frequency_hz, basis.spacing_hz)


def fit_law(setup: DiagnosisSetup, fit: Fit, law: Law, name: str) -> FittedLaw:
    """A law beside a model, fitted as the effect that its text defines."""
    candidate = candidate_of(setup, law, name)
    free = tuple(
        p.name for p in candidate.parameters if p.prior_width != WIDTH_OF_UNIT or p.name in candidate.amplitudes
    )
    term = EffectTerm(candidate, {p.name: p.typical for p in candidate.parameters}, free)
    fitter = setup.fitter
    with_law = fitter.fit(fit.model.with_active([*fit.model.active, term]), fit.linearisation, relinearisations=1)
    return FittedLaw(law, law.hypothesis, with_law)


def candidate_of(setup: DiagnosisSetup, law: Law, name: str) -> CandidateEffect:
    """The effect of a law's text, scaled to the machine."""
    return scaled_library([loaded(text_of(setup, [NamedLaw(law, name)]))], setup.prepared.manifest)[0]


def text_of(setup: DiagnosisSetup, laws: Sequence[NamedLaw]) -> str:
    """The file of some laws for this recording's machine and sensors."""
    scale = MachineScale.of(setup.prepared.manifest)
    factors = {p.unit: scale.of_unit(p.unit) for one in laws for p in one.law.parameters}
    return source_of(laws, factors, of_three_sensors(setup.fitter.batches.all[0].signals))


def loaded(text: str) -> Effect:
    """The effect that a file's text defines."""
    with tempfile.TemporaryDirectory(prefix="law-") as folder:
        path = Path(folder) / "law.py"
        path.write_text(text, encoding="utf-8")
        effect: Effect = load_effects_file(path)[0]()
    return effect


def with_fitted_constants(fitted: FittedLaw) -> Law:
    """A law whose constants are those of its fit."""
    assert fitted.law is not None
    law, values = fitted.law, fitted.term.values
    by_name = {p.name: values[p.name] for p in law.parameters}
    size, *shapes = (by_name[p.name] for p in law.parameters)
    form: FormFit | Table | Line
    if isinstance(law.form, Line):
        form = replace(law.form, sizes=(size, *shapes[:-1]), frequency_hz=shapes[-1])
    elif isinstance(law.form, Table):
        form = replace(law.form, size=size, top=shapes[0])
    else:
        changes: dict[str, Any] = {"size": size}
        for key, value in zip(_shape_fields(law.parameters), shapes, strict=True):
            changes[key] = value
        form = replace(law.form, **changes)
    return replace(law, form=form)


def _shape_fields(parameters: Sequence[Parameter]) -> list[str]:
    return ["power" if p.name in POWER_BOUNDS else "scale" for p in parameters[1:]]
