"""Choice of the Jacobian's columns to recompute, from probes on a few segments of each stage.

A column costs as much as the residual if its change is propagated through all inner effects, and all effects together
have dozens. But few inner effects respond to it, and few columns change from one step of a fit to the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from orchestrator.diagnosis.fitting.model import ColumnName, Fit, Model, Responses
from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.numerics.types import Array

PROBE_EVERY: int = 16
"""One in this many segments of a stage is a probe."""
MAX_COLUMN_CHANGE: float = 0.02
"""Relative change of a column on the probes below which it is reused on the other segments."""
MIN_RESPONSE: float = 0.001
"""Share of an inner effect's response in a column below which it is not computed. Where two effects nearly cancel, the
difference of their columns is as small: at 0.005 a descent ended a thousand nats above the minimum."""
MAX_GROWTH_BEFORE_PROBE: float = 2.0
"""Growth of an effect beyond which its response is probed again."""


@dataclass(frozen=True)
class ColumnProbe:
    """All columns of one segment.

    Attributes
    ----------
    columns : array, shape (rows, columns)
        Whitened columns.
    responses : dict
        Squared norm of an inner effect's contribution to a column, by the column's index and the effect's name.
    """

    columns: Array
    responses: Mapping[tuple[int, str], float]


@dataclass(frozen=True)
class ColumnPlan:
    """Plan of the columns on the segments that are not probes.

    Attributes
    ----------
    kept : dict
        Indices of columns reused from an earlier fit, and their indices there.
    answering : tuple of frozenset of str
        For each column, the inner effects that respond to it.
    """

    kept: Mapping[int, int]
    answering: tuple[frozenset[str], ...]

    @property
    def anew(self) -> list[int]:
        return [k for k in range(len(self.answering)) if k not in self.kept]

    def whole(self, renewed: Array, known: Array | None) -> Array:
        """All columns of a segment from the recomputed ones and those of the earlier fit."""
        columns = np.empty((len(renewed), len(self.answering)))
        columns[:, self.anew] = renewed
        if known is not None:
            columns[:, list(self.kept)] = known[:, list(self.kept.values())]
        return columns


def probe_segments(pieces: Sequence[SegmentData]) -> tuple[int, ...]:
    """Indices of the probes: a few segments of each stage, spread evenly, none of them held out."""
    stages: dict[object, list[int]] = {}
    for k, piece in enumerate(pieces):
        if not piece.held_out:
            stages.setdefault(piece.stage, []).append(k)
    every = PROBE_EVERY
    return tuple(sorted(k for places in stages.values() for k in places[min(every, len(places)) // 2 :: every]))


def known_responses(model: Model, known: Fit | None) -> Responses:
    """The responses found in an earlier fit; none where an effect is new or has grown since."""
    sizes = {a.name: a.relative_size for a in model.active if not a.is_absent}
    known_before = Responses() if known is None else known.responses
    if any(size > MAX_GROWTH_BEFORE_PROBE * known_before.sizes.get(name, 0.0) for name, size in sizes.items()):
        return Responses({}, sizes)
    return known_before


def column_plan(
    names: Sequence[ColumnName],
    probes: Mapping[int, ColumnProbe],
    known: Fit | None,
    previous: Mapping[ColumnName, frozenset[str]] = MappingProxyType({}),
) -> ColumnPlan:
    """Plan the columns of all other segments from the probes.

    Parameters
    ----------
    names : sequence of (str, str)
        Effect and parameter of every column.
    probes : dict
        Probes by segment index.
    known : Fit, optional
        Earlier fit, whose columns are reused where they are unchanged on the probes.
    previous : dict
        For columns probed before, the inner effects that respond to them.
    """
    power = sum((np.sum(p.columns**2, axis=0) for p in probes.values()), np.zeros(len(names)))
    responses: dict[tuple[int, str], float] = {}
    for probe in probes.values():
        for key, value in probe.responses.items():
            responses[key] = responses.get(key, 0.0) + value
    responding = {key for key, value in responses.items() if value > MIN_RESPONSE**2 * power[key[0]]}
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
