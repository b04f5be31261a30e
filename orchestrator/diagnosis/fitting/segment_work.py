"""What is to be made of a recording's segments where a model stands: a job that any process can do a part of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from orchestrator.diagnosis.fitting.candidates import Active
from orchestrator.diagnosis.fitting.columns import ColumnProbe
from orchestrator.diagnosis.fitting.model import Frame, Model, SegmentFrame, SegmentRows
from orchestrator.diagnosis.fitting.segment_equations import Place, SegmentEquations
from orchestrator.diagnosis.weak_form.segments import SegmentSignals


class Framed(Protocol):
    """What is kept of a recording between steps, or of those segments that a helper has: a `Frame`, for one."""

    @property
    def pieces(self) -> Sequence[SegmentFrame] | Mapping[int, SegmentFrame]: ...


@dataclass(frozen=True)
class Stand:
    """Where a model stands in a recording.

    Attributes
    ----------
    equations : SegmentEquations
    pieces : sequence of SegmentSignals
    model : Model
    frame : Framed or None
        Of before.
    renewed : bool
        Whether a frame is made anew, as far as it changed since that of before; else the model stands in that one.
    """

    equations: SegmentEquations
    pieces: Sequence[SegmentSignals]
    model: Model
    frame: Framed | None
    renewed: bool

    def at(self, k: int) -> Place:
        """Where it stands in one segment."""
        before = None if self.frame is None else self.frame.pieces[k]
        if self.renewed:
            return self.equations.renewed(self.model, self.pieces[k], before)
        assert before is not None
        return self.equations.place(self.model, self.pieces[k], before)


@dataclass(frozen=True)
class Made:
    """What was made of one segment."""

    frame: SegmentFrame
    rows: SegmentRows | None = None
    """None where the frame alone was asked for."""
    probe: ColumnProbe | None = None
    """Where inner effects were asked."""


@dataclass(frozen=True)
class Job:
    """What is to be made of segments, each by itself.

    Attributes
    ----------
    stand : Stand
    columns : sequence of (Active, str) or None
        Parameters that columns are asked for, but of segments that are held out; None: no equations, the frame alone.
    answering : sequence of frozenset of str or None, optional
        Of every column the inner effects that answer to it; all by default.
    probing : bool
        Whether what inner effects have to do with each column is asked.
    """

    stand: Stand
    columns: Sequence[tuple[Active, str]] | None = ()
    answering: Sequence[frozenset[str] | None] | None = None
    probing: bool = False

    def made(self, k: int) -> Made:
        """Do it for one segment."""
        stand = self.stand
        at = stand.at(k)
        if self.columns is None:
            return Made(at.frame)
        if self.probing:
            return Made(at.frame, *stand.equations.probed(at, self.columns, self.answering or ()))
        columns = () if stand.pieces[k].held_out else self.columns
        return Made(at.frame, stand.equations.rows(at, columns, self.answering))


class Hands(Protocol):
    """Whoever does jobs."""

    def made(self, job: Job, which: Sequence[int]) -> dict[int, Made]:
        """What is made of some segments, by their numbers and in their order."""

    def keep(self, frame: Frame) -> None:
        """Hear that this frame was made of the segments of the last job."""


class OneHand:
    """One segment after the other, for places are large."""

    def made(self, job: Job, which: Sequence[int]) -> dict[int, Made]:
        """As `Hands` has it."""
        return {k: job.made(k) for k in which}

    def keep(self, frame: Frame) -> None:
        """Nothing: it has no part of it elsewhere."""
