"""Evaluation of a model on a recording as independent tasks, one per batch of segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from orchestrator.diagnosis.fitting.candidates import EffectTerm
from orchestrator.diagnosis.fitting.columns import ColumnProbe, probe_segments
from orchestrator.diagnosis.fitting.equations import WeakFormEquations
from orchestrator.diagnosis.fitting.model import BatchLinearisation, Model, SegmentRows
from orchestrator.diagnosis.weak_form.batches import SegmentBatch, in_batches
from orchestrator.diagnosis.weak_form.segments import PreparedRecording, SegmentData

Columns = Sequence[tuple[EffectTerm, str]]
"""Pairs of an effect and a parameter to differentiate by."""


@dataclass(frozen=True)
class RecordingBatches:
    """A recording's segments grouped for evaluation.

    Attributes
    ----------
    pieces : tuple of SegmentData
        All segments of the recording.
    probes : tuple of SegmentBatch
        A few segments of each stage, evaluated first to find the columns that have changed.
    others : tuple of SegmentBatch
    """

    pieces: tuple[SegmentData, ...]
    probes: tuple[SegmentBatch, ...]
    others: tuple[SegmentBatch, ...]

    @classmethod
    def of(cls, prepared: PreparedRecording) -> RecordingBatches:
        """All segments of a recording."""
        probes = probe_segments(prepared.pieces)
        return cls(prepared.pieces, *in_batches(prepared.pieces, probes))

    def with_voltages_of(self, prepared: PreparedRecording) -> RecordingBatches:
        """The groups of the same recording with other voltages, which share all other arrays."""
        probes, others = (
            tuple(batch.with_voltages_of(prepared.pieces) for batch in batches)
            for batches in (self.probes, self.others)
        )
        return RecordingBatches(prepared.pieces, probes, others)

    @property
    def all(self) -> tuple[SegmentBatch, ...]:
        return (*self.probes, *self.others)


NO_BATCHES = RecordingBatches((), (), ())


@dataclass(frozen=True)
class BatchTask:
    """The evaluation of one batch.

    Attributes
    ----------
    batch : SegmentBatch
    linearisation : BatchLinearisation or None
        Linearisation of an earlier evaluation.
    renew : bool
        Whether to linearise anew where the model has moved; else the model is evaluated with the linearisation.
    columns : sequence of (EffectTerm, str) or None
        Parameters to differentiate by; None: only linearise. Held-out segments have no columns.
    answering : sequence of frozenset of str or None, optional
        For each column, the inner effects that respond to it; all by default.
    probing : bool
        Whether to measure the contribution of each inner effect to each column.
    """

    batch: SegmentBatch
    linearisation: BatchLinearisation | None
    renew: bool
    columns: Columns | None
    answering: Sequence[frozenset[str] | None] | None = None
    probing: bool = False


@dataclass(frozen=True)
class BatchResult:
    """Linearisation, equations and probes of one batch, each segment's in the batch's order."""

    linearisation: BatchLinearisation
    rows: Sequence[SegmentRows] = ()
    probes: Sequence[ColumnProbe] = ()

    @property
    def rows_by_place(self) -> dict[int, SegmentRows]:
        return dict(zip(self.linearisation.batch.places, self.rows, strict=True))

    @property
    def probes_by_place(self) -> dict[int, ColumnProbe]:
        return dict(zip(self.linearisation.batch.places, self.probes, strict=True))


def evaluate_batch(equations: WeakFormEquations, model: Model, task: BatchTask) -> BatchResult:
    """Run a task."""
    if task.renew:
        state = equations.relinearise(model, task.batch, task.linearisation)
    else:
        assert task.linearisation is not None
        state = equations.at(model, task.linearisation)
    if task.columns is None:
        return BatchResult(state.linearisation)
    if task.probing:
        return BatchResult(state.linearisation, *equations.probed(state, task.columns, task.answering or ()))
    columns = () if task.batch.pieces[0].held_out else task.columns
    return BatchResult(state.linearisation, equations.rows(state, columns, task.answering))
