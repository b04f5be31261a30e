"""Batches of segments: signals and windows concatenated, so that one kernel call evaluates all of them.

A batch has about ten thousand samples, which fit into a processor's cache and make a call's overhead negligible.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.diagnosis.weak_form.segments import SegmentData
from orchestrator.diagnosis.weak_form.windows import Windows
from orchestrator.numerics.types import Array
from protocols import SignalBatch


class WindowLayout(NamedTuple):
    """The windows of a batch's segments as arrays for kernels.

    Attributes
    ----------
    starts : array of int64, shape (segments + 1,)
        Bounds of the segments' samples.
    rows : array of int64, shape (segments + 1,)
        Bounds of the segments' equations, which are ordered by test function, mode, axis.
    test_functions, n_bins, n_modes, unread : array of int64, shape (segments,)
        As in `Windows`; `unread` is -1 where both axes were measured.
    steps : array, shape (segments,)
        Spacing of the test functions in intervals.
    bins : array of int32, shape (samples,)
        Bin of the interval after each sample.
    before : array of int32, shape (samples,)
        The test function that peaks before the middle of that interval, counted from 1; 0 or beyond the last: none.
    weights : array, shape (samples, 2)
        Value of that test function and of the next one there.
    mode_starts : array of int64, shape (segments,)
        Start of each segment's modes in `modes`.
    modes : array
        Values of all segments' modes, mode by mode.
    interval_s : array, shape (segments,)
        Sampling interval [s].
    cos, sin : array, shape (segments,)
        Cosine and sine of the believed rotor angle.
    """

    starts: NDArray[np.int64]
    rows: NDArray[np.int64]
    test_functions: NDArray[np.int64]
    n_bins: NDArray[np.int64]
    n_modes: NDArray[np.int64]
    unread: NDArray[np.int64]
    steps: Array
    bins: NDArray[np.int32]
    before: NDArray[np.int32]
    weights: Array
    mode_starts: NDArray[np.int64]
    modes: Array
    interval_s: Array
    cos: Array
    sin: Array


@dataclass(frozen=True)
class SegmentBatch:
    """Some segments of a recording.

    Attributes
    ----------
    places : tuple of int
        Indices of the segments in the recording.
    pieces : tuple of SegmentData
    signals : SignalBatch
        Signals of all segments, as measured and commanded.
    layout : WindowLayout
    """

    places: tuple[int, ...]
    pieces: tuple[SegmentData, ...]
    signals: SignalBatch
    layout: WindowLayout

    @classmethod
    def of(cls, pieces: Sequence[SegmentData], places: Iterable[int] | None = None) -> SegmentBatch:
        """A batch of all segments, or of those at given indices."""
        at = tuple(range(len(pieces)) if places is None else places)
        chosen = tuple(pieces[k] for k in at)
        signals = SignalBatch.of([p.signals for p in chosen])
        return cls(at, chosen, signals, _layout(chosen, signals.starts))

    def with_voltages_of(self, pieces: Sequence[SegmentData]) -> SegmentBatch:
        """The batch of the same recording with other voltages, which shares all other arrays."""
        chosen = tuple(pieces[k] for k in self.places)
        if all(new is old for new, old in zip(chosen, self.pieces, strict=True)):
            return self
        segments = tuple(p.signals for p in chosen)
        v_ab = np.concatenate([s.v_ab for s in segments], dtype=np.float64)
        return replace(self, pieces=chosen, signals=replace(self.signals, segments=segments, v_ab=v_ab))

    @cached_property
    def believed_rad(self) -> Array:
        """Believed rotor angle, shape (samples,), or (1,) where it is the same throughout [rad]."""
        angles = np.array([float(p.segment.rotor_angle_rad) for p in self.pieces])
        return np.asarray(self.signals.per_sample(angles), dtype=np.float64)

    @cached_property
    def singles(self) -> tuple[SegmentBatch, ...]:
        """Each segment as a separate batch."""
        return tuple(SegmentBatch.of([piece]) for piece in self.pieces)

    def rows_of(self, j: int) -> slice:
        """Rows of the equations of the batch's segment j."""
        return slice(int(self.layout.rows[j]), int(self.layout.rows[j + 1]))


