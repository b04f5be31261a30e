"""One evaluation of a model on a recording, batch by batch: each is a task that any worker can do by itself."""

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
"""Effects with one of their parameters each, by which derivatives are wanted."""


@dataclass(frozen=True)
class RecordingBatches:
    """How a recording's segments are dealt out for their equations to be evaluated.

    Attributes
    ----------
    pieces : tuple of SegmentData
        The recording's.
    probes : tuple of SegmentBatch
        A few segments of each stage, which are evaluated first and show what has changed.
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
    frame : BatchLinearisation or None
        Of an earlier evaluation.
    renew : bool
        Whether the frame is renewed, as far as it changed since; else the model is evaluated in that one.
    columns : sequence of (EffectTerm, str) or None
        Parameters to differentiate by; None: the frame alone, without equations. What is held out has no columns.
    answering : sequence of frozenset of str or None, optional
        Of every column the inner effects that answer to it; all by default.
    probing : bool
        Whether to measure what each inner effect adds to each column.
    """

    batch: SegmentBatch
    frame: BatchLinearisation | None
    renew: bool
    columns: Columns | None
    answering: Sequence[frozenset[str] | None] | None = None
    probing: bool = False


@dataclass(frozen=True)
class BatchResult:
    """Linearisation, equations and probes of one batch, each segment's in the batch's order."""

    frame: BatchLinearisation
    rows: Sequence[SegmentRows] = ()
    probes: Sequence[ColumnProbe] = ()

    @property
    def rows_by_place(self) -> dict[int, SegmentRows]:
        return dict(zip(self.frame.batch.places, self.rows, strict=True))

    @property
    def probes_by_place(self) -> dict[int, ColumnProbe]:
        return dict(zip(self.frame.batch.places, self.probes, strict=True))


def evaluate_batch(equations: WeakFormEquations, model: Model, task: BatchTask) -> BatchResult:
    """Do a task."""
    if task.renew:
        state = equations.renewed(model, task.batch, task.frame)
    else:
        assert task.frame is not None
        state = equations.at(model, task.frame)
    if task.columns is None:
        return BatchResult(state.frame)
    if task.probing:
        return BatchResult(state.frame, *equations.probed(state, task.columns, task.answering or ()))
    columns = () if task.batch.pieces[0].held_out else task.columns
    return BatchResult(state.frame, equations.rows(state, columns, task.answering))
