"""The information of a plan on every effect of a library, in one normal matrix of all unknowns.

Unknown are R_s, the map's coefficients, and of each effect its amplitudes (the secant from zero to its typical size)
and its shape and refinement parameters (the slope at its typical size). With prior precisions P on the diagonal, the
information on parameters t when f are nuisance parameters is a Schur complement,

    M_t|f = N_tt - N_tf (N_ff + P_ff)^-1 N_ft

Effects are nonlinear in their shapes: alternative shapes get their own columns, which span those in between.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis.fitting.candidates import CandidateEffect, EffectTerm, typical_standardised_value
from orchestrator.diagnosis.fitting.model import BatchLinearisation
from orchestrator.experiment_design.rehearsal import Rehearsal
from orchestrator.numerics.types import Array
from protocols import ParameterRole

ALTERNATIVE_SHAPES: tuple[float, ...] = (-2.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5, 2.0)
"""Other shapes in which an effect may be confounded with another one, in standard deviations of the prior."""

ColumnIndex = NDArray[np.int64]


@dataclass(frozen=True)
class EffectColumns:
    """The columns of an effect in the normal matrix.

    Attributes
    ----------
    at_typical : EffectTerm
        The effect at its typical size and shape.
    shapes : tuple of EffectTerm
        The effect absent, in its typical shape and in others.
    amplitudes, forms, alternative_amplitudes : array of int
        Indices of its amplitudes and shape parameters in the typical shape; of its amplitudes in alternative shapes.
    """

    at_typical: EffectTerm
    shapes: tuple[EffectTerm, ...]
    amplitudes: ColumnIndex
    forms: ColumnIndex
    alternative_amplitudes: ColumnIndex

    @classmethod
    def of(cls, candidate: CandidateEffect, first: int, shapes: Sequence[float]) -> EffectColumns:
        """Columns from the index `first` on; shapes in standard deviations of their prior."""
        absent = candidate.absent()
        sizes = {n: candidate.named(n).typical for n in candidate.amplitudes}
        shape = candidate.of_role(ParameterRole.SHAPE)[:1]
        alternatives = [absent.moved(name, x) for name in shape for x in shapes]
        counts = [len(sizes), len(candidate.of_role(*_FORMS)), len(sizes) * len(alternatives)]
        places = np.split(np.arange(first, first + sum(counts)), np.cumsum(counts)[:-1])
        return cls(EffectTerm(candidate, {**absent.values, **sizes}, ()), (absent, *alternatives), *places)

    @property
    def forms_named(self) -> tuple[str, ...]:
        return self.at_typical.candidate.of_role(*_FORMS)

    @property
    def in_typical_shape(self) -> ColumnIndex:
        return np.concatenate([self.amplitudes, self.forms])

    @property
    def all(self) -> ColumnIndex:
        return np.concatenate([self.amplitudes, self.forms, self.alternative_amplitudes])

    @property
    def typical(self) -> Array:
        """Standardised values of the amplitudes at the typical size."""
        candidate = self.at_typical.candidate
        return np.array([typical_standardised_value(candidate.named(n)) for n in candidate.amplitudes])


_FORMS = (ParameterRole.SHAPE, ParameterRole.REFINEMENT)


@dataclass(frozen=True)
class Information:
    """The information of a plan on its unknowns.

    Attributes
    ----------
    machine_columns : int
        Columns of R_s and the map.
    effects : dict of str to EffectColumns
    pieces : array, shape (pieces, n, n)
        Normal matrix of each piece of a rehearsal, times its weight.
    prior : array, shape (n, n)
        Precisions: of the map's roughness, and one for each standardised value of an effect.
    stages : tuple of int
        Index in the plan of each piece's stage.
    """

    machine_columns: int
    effects: dict[str, EffectColumns]
    pieces: Array
    prior: Array
    stages: tuple[int, ...]

    def of_stages(self, wanted: Collection[int]) -> Array:
        """Normal matrix of some stages, without the prior."""
        return np.asarray(self.pieces[[stage in wanted for stage in self.stages]].sum(axis=0))

    @property
    def total(self) -> Array:
        """Normal matrix of the whole plan, without the prior."""
        return np.asarray(self.pieces.sum(axis=0))

    def marginal(self, normal: Array, effect: str, *others: ColumnIndex) -> Array:
        """Normal matrix of an effect's amplitudes in its typical shape, with R_s, the map and `others` as nuisances."""
        target = self.effects[effect].amplitudes
        nuisance = np.concatenate([np.arange(self.machine_columns), *others])
        inner = normal[np.ix_(nuisance, nuisance)] + self.prior[np.ix_(nuisance, nuisance)]
        across = normal[np.ix_(nuisance, target)]
        schur_complement = normal[np.ix_(target, target)] - across.T @ np.linalg.solve(inner, across)
        return np.asarray(0.5 * (schur_complement + schur_complement.T))