def _layout(pieces: Sequence[SegmentData], starts: NDArray[np.int64]) -> WindowLayout:
    windows = [p.windows for p in pieces]
    angles = np.array([float(p.segment.rotor_angle_rad) for p in pieces])
    # No interval follows a segment's last sample.
    bins = [np.append(w.bins, 0) for w in windows]
    before, weights = zip(*(_test_functions(w) for w in windows), strict=True)
    return WindowLayout(
        starts=starts,
        rows=_bounds([w.rows for w in windows]),
        test_functions=np.array([w.test_functions for w in windows]),
        n_bins=np.array([w.n_bins for w in windows]),
        n_modes=np.array([len(w.modes) for w in windows]),
        unread=np.array([-1 if w.unread is None else w.unread for w in windows]),
        steps=np.array([float(w.step) for w in windows]),
        bins=np.concatenate(bins).astype(np.int32),
        before=np.concatenate(before),
        weights=np.concatenate(weights),
        mode_starts=_bounds([w.modes.size for w in windows])[:-1],
        modes=np.concatenate([w.modes.ravel() for w in windows]),
        interval_s=1.0 / np.array([p.signals.sampling_frequency_hz for p in pieces]),
        cos=np.cos(angles),
        sin=np.sin(angles),
    )


def _test_functions(windows: Windows) -> tuple[NDArray[np.int32], Array]:
    """Indices of the test function before each interval of a segment, and the values of it and the next one there."""
    place = (np.arange(len(windows.bins) + 1) + 0.5) / windows.step
    whole = np.floor(place)
    weights = np.column_stack([1.0 - (place - whole), place - whole])
    weights[-1] = 0.0
    return np.minimum(whole, windows.test_functions + 1).astype(np.int32), weights


def _bounds(sizes: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


MAX_BATCH_SAMPLES = 20_000
"""Samples of a batch beyond which its arrays leave a processor's cache; far below, call overhead is noticeable."""


@dataclass(frozen=True)
class RecordingBatches:
    """A recording's segments grouped for evaluation.

    Attributes
    ----------
    pieces : tuple of SegmentData
        All segments of the recording.
    probes, others : tuple of SegmentBatch
        Those that are evaluated first, and all others.
    """

    pieces: tuple[SegmentData, ...] = ()
    probes: tuple[SegmentBatch, ...] = ()
    others: tuple[SegmentBatch, ...] = ()

    @property
    def all(self) -> tuple[SegmentBatch, ...]:
        return (*self.probes, *self.others)

    def with_voltages_of(self, pieces: tuple[SegmentData, ...]) -> RecordingBatches:
        """The groups of the same recording with other voltages, which share all other arrays."""
        probes, others = (tuple(b.with_voltages_of(pieces) for b in part) for part in (self.probes, self.others))
        return RecordingBatches(pieces, probes, others)


def in_batches(
    pieces: Sequence[SegmentData], first: Iterable[int] = (), samples: int = MAX_BATCH_SAMPLES
) -> RecordingBatches:
    """A recording's segments in batches of at most so many samples, with separate batches for those in `first`.

    Held-out segments and those with the bridge off also have separate batches, as they need fewer computations.
    """
    ahead = set(first)
    kinds: dict[tuple[bool, bool, bool], list[int]] = {}
    for k, piece in enumerate(pieces):
        kinds.setdefault((k in ahead, piece.held_out, piece.signals.bridge_on), []).append(k)
    early, late = list[SegmentBatch](), list[SegmentBatch]()
    for (is_ahead, _, _), places in kinds.items():
        (early if is_ahead else late).extend(SegmentBatch.of(pieces, part) for part in _split(pieces, places, samples))
    return RecordingBatches(tuple(pieces), tuple(early), tuple(late))


def _split(pieces: Sequence[SegmentData], places: Sequence[int], samples: int) -> list[list[int]]:
    """Split segment indices into parts with similar numbers of samples, the longest segments first."""
    lengths = {k: len(pieces[k].signals.v_dc) for k in places}
    count = max(1, -(-sum(lengths.values()) // samples))
    parts: list[list[int]] = [[] for _ in range(min(count, len(places)))]
    filled = [0] * len(parts)
    for k in sorted(places, key=lambda k: -lengths[k]):
        smallest = filled.index(min(filled))
        parts[smallest].append(k)
        filled[smallest] += lengths[k]
    return [sorted(part) for part in parts]
