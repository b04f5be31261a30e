"""What equations say of every effect of a library, in one normal matrix of all that is unknown; decides nothing.

Unknown are R_s, the map's coefficients, and of each effect its amplitudes (the secant to its typical size, where it is
not there) and its forms, shapes and refinements (the slope there, where it is as large as is typical). With prior
precisions P on the diagonal, what is left of some columns when others follow is a Schur complement,

    M_t|f = N_tt - N_tf (N_ff + P_ff)^-1 N_ft

An effect of another shape is another column, too far away for a slope: each is there in several shapes.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis.experiment_design.rehearsal import Rehearsal
from orchestrator.diagnosis.fitting.candidates import Active, Candidate, typical_coordinate
from orchestrator.diagnosis.fitting.model import SegmentFrame
from orchestrator.diagnosis.weak_form.segments import SegmentSignals
from orchestrator.numerics.types import Array
from protocols import ParameterRole

Places = NDArray[np.int64]


@dataclass(frozen=True)
class Variant:
    """An effect in one shape.

    Attributes
    ----------
    there : Active
        At its typical size.
    cost : float
        Of the shape by its prior, in chi2.
    amplitudes, forms : array of int
        Places of its columns in the matrix.
    """

    there: Active
    cost: float
    amplitudes: Places
    forms: Places

    @property
    def columns(self) -> Places:
        return np.concatenate([self.amplitudes, self.forms])

    @property
    def absent(self) -> Active:
        """In this shape, at no size."""
        candidate = self.there.candidate
        neutral = {n: candidate.named(n).neutral for n in candidate.amplitudes}
        return replace(self.there, values={**self.there.values, **neutral})

    @property
    def typical(self) -> Array:
        """Coordinates of the amplitudes at the typical size."""
        candidate = self.there.candidate
        return np.array([typical_coordinate(candidate.named(n)) for n in candidate.amplitudes])


Unknowns = dict[str, tuple[Variant, ...]]
"""Each effect in its typical shape, and in others; R_s and the map have the first places of the matrix."""


def unknowns(machine: int, library: Sequence[Candidate], shapes: Sequence[float]) -> Unknowns:
    """Places for all effects behind the machine's own unknowns, shapes at some coordinates of their prior."""
    end, found = machine, dict[str, tuple[Variant, ...]]()
    for candidate in library:
        variants = []
        first = candidate.of_role(ParameterRole.SHAPE)[:1]
        forms = candidate.of_role(ParameterRole.SHAPE, ParameterRole.REFINEMENT)
        for x in (0.0, *shapes) if first else (0.0,):
            there = Active(candidate, _at_typical(candidate), ())
            split = end + len(candidate.amplitudes)
            there = there.moved(first[0], x) if first else there
            variants.append(Variant(there, x * x, np.arange(end, split), np.arange(split, split + len(forms))))
            end = split + len(forms)
        found[candidate.name] = tuple(variants)
    return found


def _at_typical(candidate: Candidate) -> dict[str, float]:
    typical = {n: candidate.named(n).typical for n in candidate.amplitudes}
    return {**candidate.absent().values, **typical}


@dataclass(frozen=True)
class Information:
    """What a plan says of its unknowns.

    Attributes
    ----------
    machine : int
        Columns of R_s and the map.
    effects : dict of str to tuple of Variant
    pieces : array, shape (pieces, n, n)
        Normal matrix of each piece of a rehearsal, as often as it stands for its like.
    prior : array, shape (n, n)
        Precisions: of the map's roughness, and one for each coordinate of an effect.
    stages : tuple of int
        Place in the plan of each piece's stage.
    """

    machine: int
    effects: Unknowns
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

    def left(self, normal: Array, effect: str, *others: Variant) -> Array:
        """Normal matrix of an effect's amplitudes, its shape typical, when R_s, the map and others follow them."""
        target = self.effects[effect][0].amplitudes
        follow = np.concatenate([np.arange(self.machine), *(other.columns for other in others)])
        inner = normal[np.ix_(follow, follow)] + self.prior[np.ix_(follow, follow)]
        across = normal[np.ix_(follow, target)]
        rest = normal[np.ix_(target, target)] - across.T @ np.linalg.solve(inner, across)
        return np.asarray(0.5 * (rest + rest.T))


def information(
    rehearsal: Rehearsal, library: Sequence[Candidate], of_stages: Collection[int] | None = None
) -> Information:
    """All that a rehearsed plan, or some stages of it, say of a library's effects."""
    model, whole = rehearsal.model, rehearsal.setup.fitter
    use = [k for k, stage in enumerate(rehearsal.stages) if of_stages is None or stage in of_stages]
    prepared = replace(whole.prepared, pieces=tuple(whole.prepared.pieces[k] for k in use))
    fitter = replace(whole, prepared=prepared)
    machine = 1 + model.space.directions.shape[1]
    effects = unknowns(machine, library, fitter.prepared.criteria.selection.shape_starts)
    frame = fitter.frame(model)
    weighed = zip(use, prepared.pieces, frame.pieces, strict=True)
    pieces = [rehearsal.weights[k] * piece_information(rehearsal, effects, piece, kept) for k, piece, kept in weighed]
    prior = np.eye(pieces[0].shape[0])
    prior[0, 0] = 0.0
    prior[1:machine, 1:machine] = model.space.prior.T @ model.space.prior
    return Information(machine, effects, np.stack(pieces), prior, tuple(rehearsal.stages[k] for k in use))


def piece_information(rehearsal: Rehearsal, effects: Unknowns, piece: SegmentSignals, frame: SegmentFrame) -> Array:
    """Normal matrix of one piece."""
    model, equations = rehearsal.model, rehearsal.setup.fitter.equations
    variants = [variant for of_effect in effects.values() for variant in of_effect]
    amplitudes = [(v.absent, n) for v in variants for n in v.there.candidate.amplitudes]
    white = equations.rows(model, piece, frame, amplitudes).white[:, 1:]
    columns, taken = [white[:, :1], frame.white_basis], 1
    for v in variants:
        columns.append(white[:, taken : taken + len(v.amplitudes)])
        taken += len(v.amplitudes)
        if len(v.forms):
            wanted = [(v.there, n) for n in v.there.candidate.of_role(ParameterRole.SHAPE, ParameterRole.REFINEMENT)]
            columns.append(equations.rows(model.with_active([v.there]), piece, frame, wanted).white[:, 2:])
    together = np.column_stack(columns)
    return np.asarray(together.T @ together)