def information(
    rehearsal: Rehearsal, library: Sequence[CandidateEffect], of_stages: Collection[int] | None = None
) -> Information:
    """The information of a rehearsed plan, or of some of its stages, on a library's effects."""
    model, whole = rehearsal.model, rehearsal.setup.fitter
    use = [k for k, stage in enumerate(rehearsal.stages) if of_stages is None or stage in of_stages]
    prepared = replace(whole.prepared, pieces=tuple(whole.prepared.pieces[k] for k in use))
    fitter = replace(whole, prepared=prepared)
    machine_columns = 1 + model.space.directions.shape[1]
    end, effects = machine_columns, dict[str, EffectColumns]()
    for candidate in library:
        effects[candidate.name] = columns = EffectColumns.of(candidate, end, ALTERNATIVE_SHAPES)
        end += len(columns.all)
    linearisation = fitter.linearise(model)
    normals = {
        k: normal
        for batch in linearisation.batches
        for k, normal in batch_information(rehearsal, effects.values(), batch)
    }
    pieces = [rehearsal.weights[at] * normals[k] for k, at in enumerate(use)]
    prior = np.eye(pieces[0].shape[0])
    prior[0, 0] = 0.0
    prior[1:machine_columns, 1:machine_columns] = model.space.prior.T @ model.space.prior
    return Information(machine_columns, effects, np.stack(pieces), prior, tuple(rehearsal.stages[k] for k in use))


def batch_information(
    rehearsal: Rehearsal, effects: Collection[EffectColumns], linearisation: BatchLinearisation
) -> Iterator[tuple[int, Array]]:
    """Normal matrix of each segment of a batch, with its index among the rehearsed ones."""
    model, equations = rehearsal.model, rehearsal.setup.fitter.equations
    amplitudes = [(shape, n) for e in effects for shape in e.shapes for n in e.at_typical.candidate.amplitudes]
    amplitude_rows = equations.rows(equations.at(model, linearisation), amplitudes)
    forms = {}
    for e in effects:
        if e.forms_named:
            evaluation = equations.at(model.with_active([e.at_typical]), linearisation)
            forms[e.at_typical.name] = equations.rows(evaluation, [(e.at_typical, n) for n in e.forms_named])
    for j, (place, basis) in enumerate(zip(linearisation.batch.places, linearisation.pieces, strict=True)):
        white = amplitude_rows[j].white[:, 1:]
        columns, start = [white[:, :1], basis.white_basis], 1
        for e in effects:
            split, end = start + len(e.amplitudes), start + len(e.amplitudes) + len(e.alternative_amplitudes)
            columns.append(white[:, start:split])
            if e.forms_named:
                columns.append(forms[e.at_typical.name][j].white[:, 2:])
            columns.append(white[:, split:end])
            start = end
        together = np.column_stack(columns)
        yield place, np.asarray(together.T @ together)
