"""Which derivatives of the equations are made anew, and how: measured on a few segments of each stage.

A column costs as much as the equations themselves, for a change has to pass all inner effects, and all effects
together have dozens. But few inner effects answer to it, and few columns move from one step of a fit to the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from orchestrator.diagnosis.fitting.model import Answers, ColumnName, Fit, Model
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.types import Array

PROBE_EVERY: int = 16
"""Every so many-th segment of a stage shows which columns have changed, and which effects respond to which."""
MAX_COLUMN_CHANGE: float = 0.02
"""Relative change of a column below which it is not renewed on all segments: a step misses by as little."""
LEAST_RESPONSE: float = 0.001
"""Share of an inner effect's response in a column below which it is not computed. Where two effects nearly cancel,
the rest of both columns is as small: at 0.005 a descent ended a thousand nats above its valley."""
MAX_GROWTH_BEFORE_PROBE: float = 2.0
"""Growth of an effect beyond which its response is probed again."""


@dataclass(frozen=True)
class ColumnProbe:
    """All columns of one segment.

    Attributes
    ----------
    columns : array, shape (rows, columns)
        Whitened.
    answers : dict
        Squared norm of what an inner effect added to a column, by the column's place and the effect's name, where all
        effects were applied.
    """

    columns: Array
    answers: Mapping[tuple[int, str], float]


@dataclass(frozen=True)
class ColumnPlan:
    """How columns are made where they were not probed.

    Attributes
    ----------
    kept : dict
        Columns that are taken from an earlier fit, and their places there.
    answering : tuple of frozenset of str
        Of every column the inner effects that answer to it.
    """

    kept: Mapping[int, int]
    answering: tuple[frozenset[str], ...]

    @property
    def anew(self) -> list[int]:
        return [k for k in range(len(self.answering)) if k not in self.kept]

    def whole(self, made: Array, known: Array | None) -> Array:
        """All columns of a segment from those made anew and those of the earlier fit."""
        columns = np.empty((len(made), len(self.answering)))
        columns[:, self.anew] = made
        if known is not None:
            columns[:, list(self.kept)] = known[:, list(self.kept.values())]
        return columns


def probe_segments(pieces: Sequence[SegmentData]) -> tuple[int, ...]:
    """The segments that columns are probed on: a few of each stage, spread evenly; none that is held out."""
    stages: dict[object, list[int]] = {}
    for k, piece in enumerate(pieces):
        if not piece.held_out:
            stages.setdefault(piece.stage, []).append(k)
    every = PROBE_EVERY
    return tuple(sorted(k for places in stages.values() for k in places[min(every, len(places)) // 2 :: every]))


def known_answers(model: Model, known: Fit | None) -> Answers:
    """The answers of an earlier fit for these effects; none where they are others, or have grown since."""
    there = {a.name: a.relative_size for a in model.active if not a.is_absent}
    known_before = Answers() if known is None else known.answers
    if any(size > MAX_GROWTH_BEFORE_PROBE * known_before.sizes.get(name, 0.0) for name, size in there.items()):
        return Answers({}, there)
    return known_before


def column_plan(
    names: Sequence[ColumnName],
    probes: Mapping[int, ColumnProbe],
    known: Fit | None,
    previous: Mapping[ColumnName, frozenset[str]] = MappingProxyType({}),
) -> ColumnPlan:
    """What the probes say of columns on all other segments.

    Parameters
    ----------
    names : sequence of (str, str)
        Effect and parameter of every column.
    probes : dict
        By the segments' places.
    known : Fit, optional
        An earlier one, whose columns are kept where they are the same on the probed segments.
    previous : dict
        Of columns that were probed before, the inner effects that respond to them.
    """
    power = sum((np.sum(p.columns**2, axis=0) for p in probes.values()), np.zeros(len(names)))
    answers: dict[tuple[int, str], float] = {}
    for probe in probes.values():
        for key, value in probe.answers.items():
            answers[key] = answers.get(key, 0.0) + value
    responding = {key for key, value in answers.items() if value > LEAST_RESPONSE**2 * power[key[0]]}
    answering = tuple(
        previous[column] if column in previous else frozenset(name for j, name in responding if j == k)
        for k, column in enumerate(names)
    )
    return ColumnPlan({} if known is None else _kept(names, probes, power, known), answering)


def _kept(names: Sequence[ColumnName], probes: Mapping[int, ColumnProbe], power: Array, known: Fit) -> dict[int, int]:
    places = {name: j for j, name in enumerate(known.parameters)}
    kept = {}
    for k, name in enumerate(names):
        if (j := places.get(name)) is None:
            continue
        moved = sum(float(np.sum((p.columns[:, k] - known.columns[at][:, j]) ** 2)) for at, p in probes.items())
        if moved <= MAX_COLUMN_CHANGE**2 * power[k]:
            kept[k] = j
    return kept
